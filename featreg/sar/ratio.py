"""Ratio of exponentially weighted averages (ROEWA), the gradient that multiplicative speckle asks for.

References
----------
R. Fjortoft, A. Lopes, P. Marthon, E. Cubero-Castan, "An optimal multiedge detector for SAR image segmentation",
IEEE TGRS 36 (1998) 793, DOI 10.1109/36.673672. Z. Wang et al., "Rapid Subpixel Matching Method for Spaceborne
Synthetic Aperture Radar Images", Sensors and Materials 34 (2022) 3138, Eq. 3 to 5.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.sar.speckle import filled_amplitude
from featreg.types import BoolArray, Image

F32 = NDArray[np.float32]

# Added to both means, relative to the image's mean amplitude; keeps the ratio finite, and 1, where both vanish.
FLOOR = 1e-2
# A side that holds less than this share of the other side's weight (border, nodata) gives no gradient.
LEAST_SUPPORT = 0.02
# Pixels from which the quantiles of an edge map are taken.
SAMPLE = 5_000


def ratio_gradients(image: Image, alpha: float = 2.0, floor: float = FLOOR) -> tuple[F32, F32]:
    """Return the logarithmic ratio gradients of an image.

    Parameters
    ----------
    image : Image
        Amplitude (of any number of looks) or complex; the mask is honoured: invalid pixels have no weight.
    alpha : float
        Exponential weight in pixels, > 0: a pixel at distance d along an axis weighs exp(-d / alpha).
    floor : float
        Added to both means, relative to the mean amplitude of the image: what lies far below it is noise and shadow.

    Returns
    -------
    gx, gy : (H, W) float32
        log(mean right / mean left) and log(mean below / mean above), so that x and y point as coordinates do; 0 at
        invalid pixels and where one side has (almost) no valid pixel.

    Raises
    ------
    ParameterError
        alpha is not a positive finite number.

    Notes
    -----
    Eq. 3 with a decaying exponent (the sign printed there is a misprint), normalised by the weights that exist. The
    one-sided means exclude the pixel itself. Eq. 4's T is ``exp(abs(g))``. The means come from first-order recursions,
    so the cost does not depend on alpha.
    """
    return image.derive(_ratio_gradients, alpha=float(alpha), floor=float(floor))


def _ratio_gradients(image: Image, alpha: float, floor: float) -> tuple[F32, F32]:
    mask = None if image.all_valid else image.mask
    return roewa(image.amplitude, alpha, mask, floor)


def roewa(amplitude: F32, alpha: float, mask: BoolArray | None = None, floor: float = FLOOR) -> tuple[F32, F32]:
    """As `ratio_gradients`, of a plain (H, W) float32 array; `mask` is (H, W) bool, True = valid."""
    gx, gy = np.empty((2, *amplitude.shape), np.float32)
    _means_to_ratios(amplitude, alpha, mask, floor, gx, gy, np.empty((0, amplitude.shape[1]), np.float32))
    if mask is None:
        gx[:, [0, -1]] = 0
        gy[[0, -1]] = 0
        return gx, gy
    # The weights that exist on either side are the same sums of the mask; their log ratio is taken off.
    wx, wy = np.empty((2, *amplitude.shape), np.float32)
    _means_to_ratios(mask.astype(np.float32), alpha, mask, 1e-6, wx, wy, np.empty((0, amplitude.shape[1]), np.float32))
    limit = -math.log(LEAST_SUPPORT)
    for gradient, weights in ((gx, wx), (gy, wy)):
        gradient -= weights
        gradient[(np.abs(weights) > limit) | ~mask] = 0
    return gx, gy


def roewa_strength(amplitude: F32, alpha: float, floor: float = FLOOR) -> F32:
    """Return the (H, W) float32 length of `roewa`'s gradient of a plain array, without storing the gradient."""
    rows = np.empty((2, 1, amplitude.shape[1]), np.float32)
    strength = np.empty(amplitude.shape, np.float32)
    _means_to_ratios(amplitude, alpha, None, floor, rows[0], rows[1], strength)
    strength[[0, -1]] = 0
    strength[:, [0, -1]] = 0
    return strength


