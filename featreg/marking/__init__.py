"""A local web page to mark homologous points of two images by hand."""

from featreg.marking.points import MarkedPoints
from featreg.marking.server import marking_app, serve

__all__ = ["MarkedPoints", "marking_app", "serve"]
