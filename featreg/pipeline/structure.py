"""Whether the directions of structure in two images agree with a model, where their intensities cannot be compared."""

from __future__ import annotations

import math

import numpy as np

from featreg.geometry import Affine
from featreg.interfaces import FailedFit, Model
from featreg.sar.orientation.levels import aligned
from featreg.sar.orientation.windows import correlated, together
from featreg.types import FloatArray, Image

#: Samples along the longer side of the reference at most, alpha of the gradients, side of a window and its largest
#: displacement in samples.
SAMPLES, ALPHA, SIDE, REACH = 256, 1.2, 32, 12
#: Turns in degrees and zooms up to which windows are displaced together, and steps of each.
TURN_DEG, ZOOM, STEPS = 4.0, 0.06, 9
#: Fewest windows that say anything.
LEAST_WINDOWS = 6


def structural_drift(reference: Image, secondary: Image, model: Model) -> tuple[float, float] | None:
    """Return how far the structure of two images moves together beyond a model, and how large the samples are.

    Parameters
    ----------
    reference, secondary : the images
    model : reference -> secondary; over the image it is taken as affine

    Returns
    -------
    drift, sample : px of the secondary; the root mean square displacement of the windows by the one similarity at which
        their orientation correlations (`featreg.sar.orientation`) add up to most. None where too few windows lie in
        both images, or the model is not known well enough over the reference.

    Notes
    -----
    It is blind to reversed contrast and to what intensities mean, so that it judges an optical against a SAR image.
    """
    x, y = np.meshgrid(*(np.linspace(0, n - 1, 5) for n in reference.shape[::-1]))
    lattice = np.column_stack([x.ravel(), y.ravel()])
    there: FloatArray = model(lattice)
    good = np.isfinite(there).all(axis=1)
    affine = Affine.from_estimate(lattice[good], there[good])
    if isinstance(affine, FailedFit) or not np.linalg.det(affine.matrix[:2, :2]) > 0:
        return None
    level = aligned(reference, secondary, affine.matrix[:2], SAMPLES, ALPHA)
    if min(level.valid.shape) < SIDE:
        return None
    found = correlated(level, SIDE, REACH)
    if len(found) < LEAST_WINDOWS:
        return None
    _, moved = together(found, TURN_DEG, ZOOM, STEPS)
    away = found.xy @ moved[:, :2].T + moved[:, 2] - found.xy
    sample = math.sqrt(float(np.linalg.det(affine.matrix[:2, :2]))) / level.factor
    return sample * float(np.sqrt((away**2).sum(axis=1).mean())), sample
