"""`featreg:tiepoints`: the tie points of a result as a layer of points and a layer of arrows."""

import csv
import json
import os
import tempfile

from qgis.core import (
    QgsArrowSymbolLayer,
    QgsCoordinateReferenceSystem,
    QgsFeature,
    QgsField,
    QgsFields,
    QgsGeometry,
    QgsLineSymbol,
    QgsPointXY,
    QgsProcessing,
    QgsProcessingLayerPostProcessorInterface,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFeatureSink,
    QgsProcessingParameterFile,
    QgsSingleSymbolRenderer,
    QgsWkbTypes,
)
from qgis.PyQt.QtCore import QVariant

from featreg_processing.algorithm import FeatregAlgorithm
from featreg_processing.program import run

#: Attributes of a tie point: name, type.
ATTRIBUTES = (
    ("reference_x", QVariant.Double), ("reference_y", QVariant.Double), ("secondary_x", QVariant.Double),
    ("secondary_y", QVariant.Double), ("score", QVariant.Double), ("residual", QVariant.Double),
)  # fmt: skip
STAGES = ("inliers", "all")


class _Arrows(QgsProcessingLayerPostProcessorInterface):
    """Draws lines as arrows, once the layer is shown."""

    def postProcessLayer(self, layer, context, feedback):
        symbol = QgsLineSymbol.createSimple({})
        arrow = QgsArrowSymbolLayer.create({"arrow_width": "0.4", "head_length": "1.6", "head_thickness": "1.2"})
        symbol.changeSymbolLayer(0, arrow)
        layer.setRenderer(QgsSingleSymbolRenderer(symbol))
        layer.triggerRepaint()


class TiePoints(FeatregAlgorithm):
    """`featreg export`, as layers of QGIS."""

    NAME, TITLE = "tiepoints", "Tie points of a registration"
    HELP = (
        "The tie points of a result as points where the reference lies, with both pixel positions, score and residual; "
        "and as arrows to where the secondary's point lies (by its own georeferencing, else by the model, so that the "
        "arrow is the residual). Where the reference has no georeferencing, both lie in its pixels (x right, y up)."
    )

    def initAlgorithm(self, config=None):
        """Say what is taken and given."""
        self.addParameter(QgsProcessingParameterFile("RESULT", "Result", extension="json"))
        self.addParameter(QgsProcessingParameterEnum("STAGE", "Which tie points", list(STAGES), defaultValue=0))
        self.addParameter(QgsProcessingParameterFeatureSink("POINTS", "Tie points", QgsProcessing.TypeVectorPoint))
        self.addParameter(QgsProcessingParameterFeatureSink("ARROWS", "Arrows", QgsProcessing.TypeVectorLine))

    def processAlgorithm(self, parameters, context, feedback):
        """Export, and fill both layers."""
        result = self.parameterAsFile(parameters, "RESULT", context)
        stage = STAGES[self.parameterAsEnum(parameters, "STAGE", context)]
        with open(result, encoding="utf-8") as file:
            located = json.load(file).get("reference", {}).get("geolocation") is not None
        with tempfile.TemporaryDirectory() as folder:
            to = "geojson" if located else "csv"
            path = os.path.join(folder, f"tie_points.{to}")
            run(["export", result, "--to", to, "--stage", stage, "-o", path], feedback)
            points, arrows = (_of_geojson if located else _of_csv)(path)
        fields = QgsFields()
        for name, kind in ATTRIBUTES:
            fields.append(QgsField(name, kind))
        crs = QgsCoordinateReferenceSystem("EPSG:4326" if located else "")
        outputs = {}
        for name, kind, rows in (("POINTS", QgsWkbTypes.Point, points), ("ARROWS", QgsWkbTypes.LineString, arrows)):
            sink, outputs[name] = self.parameterAsSink(parameters, name, context, fields, kind, crs)
            for xy, values in rows:
                feature = QgsFeature(fields)
                corners = [QgsPointXY(*p) for p in xy]
                point = kind == QgsWkbTypes.Point
                feature.setGeometry(
                    QgsGeometry.fromPointXY(corners[0]) if point else QgsGeometry.fromPolylineXY(corners)
                )
                feature.setAttributes(values)
                sink.addFeature(feature)
            feedback.pushInfo(f"{name.lower()}: {len(rows)}")
        if context.willLoadLayerOnCompletion(outputs["ARROWS"]):
            self._style = _Arrows()  # kept alive: QGIS holds no reference
            context.layerToLoadOnCompletionDetails(outputs["ARROWS"]).setPostProcessor(self._style)
        return outputs


def _values(row):
    return [None if row.get(name) in (None, "") else float(row[name]) for name, _ in ATTRIBUTES]


def _of_geojson(path):
    """(points, arrows) as [([(x, y), ...], attributes)], in longitude and latitude."""
    with open(path, encoding="utf-8") as file:
        features = json.load(file)["features"]
    kept = {name: [f for f in features if f["properties"]["layer"] == name] for name in ("tie_points", "arrows")}
    rows = [_values(f["properties"]) for f in kept["tie_points"]]
    points = [([f["geometry"]["coordinates"]], row) for f, row in zip(kept["tie_points"], rows)]
    arrows = []
    for feature in kept["arrows"]:
        shape = feature["geometry"]
        parts = shape["coordinates"] if shape["type"] == "MultiLineString" else [shape["coordinates"]]
        arrows += [(part, rows[feature["properties"]["row"]]) for part in parts]
    return points, arrows


def _of_csv(path):
    """The same in pixels, y upwards as QGIS draws a raster without georeferencing."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = [_values(row) for row in csv.DictReader(file)]
    places = [[(row[0] + 0.5, -(row[1] + 0.5)), (row[2] + 0.5, -(row[3] + 0.5))] for row in rows]
    return [(xy[:1], row) for xy, row in zip(places, rows)], list(zip(places, rows))
