"""`featreg:warp`: a raster of the secondary's footprint onto the grid of the reference, by a result."""

from qgis.core import (
    QgsProcessingParameterEnum,
    QgsProcessingParameterFile,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
)

from featreg_processing.algorithm import FeatregAlgorithm
from featreg_processing.program import run

KINDS = ("lanczos", "cubic", "bilinear", "nearest")


class Warp(FeatregAlgorithm):
    """`featreg warp`."""

    NAME, TITLE = "warp", "Warp by a registration"
    HELP = (
        "Resamples the secondary, or another raster of its footprint, onto the grid of the reference, by a result of "
        "<i>Register two SAR images</i>. Samples keep their type, scale and nodata value."
    )

    def initAlgorithm(self, config=None):
        """Say what is taken and given."""
        self.addParameter(QgsProcessingParameterFile("RESULT", "Result", extension="json"))
        self.addParameter(QgsProcessingParameterRasterLayer("SECONDARY", "Secondary image"))
        self.addParameter(QgsProcessingParameterRasterLayer("REFERENCE", "Reference image", optional=True))
        self.addParameter(QgsProcessingParameterEnum("RESAMPLING", "Resampling", list(KINDS), defaultValue=0))
        self.addParameter(QgsProcessingParameterRasterDestination("ALIGNED", "Aligned"))

    def processAlgorithm(self, parameters, context, feedback):
        """Warp."""
        like = None
        if self.parameterAsRasterLayer(parameters, "REFERENCE", context) is not None:
            like = self.file_of(parameters, "REFERENCE", context)
        aligned = self.parameterAsOutputLayer(parameters, "ALIGNED", context)
        kind = KINDS[self.parameterAsEnum(parameters, "RESAMPLING", context)]
        result = self.parameterAsFile(parameters, "RESULT", context)
        secondary = self.file_of(parameters, "SECONDARY", context)
        run(["warp", result, secondary, "-o", aligned, "--resampling", kind, *self.option("--like", like)], feedback)
        return {"ALIGNED": aligned}
