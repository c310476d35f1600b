"""The plugin: it adds the provider, and takes it away."""

from qgis.core import QgsApplication

from featreg_processing.provider import FeatregProvider


class FeatregPlugin:
    """What QGIS loads; `initProcessing` is called by `qgis_process` too, which has no window."""

    def __init__(self, iface):
        self.provider = None

    def initProcessing(self):
        """Add the provider."""
        self.provider = FeatregProvider()
        QgsApplication.processingRegistry().addProvider(self.provider)

    def initGui(self):
        """Add the provider where there is a window."""
        self.initProcessing()

    def unload(self):
        """Take the provider away."""
        QgsApplication.processingRegistry().removeProvider(self.provider)
