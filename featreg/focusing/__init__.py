"""Autofocus: one complex image, its blocks of range cells, and the inputs of a registration."""

from featreg.focusing.complex_image import FRACTIONS, METHODS, FocusResult, focus

__all__ = ["FRACTIONS", "METHODS", "FocusResult", "focus"]
