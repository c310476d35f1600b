"""The provider: its name, its algorithms, and where the program is."""

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsProcessingProvider

from featreg_processing.offsets import MeasureOffsets
from featreg_processing.program import SETTING
from featreg_processing.register import Register
from featreg_processing.tie_points import TiePoints
from featreg_processing.warp import Warp


class FeatregProvider(QgsProcessingProvider):
    """`featreg:register`, `featreg:warp`, `featreg:tiepoints`, `featreg:offsets`."""

    def id(self):
        return "featreg"

    def name(self):
        return "featreg"

    def longName(self):
        return "featreg: registration of SAR images"

    def load(self):
        ProcessingConfig.settingIcons[self.name()] = self.icon()
        ProcessingConfig.addSetting(Setting(self.name(), SETTING, "Program featreg (empty: searched on PATH)", ""))
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self):
        ProcessingConfig.removeSetting(SETTING)

    def loadAlgorithms(self):
        for algorithm in (Register, Warp, TiePoints, MeasureOffsets):
            self.addAlgorithm(algorithm())
