"""What all algorithms of featreg share."""

from qgis.core import QgsProcessingAlgorithm, QgsProcessingException


class FeatregAlgorithm(QgsProcessingAlgorithm):
    """One command of featreg: a subclass names it and says what it takes."""

    NAME = TITLE = HELP = ""

    def createInstance(self):
        return type(self)()

    def name(self):
        return self.NAME

    def displayName(self):
        return self.TITLE

    def shortHelpString(self):
        return self.HELP

    def file_of(self, parameters, name, context):
        """The file of a raster layer; featreg reads files, so a layer of a server has to be saved first."""
        layer = self.parameterAsRasterLayer(parameters, name, context)
        if layer is None:
            raise QgsProcessingException(self.invalidRasterError(parameters, name))
        source = layer.source().split("|")[0]
        if layer.providerType() != "gdal":
            raise QgsProcessingException(
                f"{layer.name()}: a layer of '{layer.providerType()}' is no file; save it first"
            )
        return source

    def option(self, flag, value):
        """A command's option, nothing where there is no value."""
        return [] if value in (None, "") else [flag, str(value)]
