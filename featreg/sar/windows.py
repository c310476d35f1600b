"""Views of a SAR image in windows around points: what they cost is the windows' pixels, not the image's.

Windows are squares (N, S, S) float32, taken from upper left corners (N, 2) on. One below the other they are a map again
(`as_map`), in which `places` says where a pixel of each window lies.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import in_parts, side_by_side
from featreg.sar.speckle import filled_amplitude, gaussian_reach, log_floor
from featreg.types import BoolArray, FloatArray, Image, IntArray

F32 = NDArray[np.float32]

#: Windows that are worked on at a time, so that they stay in the cache.
CHUNK = 32
#: How many times as long as a light pass a pixel of a window takes.
COST = 8
#: A window needs at most so many times its side of the other image; beyond, the whole image is quicker.
MOST_STRETCHED = 2.0

#: (T, 1 + reach) taps along x and along y, from the middle on, of a sum of symmetric separable filters.
Taps = tuple[F32, F32]


def few(count: int, side: int, shape: tuple[int, int]) -> bool:
    """Whether so many windows of `side` px have fewer pixels than an image of (H, W)."""
    return count * side**2 < shape[0] * shape[1]


def gaussian(sigma: float) -> Taps:
    """Return the taps by which `featreg.sar.speckle.despeckled` smooths."""
    import cv2

    reach = gaussian_reach(sigma)
    taps = np.asarray(cv2.getGaussianKernel(2 * reach + 1, sigma).ravel()[reach:], np.float32)[None]
    return taps, taps


def as_map(windows: F32) -> F32:
    """Return windows (N, S, S) as one map (N * S, S)."""
    return windows.reshape(-1, windows.shape[2])


def places(count: int, side: int, at: int) -> IntArray:
    """Return the (N, 2) places (x, y) in `as_map` of the pixel (`at`, `at`) of each window."""
    return np.column_stack([np.full(count, at), np.arange(count) * side + at])


def log_windows(
    image: Image, corners: IntArray, side: int, smooth: Taps | None = None, filtered: Taps | None = None
) -> F32:
    """Return windows of the log-amplitude of an image, beyond its rim mirrored.

    Parameters
    ----------
    image : the image
    corners, side : (N, 2) whole pixels (x, y) where the windows begin, and their side, px
    smooth, filtered : filters to be applied, one after the other
    """
    amplitude, floor = filled_amplitude(image), log_floor(image)

    def made(some: IntArray) -> F32:
        return _under(_under(_logs(amplitude, floor, some, side, smooth, filtered), smooth), filtered)

    return _in_chunks(made, corners, side)


def aligned_windows(
    image: Image,
    affine: FloatArray,
    shape: tuple[int, int],
    corners: IntArray,
    side: int,
    smooth: Taps | None = None,
    filtered: Taps | None = None,
) -> F32:
    """Return windows of the log-amplitude of an image on the grid of another one.

    Parameters
    ----------
    image : the image
    affine : (N, 2, 3) float64, from the pixels of the grid to those of the image around each window
    shape : (H, W) of the grid; beyond its rim the view is mirrored, and that of the image goes on beyond its own
    corners, side : (N, 2) whole pixels (x, y) of the grid where the windows begin, and their side, px; their middles
        lie on the grid
    smooth : a filter to be applied before the image is interpolated, bilinearly
    filtered : a filter to be applied to what was interpolated
    """
    from featreg.sar import window_kernels

    amplitude, floor = filled_amplitude(image), log_floor(image)
    reach = _reach(filtered)
    wide = side + 2 * reach
    box = _box_side(affine, wide)
    height, width = amplitude.shape
    rows, columns = shape

    def made(which: IntArray) -> F32:
        some, maps = np.ascontiguousarray(corners[which] - reach), np.ascontiguousarray(affine[which])
        middle = some + (wide - 1) / 2
        starts = np.floor(np.einsum("nij,nj->ni", maps[:, :, :2], middle) + maps[:, :, 2] - (box - 1) / 2)
        # Of what lies wholly beyond the rim the last pixels are wanted.
        starts = np.clip(starts, 2 - box, np.array([width, height]) - 1.0).astype(np.int64)
        boxes = _under(_logs(amplitude, floor, starts, box, smooth), smooth)
        out = np.empty((len(some), wide, wide), np.float32)
        window_kernels.sampled_windows(
            boxes.reshape(len(some), -1), box, starts, height, width, maps, some, rows, columns, out
        )
        return _under(out, filtered)

    return _in_chunks(made, np.arange(len(corners)), side)


def windows_of_both(
    reference: Image,
    secondary: Image,
    affine: FloatArray,
    corners: IntArray,
    others: IntArray,
    side: int,
    smooth: Taps | None = None,
    filtered: Taps | None = None,
) -> tuple[F32, F32]:
    """Return windows of the log-amplitude of two images on the grid of the first, as `log_windows` at `corners` and
    `aligned_windows` at `others` make them; side by side where threads were asked for."""
    here, there = side_by_side(
        [
            lambda: log_windows(reference, corners, side, smooth, filtered),
            lambda: aligned_windows(secondary, affine, reference.shape, others, side, smooth, filtered),
        ],
        COST * len(corners) * side**2,
    )
    return here, there


def compact(affine: FloatArray) -> BoolArray:
    """(N,) whether affine maps (N, 2, 3) are finite and take no square to so much that windows are no good."""
    stretch = np.abs(affine[:, :, :2]).sum(axis=2).max(axis=1)
    return np.asarray(np.isfinite(affine).all(axis=(1, 2)) & (stretch <= MOST_STRETCHED))


def _box_side(affine: FloatArray, side: int) -> int:
    """Side of upright squares of the image that hold what the maps make of squares of `side` px, and two px more."""
    stretch = float(np.abs(affine[:, :, :2]).sum(axis=2).max()) if len(affine) else 1.0
    return int(np.ceil(stretch * (side + 1))) + 5


def _reach(taps: Taps | None) -> int:
    return 0 if taps is None else taps[0].shape[1] - 1


def _logs(amplitude: F32, floor: np.float32, corners: IntArray, side: int, *later: Taps | None) -> F32:
    """Windows of the logarithm, as much larger on each side as filters to come use up."""
    from featreg.sar import window_kernels

    more = sum(_reach(taps) for taps in later)
    out = np.empty((len(corners), side + 2 * more, side + 2 * more), np.float32)
    window_kernels.log_windows(amplitude, floor, np.ascontiguousarray(corners - more), side + 2 * more, out.ravel())
    return out


def _under(windows: F32, taps: Taps | None) -> F32:
    """Windows under a filter, smaller by what it reaches."""
    from featreg.sar import window_kernels
    from featreg.sar.correlation_filter_kernels import HALF, TERMS, windows_under_filter

    if not _reach(taps) or taps is None:
        return windows
    side = windows.shape[1] - 2 * _reach(taps)
    out = np.empty((len(windows), side, side), np.float32)
    if taps[0].shape == (TERMS, 1 + HALF):
        windows_under_filter(windows, *taps, out)
    else:
        window_kernels.smoothed_windows(windows, *taps, out)
    return out


def _in_chunks(made: Callable[[IntArray], F32], given: IntArray, side: int) -> F32:
    """What a function makes of some of (N, ...) rows at a time, together; side by side where threads were asked for."""
    out = np.empty((len(given), side, side), np.float32)

    def part(first: int, last: int) -> None:
        for start in range(first, last, CHUNK):
            stop = min(start + CHUNK, last)
            out[start:stop] = made(given[start:stop])

    in_parts(part, len(given), COST * side**2, CHUNK)
    return out