def _means_to_ratios(
    amplitude: F32, alpha: float, mask: BoolArray | None, floor: float, gx: F32, gy: F32, strength: F32
) -> None:
    """Run the recursions; without a mask the weights that exist on each side are known in closed form."""
    if not (math.isfinite(alpha) and alpha > 0):
        raise ParameterError(f"alpha must be a positive number of pixels, got {alpha}")
    from featreg.sar import ratio_kernels

    height, width = amplitude.shape
    decay = math.exp(-1.0 / alpha)
    amplitude = np.ascontiguousarray(amplitude, np.float32)
    sums = np.empty((4, height, width), np.float32)
    left, right, up = sums[0], sums[1], sums[2:]
    ratio_kernels.horizontal_sums(amplitude, np.float32(decay), left, right)
    if mask is None:
        balance = _side_weights(width, decay), _side_weights(height, decay)
        mean = float(amplitude.mean())
    else:
        balance = np.zeros(width, np.float32), np.zeros(height, np.float32)
        mean = float(amplitude.sum(dtype=np.float64)) / max(1, int(np.count_nonzero(mask)))
    side = _two_sided_weights(height, decay) * decay / (1 - decay)
    small = (max(floor * mean, 1e-30) * side).astype(np.float32)
    ratio_kernels.log_ratios(left, right, np.float32(decay), small, *balance, up, gx, gy, strength)


def edge_strength(gx: F32, gy: F32, *, eq5: bool = False) -> F32:
    """Return the (H, W) float32 edge map: the length of the log-ratio gradient or, with `eq5`, exactly Eq. 5.

    Eq. 5 is sqrt(T1^2 + T3^2) of the ratios; sqrt(2) is subtracted, so that a flat area is 0 in both.
    """
    import cv2

    if not eq5:
        return np.asarray(cv2.magnitude(gx, gy), np.float32)
    strength = np.sqrt(np.exp(2 * np.abs(gx)) + np.exp(2 * np.abs(gy))) - np.float32(math.sqrt(2))
    return np.asarray(strength, np.float32)


def quantised_edges(image: Image, alpha: float, floor: float = FLOOR, eq5: bool = False) -> NDArray[np.uint8]:
    """Return the (H, W) uint8 edge map.

    255 stands for the 99.9th percentile of the edge strength or five times its median, whichever is less, and for all
    above: neither a single ship nor the rim of a black border may darken all other edges. Invalid pixels count as the
    mean amplitude, so the map is right to 1 % only where these are at least five alpha away; without `eq5`, that is,
    which takes the exact gradients.
    """
    import cv2

    if eq5:
        strength = edge_strength(*ratio_gradients(image, alpha, floor), eq5=True)
    else:
        strength = roewa_strength(filled_amplitude(image), alpha, floor)
    step = max(1, math.isqrt(strength.size // SAMPLE))
    sample = strength[::step, ::step][image.mask[::step, ::step]]
    if not sample.size:
        return np.zeros(image.shape, np.uint8)
    middle, high = sample.size // 2, int(0.999 * (sample.size - 1))
    ranked = np.partition(sample, [middle, high])
    top = min(float(ranked[high]), 5 * float(ranked[middle])) or float(ranked[high])
    if not top > 0:
        return np.zeros(image.shape, np.uint8)
    return np.asarray(cv2.convertScaleAbs(strength, alpha=255.0 / top), np.uint8)


def _side_weights(count: int, decay: float) -> F32:
    """log(weight after / weight before) of the pixels that exist beside each of `count` positions."""
    i = np.arange(count)
    before = 1 - decay ** np.maximum(i, 1)
    return np.asarray(np.log(before[::-1] / before), np.float32)


def _two_sided_weights(count: int, decay: float) -> NDArray[np.float64]:
    i = np.arange(count)
    return (2 - decay ** (i + 1) - decay ** (count - i)) / (1 - decay) - 1
