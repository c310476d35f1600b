"""Phase histories, images formed from them, and autofocus of one complex image.

phase_history, backprojection   what a radar measured (from phase_history_files), and the image on a ground_grid
complex_image, result           `featreg.focus`: one image, or its range_blocks; focus_gates judge it
minimum_entropy, phase_gradient, legendre_phase   the estimators, on pulse_spectra of chosen range_cells
inputs                          the images of a registration, focused first
"""

from featreg.focusing.complex_image import FRACTIONS, METHODS, focus
from featreg.focusing.result import FocusResult

__all__ = ["FRACTIONS", "METHODS", "FocusResult", "focus"]
