"""featreg in QGIS: a provider of the Processing toolbox that calls the installed program `featreg`."""


def classFactory(iface):
    """Return the plugin; the name is QGIS's."""
    from featreg_processing.plugin import FeatregPlugin

    return FeatregPlugin(iface)
