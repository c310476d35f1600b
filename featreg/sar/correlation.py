"""Dense local correlation of two aligned maps: all small shifts around many points at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.runtime.threads import in_parts
from featreg.types import BoolArray, FloatArray, IntArray

F32 = NDArray[np.float32]
T = TypeVar("T", bound=np.generic)

#: Windows that together cover less than so many times the image are summed one by one.
FEW = 1.5
#: Root of the largest whole number of 32 bits.
MOST_ROOT = 46_340
#: A map's level is told by every so many rows and columns.
SPARSE = 16
#: How many times as long as a light pass a pixel of a window takes on its way uphill.
COST = 4


@dataclass(frozen=True)
class Peaks:
    """Where the correlation around each of N points is highest.

    Parameters
    ----------
    shift : (N, 2) float64 px, position of the peak in the second map less that in the first
    height : (N,) float64 correlation coefficient at the best whole-pixel shift
    curvature : (N, 2, 2) float64 per px^2, minus the Hessian of the correlation at the peak
    sound : (N,) bool, the peak is inside the search range and curved downwards in all directions
    """

    shift: FloatArray
    height: FloatArray
    curvature: FloatArray
    sound: BoolArray

    def take(self, rows: BoolArray) -> Peaks:
        """Those of an (N,) bool mask."""
        at = np.flatnonzero(rows)
        return Peaks(self.shift.take(at, 0), self.height.take(at), self.curvature.take(at, 0), self.sound.take(at))


def local_correlations(
    first: F32, second: F32, xy: IntArray, half: int, search: int, there: IntArray | None = None
) -> FloatArray:
    """Return the correlation coefficients of the windows around points, for every small shift.

    Parameters
    ----------
    first, second : (H, W) float32, aligned to within `search` pixels
    xy : (N, 2) int64 points, at least half + search + 1 pixels inside
    half : half the window; it is 2 * half + 1 pixels wide
    search : largest shift along x and y; at most 28 where `there` is given
    there : (N, 2) int64 points of `second` around which is searched, as far inside; None for `xy`

    Returns
    -------
    (N, 2 * search + 1, 2 * search + 1) float64
        Element [i, search + dy, search + dx] for the window of `first` at xy[i] against that of `second` at
        there[i] + (dx, dy); 0 where a window is constant.

    Raises
    ------
    ParameterError
        A search around other points that is too wide.
    """
    from featreg.sar import correlation_kernels

    order = np.argsort(xy[:, 1], kind="stable")
    xs, ys = np.ascontiguousarray(xy[order].T)
    side = 2 * half + 1
    found = np.empty((len(xy), 2 * search + 1, 2 * search + 1))
    if there is not None and search > correlation_kernels.MOST_SEARCH:
        raise ParameterError(f"search around other points must be at most 28 px, got {search}")
    few = search <= correlation_kernels.MOST_SEARCH and len(xy) * side**2 < FEW * first.size
    if there is not None or few:
        us, vs = (xs, ys) if there is None else np.ascontiguousarray(there[order].T)
        flat_a, width_a, flat_b, width_b = first.ravel(), first.shape[1], second.ravel(), second.shape[1]

        def part(start: int, stop: int) -> None:
            some = slice(start, stop)
            correlation_kernels.correlations_of_few(
                flat_a, width_a, flat_b, width_b, xs[some], ys[some], us[some], vs[some], half, search, found[some]
            )

        in_parts(part, len(xy), side**2)
        return _in_order(found, order)
    correlation_kernels.correlations(_about_zero(first), _about_zero(second), xs, ys, half, search, found)
    return _in_order(found, order)


def _about_zero(values: F32) -> F32:
    """A map less its mean, where that is more than what varies: running sums lose digits on a high level."""
    import cv2

    some = values[::SPARSE, ::SPARSE]
    if abs(float(some.mean(dtype=np.float64))) <= float(some.std(dtype=np.float64)):
        return values
    return np.asarray(values - np.float32(cv2.mean(values)[0]))


def _in_order(found: NDArray[T], order: IntArray) -> NDArray[T]:
    """Rows that were taken in an order, back where they were."""
    back = np.empty_like(found)
    back[order] = found
    return back


def peaks_uphill(
    first: F32, second: F32, xy: IntArray, there: IntArray, start: IntArray, half: int, search: int, apart: int = 1
) -> Peaks:
    """Return the peak that is reached uphill from a start, by whole pixels and at last to sub-pixel.

    Parameters
    ----------
    first, second, xy, half : as in `local_correlations`
    there : (N, 2) int64 points of `second` from which shifts count
    start : (N, 2) int64 px, shift (dx, dy) at which to begin
    search : a shift stays within so much along x and y, px. Points of `first` lie at least half + 1 pixels inside,
        those of `second` at least half + search + 1
    apart : px between the nine shifts that are compared first, at most search + 1 less the largest start

    Notes
    -----
    Where a start is right to a pixel, nine shifts are compared instead of all within the search. Values are taken in
    whole steps, 46340 // (2 * half + 1) of them to the range of either map, so that sums fit in 32 bits. Where the
    standard deviation of a window is less than 16 of these it gets steps of its own, 32700 / (2 * half + 1) of them or
    more to that, so that windows of little contrast beside strong targets are placed as well. What varies by less than
    a millionth of its mean correlates with nothing.
    """
    now, nine = _uphill(first, second, xy, there, start, half, search, apart)
    # A point that would leave the search has its peak on the rim of the 3 x 3 shifts, which is not sound.
    at = peaks(nine)
    return Peaks(now + at.shift, at.height, at.curvature, at.sound)


def peaks_near(first: F32, second: F32, xy: IntArray, half: int, search: int) -> Peaks:
    """Return the peak uphill from no shift at all; arguments as in `local_correlations`.

    Notes
    -----
    The nine shifts around 0 are compared for all points at once; from there only those go on that have to.
    """
    if len(xy) * (2 * half + 1) ** 2 < FEW * first.size:
        return peaks_uphill(first, second, xy, xy, np.zeros_like(xy), half, search)
    nine = local_correlations(first, second, xy, half, 1)
    best = nine.reshape(-1, 9).argmax(axis=1)
    now = np.zeros_like(xy)
    left = np.flatnonzero(best != 4)
    start = np.column_stack([best[left] % 3 - 1, best[left] // 3 - 1])
    now[left], nine[left] = _uphill(first, second, xy[left], xy[left], start, half, search)
    at = peaks(nine)
    return Peaks(now + at.shift, at.height, at.curvature, at.sound)


def _uphill(
    first: F32, second: F32, xy: IntArray, there: IntArray, start: IntArray, half: int, search: int, apart: int = 1
) -> tuple[IntArray, FloatArray]:
    """Whole shifts (N, 2) that are reached, and the correlations (N, 3, 3) around them."""
    from featreg.sar.uphill_kernels import climbed

    # From above, so that the rows that are read stay in the cache.
    order = np.argsort(xy[:, 1], kind="stable")
    xs, ys, us, vs = np.ascontiguousarray(np.concatenate([xy[order], there[order]], axis=1).T)
    now, nine = start[order], np.empty((len(xy), 3, 3))
    if not len(xy):
        return start, np.empty((0, 3, 3))
    flat_a, flat_b = first.ravel(), second.ravel()
    steps_a, steps_b = (_steps(flat, 2 * half + 1) for flat in (flat_a, flat_b))

    def part(begin: int, end: int) -> None:
        some = slice(begin, end)
        climbed(
            flat_a, first.shape[1], steps_a, flat_b, second.shape[1], steps_b, xs[some], ys[some], us[some], vs[some],
            half, search, apart, now[some], nine[some],
        )  # fmt: skip

    in_parts(part, len(xy), COST * (2 * half + 1) ** 2)
    return _in_order(now, order), _in_order(nine, order)


def _steps(values: F32, side: int) -> np.float32:
    """How many steps of whole numbers make one, so that sums of products over windows of `side` px fit in 32 bits."""
    import cv2

    found: list[tuple[float, float]] = []

    def part(first: int, stop: int) -> None:
        found.append(cv2.minMaxLoc(values[first:stop])[:2])

    in_parts(part, len(values), 1)
    low, high = min(one[0] for one in found), max(one[1] for one in found)
    return np.float32(MOST_ROOT // side / max(high - low, 1e-30))


def peaks(correlations: FloatArray) -> Peaks:
    """Return the highest shift of each (N, K, K) block, to sub-pixel by a quadratic through its 3 x 3 neighbourhood.

    The quadratic is the least-squares one through the nine values.
    """
    from featreg.sar.correlation_kernels import highest_peaks

    n = len(correlations)
    found = Peaks(np.empty((n, 2)), np.empty(n), np.empty((n, 2, 2)), np.empty(n, np.bool_))
    highest_peaks(correlations, found.shift, found.height, found.curvature, found.sound)
    return found


def quadratic_steps(nine: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the step from the middle of (N, 3, 3) values to the top of the least-squares quadratic through them.

    Returns
    -------
    (N, 2) float64 px (dx, dy), (N, 2, 2) minus the Hessian, and (N,) bool, True where the quadratic curves downwards
    and its top lies within one pixel; the step is 0 where it does not curve
    """
    left, middle, right = ([nine[:, v, u] for v in range(3)] for u in range(3))
    gx = (sum(right) - sum(left)) / 6
    gy = (right[2] + middle[2] + left[2] - right[0] - middle[0] - left[0]) / 6
    hxx = (sum(right) + sum(left) - 2 * sum(middle)) / 3
    hyy = sum(v[2] + v[0] - 2 * v[1] for v in (left, middle, right)) / 3
    hxy = (right[2] + left[0] - right[0] - left[2]) / 4
    determinant = hxx * hyy - hxy**2
    sound = (determinant > 1e-12) & (hxx < 0) & (hyy < 0)
    safe = np.where(sound, determinant, 1.0)
    step = np.column_stack([-(hyy * gx - hxy * gy) / safe, -(hxx * gy - hxy * gx) / safe]) * sound[:, None]
    curvature = -np.stack([np.stack([hxx, hxy], -1), np.stack([hxy, hyy], -1)], -2)
    return step, curvature, sound & (np.abs(step) <= 1).all(axis=1)
