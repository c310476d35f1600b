"""Ratio of exponentially weighted averages (ROEWA), the gradient that multiplicative speckle asks for.

References
----------
R. Fjortoft, A. Lopes, P. Marthon, E. Cubero-Castan, "An optimal multiedge detector for SAR image segmentation",
IEEE TGRS 36 (1998) 793, DOI 10.1109/36.673672. Z. Wang et al., "Rapid Subpixel Matching Method for Spaceborne
Synthetic Aperture Radar Images", Sensors and Materials 34 (2022) 3138, Eq. 3 to 5.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.runtime.buffers import scratch
from featreg.runtime.threads import in_parts
from featreg.sar.gradients.lengths import lengths
from featreg.sar.speckle import filled_amplitude, mean_amplitude
from featreg.types import BoolArray, Image

F32 = NDArray[np.float32]
U16 = NDArray[np.uint16]

# Added to both means, relative to the image's mean amplitude; keeps the ratio finite, and 1, where both vanish.
FLOOR = 1e-2
# A side that holds less than this share of the other side's weight (border, nodata) gives no gradient.
LEAST_SUPPORT = 0.02
# An edge map that nowhere reaches this log ratio holds rounding errors.
LEAST_EDGE = 1e-3
# Pixels from which quantiles of an edge map are taken, and which.
SAMPLE, RANKS = 5_000, (0.5, 0.999)
# Steps of a length for one of the natural logarithm: lengths stay below 5.
STEPS = 8192
# Rows and columns of the tiles whose sums stay in the cache, and over how many alpha what decays is rounding.
STRIP, TILE, FADED = 64, 768, 17
# Tiles may be so many times wider where there are as few as an even number.
WIDER = 1.25
# Means between which the product of two sums of pixels, and of what is added to them, stays a float.
FEW, MANY = 1e-9, 1e9
# Alpha, px, below which a second neighbour weighs less than 3e-15 of the first, which no range of amplitudes outweighs,
# and beyond which all weights are equal over any image.
NARROWEST, WIDEST = 0.03, 1e5
NONE, NO_LENGTHS = np.empty((0, 0), np.float32), np.empty((0, 0), np.uint16)


def ratio_gradients(image: Image, alpha: float = 2.0, floor: float = FLOOR) -> tuple[F32, F32]:
    """Return the logarithmic ratio gradients of an image.

    Parameters
    ----------
    image : Image
        Amplitude (of any number of looks) or complex; the mask is honoured: invalid pixels have no weight.
    alpha : float
        Exponential weight in pixels, > 0: a pixel at distance d along an axis weighs exp(-d / alpha). Towards 0 the
        ratio becomes that of the two nearest pixels, which it is below 0.03.
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


def roewa(
    amplitude: F32, alpha: float, mask: BoolArray | None = None, floor: float = FLOOR, out: F32 | None = None
) -> tuple[F32, F32]:
    """As `ratio_gradients`, of a plain (H, W) float32 array; `mask` is (H, W) bool, True = valid.

    They are written to `out` (2, H, W) where it is given.
    """
    gx, gy = np.empty((2, *amplitude.shape), np.float32) if out is None else out
    if mask is None:
        log_ratios(amplitude, alpha, floor, gx, gy)
        gx[:, [0, -1]] = 0
        gy[[0, -1]] = 0
        return gx, gy
    # The weights that exist on either side are the same sums of the mask; their log ratio is taken off.
    valid = mask.astype(np.float32)
    mean = float(np.sum(amplitude * valid, dtype=np.float64)) / max(1, int(np.count_nonzero(mask)))
    log_ratios((amplitude + np.float32(floor * mean)) * valid, alpha, None, gx, gy)
    wx, wy = np.empty((2, *amplitude.shape), np.float32)
    log_ratios(valid, alpha, None, wx, wy)
    limit = -math.log(LEAST_SUPPORT)
    for gradient, weights in ((gx, wx), (gy, wy)):
        gradient -= weights
        gradient[(np.abs(weights) > limit) | ~mask] = 0
    return gx, gy


