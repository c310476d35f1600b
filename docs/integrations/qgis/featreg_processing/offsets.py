"""`featreg:offsets`: how far each cell of a grid moved between two rasters, as named bands."""

from qgis.core import (
    QgsProcessingParameterFile,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
)

from featreg_processing.algorithm import FeatregAlgorithm
from featreg_processing.program import run


class MeasureOffsets(FeatregAlgorithm):
    """`featreg offsets`."""

    NAME, TITLE = "offsets", "Measure a displacement field"
    HELP = (
        "Displacement of every cell between two images: bands dx, dy (px, reference to secondary), their covariance, "
        "peak and significance, and a reason for every cell without a displacement."
    )

    def initAlgorithm(self, config=None):
        """Say what is taken and given."""
        self.addParameter(QgsProcessingParameterRasterLayer("REFERENCE", "Reference image"))
        self.addParameter(QgsProcessingParameterRasterLayer("SECONDARY", "Secondary image"))
        self.addParameter(
            QgsProcessingParameterFile("INITIAL", "Result around which to look", extension="json", optional=True)
        )
        for name, text, value, least in (
            ("STEP", "Side of a cell, px", 16, 1),
            ("WINDOW", "Side of a window, px", 64, 8),
        ):
            self.addParameter(QgsProcessingParameterNumber(name, text, defaultValue=value, minValue=least))
        self.addParameter(QgsProcessingParameterRasterDestination("OFFSETS", "Displacement field"))

    def processAlgorithm(self, parameters, context, feedback):
        """Measure."""
        images = [self.file_of(parameters, name, context) for name in ("REFERENCE", "SECONDARY")]
        output = self.parameterAsOutputLayer(parameters, "OFFSETS", context)
        numbers = [
            part for flag in ("STEP", "WINDOW")
            for part in (f"--{flag.lower()}", str(self.parameterAsInt(parameters, flag, context)))
        ]  # fmt: skip
        initial = self.parameterAsFile(parameters, "INITIAL", context)
        run(["offsets", *images, "-o", output, *numbers, *self.option("--initial", initial)], feedback)
        return {"OFFSETS": output}
