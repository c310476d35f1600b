"""`featreg:register`: two rasters to a result, and the secondary on the grid of the reference."""

import json
import shlex

from qgis.core import (
    QgsProcessingOutputNumber,
    QgsProcessingOutputString,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterString,
)

from featreg_processing.algorithm import FeatregAlgorithm
from featreg_processing.program import run

NUMBERS = {
    "TIE_POINTS": "Final tie points",
    "ROTATION": "Rotation, degrees counter-clockwise",
    "SCALE": "Size in the secondary of a pixel of the reference",
}


class Register(FeatregAlgorithm):
    """`featreg match`, then `featreg warp` where a raster is asked for."""

    NAME, TITLE = "register", "Register two SAR images"
    HELP = (
        "Finds tie points between two images, fits a model, says whether it can be trusted, and resamples the "
        "secondary onto the reference. A result that cannot be trusted is written with its reason, and a warning says "
        "so.\n\n"
        "Further options are those of <tt>featreg match --help</tt>, as <tt>--n-features 2000 --no-refine</tt>."
    )

    def initAlgorithm(self, config=None):
        """Say what is taken and given."""
        self.addParameter(QgsProcessingParameterRasterLayer("REFERENCE", "Reference image"))
        self.addParameter(QgsProcessingParameterRasterLayer("SECONDARY", "Secondary image"))
        self.addParameter(QgsProcessingParameterString("METHOD", "Method (featreg list method)", "auto"))
        self.addParameter(QgsProcessingParameterString("MODEL", "Model (affine, homography, ...)", "", optional=True))
        self.addParameter(QgsProcessingParameterString("BAND", "Band, by name or number", "", optional=True))
        self.addParameter(QgsProcessingParameterNumber("SEED", "Seed of everything random", defaultValue=0, minValue=0))
        self.addParameter(QgsProcessingParameterString("EXTRA", "Further options", "", optional=True))
        self.addParameter(QgsProcessingParameterFileDestination("RESULT", "Result", "featreg results (*.json)"))
        self.addParameter(
            QgsProcessingParameterRasterDestination("ALIGNED", "Secondary on the grid of the reference", optional=True)
        )
        self.addOutput(QgsProcessingOutputString("STATUS", "ok or unreliable"))
        self.addOutput(QgsProcessingOutputString("REASON", "Why it is unreliable"))
        for name, text in NUMBERS.items():
            self.addOutput(QgsProcessingOutputNumber(name, text))

    def processAlgorithm(self, parameters, context, feedback):
        """Match, and warp."""
        reference, secondary = (self.file_of(parameters, name, context) for name in ("REFERENCE", "SECONDARY"))
        result = self.parameterAsFileOutput(parameters, "RESULT", context)
        aligned = self.parameterAsOutputLayer(parameters, "ALIGNED", context)
        band = self.parameterAsString(parameters, "BAND", context)
        run(
            [
                "match", reference, secondary, "--json", result,
                *self.option("--method", self.parameterAsString(parameters, "METHOD", context)),
                *self.option("--model", self.parameterAsString(parameters, "MODEL", context)),
                *self.option("--band", band),
                *self.option("--seed", self.parameterAsInt(parameters, "SEED", context)),
                *shlex.split(self.parameterAsString(parameters, "EXTRA", context)),
            ],
            feedback,
        )  # fmt: skip
        with open(result, encoding="utf-8") as file:
            told = json.load(file)
        outputs = {"RESULT": result, "STATUS": told["status"], "REASON": told["reason"]}
        model = told["model"] or {}
        outputs["TIE_POINTS"] = told["counts"]["inliers"]
        if model.get("rotation_deg") is not None:
            outputs |= {"ROTATION": model["rotation_deg"], "SCALE": model["scale"]}
        if aligned and told["model"] is not None:
            run(["warp", result, secondary, "--like", reference, "-o", aligned, *self.option("--band", band)], feedback)
            outputs["ALIGNED"] = aligned
        return outputs