def roewa_strength(amplitude: F32, alpha: float, floor: float = FLOOR, mean: float | None = None) -> U16:
    """Return the (H, W) uint16 length of `roewa`'s gradient of a plain array in steps of 1 / `STEPS`.

    To 1 % where neither of the two ratios exceeds 6; the length of greater ones is told too low (by 11 % at 20), grows
    with them and stays below 5. The gradient is not stored. `mean` is that of the amplitude, where it is known.
    """
    strength = np.empty(amplitude.shape, np.uint16)
    log_ratios(amplitude, alpha, floor, lengths=strength, mean=mean)
    strength[0], strength[-1], strength[:, 0], strength[:, -1] = 0, 0, 0, 0
    return strength


def log_ratios(
    amplitude: F32,
    alpha: float,
    floor: float | None,
    gx: F32 = NONE,
    gy: F32 = NONE,
    both: F32 = NONE[:, :, None],
    lengths: U16 = NO_LENGTHS,
    mean: float | None = None,
) -> None:
    """Write the log ratios of the means of the amplitude plus `floor` of its mean, which adds that to every mean.

    They go to that of the four arrays that has rows; see `ratio_kernels.log_ratios`. The weights that exist on each
    side, fewer near the border, are known in closed form. Without a floor the sums are compared as they are: the
    weights are the caller's. `mean` is that of the amplitude, where it is known.
    """
    from featreg.sar.gradients import ratio_kernels

    image, constants, halo = recursion(amplitude, alpha, floor, mean)
    height, width = image.shape
    tile, rows = _tile(width, halo), max(STRIP, halo)
    room = (2, min(rows + halo, height) + 1, min(tile + 2 * halo, width))

    def part(first: int, stop: int) -> None:
        up = scratch("sums from above", room)
        ratio_kernels.log_ratios(
            image, *constants, halo, first * tile, min(stop * tile, width), tile, rows, up, gx, gy, both,
            np.float32(STEPS), lengths,
        )  # fmt: skip

    in_parts(part, -(-width // tile), height * tile)


def _tile(width: int, halo: int) -> int:
    """How many columns of an image pass at a time: an even number of tiles where one is not enough, all about equal.

    They follow from the width alone, as the sums to the sides begin anew in each of them.
    """
    most = max(TILE, 4 * halo)
    if width <= most:
        return width
    count = 2 * -(-width // int(2 * WIDER * most))
    return 16 * -(-width // (16 * count))


Constants = tuple[np.float32, np.float32, np.float32, F32, F32]


def recursion(
    amplitude: F32, alpha: float, floor: float | None, mean: float | None = None
) -> tuple[F32, Constants, int]:
    """Return what the kernels of ratios ask: an image, maybe brightened, constants, pixels beyond which all decayed."""
    import cv2

    image = np.ascontiguousarray(amplitude, np.float32)
    mean = float(cv2.mean(image)[0]) if mean is None else mean
    # What lies to one side of a pixel is a step away at least: of a small alpha its sums are as much smaller.
    sums = mean * _decay(alpha)
    if mean > 0 and not FEW < sums < MANY:
        # A power of two that is no float itself where both the amplitude and alpha are small.
        power = -round(math.log2(sums))
        image, mean = np.ldexp(image, power), math.ldexp(mean, power)
    constants = _recursion(image.shape, mean, alpha, floor)
    # Beyond so many pixels what decays is rounding.
    return image, constants, 8 * math.ceil(min(FADED * alpha, max(image.shape)) / 8)


def _recursion(shape: tuple[int, ...], mean: float, alpha: float, floor: float | None) -> Constants:
    """Return what the kernel asks beside an image (H, W) of that shape and mean.

    Returns
    -------
    what is added to every pixel; the decay from one to the next; what keeps 0/0 at 1; for each column (W,) and each row
    (H,) the weights that exist after it over those before it, 1 without a floor
    """
    decay = _decay(alpha)
    alpha = min(alpha, WIDEST)
    share_x, share_y = (np.ones(n, np.float32) if floor is None else _shares(n, alpha) for n in (shape[1], shape[0]))
    offset, tiny = (floor or 0.0) * mean, 1e-9 * (decay * mean or 1.0)
    return np.float32(offset), np.float32(decay), np.float32(tiny), share_x, share_y


def _decay(alpha: float) -> float:
    """Weight of a pixel beside that of its neighbour that is nearer by one; in float32 it must stay between 0 and 1."""
    if not (math.isfinite(alpha) and alpha > 0):
        raise ParameterError(f"alpha must be a positive number of pixels, got {alpha}")
    return math.exp(-1.0 / min(max(alpha, NARROWEST), WIDEST))


def edge_strength(gx: F32, gy: F32, *, eq5: bool = False) -> F32:
    """Return the (H, W) float32 edge map: the length of the log-ratio gradient or, with `eq5`, exactly Eq. 5.

    Eq. 5 is sqrt(T1^2 + T3^2) of the ratios; sqrt(2) is subtracted, so that a flat area is 0 in both.
    """
    if not eq5:
        return lengths(gx, gy)
    strength = np.sqrt(np.exp(2 * np.abs(gx)) + np.exp(2 * np.abs(gy))) - np.float32(math.sqrt(2))
    return np.asarray(strength, np.float32)


def quantised_edges(
    image: Image, alpha: float, floor: float = FLOOR, eq5: bool = False, clip: bool = True
) -> NDArray[np.uint8]:
    """Return the (H, W) uint8 edge map.

    255 stands for the 99.9th percentile of the edge strength or five times its median, whichever is less, and for all
    above: neither a single ship nor the rim of a black border may darken all other edges. Without `clip` 255 stands for
    the greatest strength. Invalid pixels count as the mean amplitude, so the map is right to 1 % only where these are
    at least five alpha away; without `eq5`, that is, which takes the exact gradients.
    """
    import cv2

    strength: F32 | U16
    if eq5:
        strength = edge_strength(*ratio_gradients(image, alpha, floor), eq5=True)
        least = LEAST_EDGE
    else:
        strength = roewa_strength(filled_amplitude(image), alpha, floor, mean_amplitude(image))
        least = LEAST_EDGE * STEPS
    if clip:
        middle, high = _quantiles(strength, image.mask)
        top = min(high, 5 * middle) or high
    else:
        top = float(strength[image.mask].max(initial=0))
    if not top > least:
        return np.zeros(image.shape, np.uint8)
    edges = np.empty(image.shape, np.uint8)

    def part(first: int, stop: int) -> None:
        cv2.convertScaleAbs(strength[first:stop], edges[first:stop], alpha=255.0 / top)

    in_parts(part, *image.shape)
    return edges


def _quantiles(strength: F32 | U16, mask: BoolArray) -> tuple[float, float]:
    """Median and 99.9th percentile of some of the valid pixels; 0 where there are none."""
    from featreg.sar.gradients import ratio_kernels

    step = max(1, math.isqrt(strength.size // SAMPLE))
    if strength.dtype == np.uint16:
        values = np.empty(2)
        ratio_kernels.ranked(strength.view(np.uint16), mask.view(np.uint8), step, np.array(RANKS), values)
        return float(values[0]), float(values[1])
    sample = strength[::step, ::step][mask[::step, ::step]]
    places = [int(share * (sample.size - 1)) for share in RANKS]
    return tuple(np.partition(sample, places)[places].tolist()) if sample.size else (0.0, 0.0)


@lru_cache(maxsize=64)
def _shares(count: int, alpha: float) -> F32:
    """Weight of the pixels that exist after each of `count` positions over that of those before it."""
    before = -np.expm1(-np.maximum(np.arange(count), 1) / alpha)
    return np.asarray(before[::-1] / before, np.float32)
