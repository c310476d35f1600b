"""CFAR detection: cells that stand out of the clutter around them at a set false-alarm probability.

A cell under test of power X is detected where X > a Z. Z is an estimate of the clutter's mean power from the training
cells: those of a square window around the cell, less a smaller square of guard cells. The factor a is that at which a
cell of homogeneous clutter, gamma distributed with L looks (L = 1: exponential), is detected with probability Pfa.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Interval
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.runtime.parameters import Count, Positive, Probability, Share, checked
from featreg.types import BoolArray, FloatArray, IntArray, read_only

Method = Literal["ca", "goca", "soca", "os", "tm", "cs"]
Guard = Annotated[int, Ge(0)]
Trim = Annotated[float, Interval(ge=0, lt=0.5)]
#: Share of a whole window's training cells that must exist, or the cell is not tested.
LEAST_SHARE = 0.1
#: Farthest training cell, px.
FARTHEST = 512
#: Above so many training cells, factors that need a search are solved for some numbers of cells and interpolated.
EXACT = 2000
#: Rows worked on at once, so that the sums of a strip stay in the cache.
STRIP = 128


@checked("cfar")
def detect(
    power: NDArray[np.float32],
    valid: BoolArray,
    *,
    method: Method = "ca",
    pfa: Probability = 1e-2,
    guard: Guard = 8,
    train: Count = 8,
    looks: Positive = 1.0,
    rank: Share = 0.75,
    trim: Trim = 0.25,
) -> BoolArray:
    """Return which cells stand out of the clutter around them.

    Parameters
    ----------
    power : (H, W) float32 intensity, >= 0
    valid : (H, W) bool, True = data; other cells are neither tested nor trained on
    method : "ca" (mean of the training cells), "goca", "soca" (greatest, smallest of the means of the window's four
        sides), "os" (order statistic), "tm" (mean without the smallest and the largest), "cs" (censored: mean without
        the largest)
    pfa : probability of false alarm in homogeneous clutter
    guard : cells on each side of the tested one that are not trained on
    train : cells beyond the guard on each side that are
    looks : of the intensity
    rank : "os": the order statistic, as a share of the training cells
    trim : "tm", "cs": share of the training cells that is left out at each end that is trimmed

    Returns
    -------
    (H, W) bool

    Raises
    ------
    ParameterError
        An unknown method or an impossible value.

    Notes
    -----
    At borders and masks only the training cells that exist are used, and the factor is that for their number. A side
    takes part in GOCA and SOCA where half of its cells exist; the four sides are equal rectangles that wind around the
    guard. CA, GOCA and SOCA take their sums from integral images, at a cost that does not depend on the window.

    References
    ----------
    H. Rohling, "Radar CFAR thresholding in clutter and multiple target situations", IEEE Trans. AES 19(4), 608-621,
    1983, DOI 10.1109/TAES.1983.309350 (CA, OS)

    P. P. Gandhi, S. A. Kassam, "Analysis of CFAR processors in nonhomogeneous background", IEEE Trans. AES 24(4),
    427-445, 1988, DOI 10.1109/7.7185 (all six)
    """
    from featreg.sar.obcls import cfar_kernels

    check_window(guard, train)
    reach = guard + train
    whole = (2 * reach + 1) ** 2 - (2 * guard + 1) ** 2
    side = train * (reach + guard + 1)
    found = np.empty(power.shape, np.bool_)
    factors: FloatArray
    if method in ("goca", "soca"):
        table = [threshold_factors(method, pfa, side, looks, sides=k) for k in (1, 2, 3, 4)]
        factors = np.pad(np.stack(table), ((1, 0), (1, 0)))
    else:
        factors = np.concatenate([[0.0], threshold_factors(method, pfa, whole, looks, rank, trim)])
        factors[: max(1, round(LEAST_SHARE * whole))] = 0.0
    for top in range(0, power.shape[0], STRIP):
        rows = slice(top, min(top + STRIP, power.shape[0]))
        cells, there = _padded(power, valid, rows, reach)
        out = found[rows]
        if method in ("goca", "soca"):
            sums, numbers = _integral(cells), _integral(there)
            cfar_kernels.sided(cells, sums, numbers, method == "goca", factors, guard, reach, out)
            continue
        counts = _ring_counts(there, guard, reach)
        if method == "ca":
            scale = (factors / np.maximum(np.arange(whole + 1), 1))[counts]
            cfar_kernels.cell_averaging(cells, _integral(cells), scale, guard, reach, out)
            out &= scale > 0
            continue
        n = np.arange(whole + 1)
        cells[there == 0] = np.inf
        if method == "os":
            ranks = np.where(factors > 0, os_rank(n, rank), 0)
            cfar_kernels.order_statistic(cells, counts, ranks, factors, guard, reach, out)
        else:
            low, high = kept_cells(method, n, trim)
            cfar_kernels.trimmed_mean(cells, counts, low, high, factors, guard, reach, out)
    return found & valid


def check_window(guard: int, train: int) -> None:
    """Raise `ParameterError` where the window of `detect` is too large."""
    if guard + train > FARTHEST:
        raise ParameterError(f"CFAR needs guard + train <= {FARTHEST}, got {guard} + {train}")


@lru_cache(maxsize=64)
def threshold_factors(
    method: str, pfa: float, cells: int, looks: float = 1.0, rank: float = 0.75, trim: float = 0.25, sides: int = 4
) -> FloatArray:
    """Return the (cells,) float64 factors a of X > a Z for 1, 2, ..., `cells` training cells.

    Parameters
    ----------
    method, pfa, looks, rank, trim : as in `detect`
    cells : most training cells; for "goca" and "soca" of each side
    sides : "goca", "soca": how many sides there are

    Notes
    -----
    CA: X / Z follows Fisher's F with 2 L and 2 n L degrees of freedom, so a = n (1 - w) / w with w the Pfa quantile of
    Beta(n L, L); for one look n (Pfa^(-1/n) - 1). GOCA, SOCA, OS: Pfa is the mean of the gamma tail Q(L, L a z) over
    the distribution of z, integrated over its quantiles. OS, TM, CS of one look: ordered exponential cells are sums of
    independent ones, so that Pfa is a product. TM, CS of more looks: the mean over seeded draws of Z.
    Where the tail is integrated or drawn, some numbers of cells are solved for and the rest is interpolated in 1 / n.
    """
    if method == "ca":
        from scipy.special import betaincinv

        n = np.arange(1, cells + 1)
        w = betaincinv(n * looks, looks, pfa)
        return read_only(np.asarray(n * (1 - w) / w))
    one_look = method in ("os", "tm", "cs") and looks == 1
    some = np.arange(1, cells + 1) if one_look and cells <= EXACT else _some(cells)
    if one_look:
        solved = [_of_one_look(method, pfa, int(n), rank, trim) for n in some]
    elif method in ("goca", "soca"):
        solved = [_solve(_tail_of(_side_means(method, n, looks, sides), looks), pfa) for n in some]
    elif method == "os":
        solved = [_solve(_tail_of(_order_statistics(n, looks, rank), looks), pfa) for n in some]
    else:
        solved = [_solve(_tail_of(_drawn(method, n, looks, trim), looks), pfa) for n in some]
    inverse = 1.0 / np.arange(1, cells + 1)
    return read_only(np.interp(inverse[::-1], 1.0 / some[::-1], np.array(solved)[::-1])[::-1])


def kept_cells(method: str, n: IntArray, trim: float) -> tuple[IntArray, IntArray]:
    """How many of n training cells "tm" or "cs" leaves out: the smallest, the largest."""
    high = np.floor(trim * n).astype(np.int64)
    return np.asarray(high if method == "tm" else np.zeros_like(high)), np.asarray(high)


def os_rank(n: IntArray, rank: float) -> IntArray:
    """The order statistic, counted from 1, that "os" takes of n training cells."""
    return np.asarray(np.clip(np.rint(rank * n), 1, np.maximum(n, 1)), np.int64)


def _some(cells: int) -> IntArray:
    """1, 2, ... with growing steps, up to `cells`."""
    return np.unique(np.rint(np.geomspace(1, cells, min(cells, 4 + 3 * int(np.log2(cells) + 1)))).astype(np.int64))


# Quantiles of a probability, dense towards 0 and 1: logistic steps, and the weight of each.
_S = np.linspace(-30, 30, 401)
_V = 1 / (1 + np.exp(-_S))
_WEIGHT: FloatArray = _V / (1 + np.exp(_S)) * (_S[1] - _S[0])
Quantiles = tuple[FloatArray, FloatArray]


def _side_means(method: str, n: int, looks: float, sides: int) -> Quantiles:
    """Quantiles of the greatest (smallest) of the means of `sides` sides of n cells, and their weights."""
    from scipy.special import gammainccinv, gammaincinv

    if method == "goca":
        return np.asarray(gammaincinv(n * looks, _V ** (1 / sides)) / (n * looks)), _WEIGHT
    return np.asarray(gammainccinv(n * looks, _V[::-1] ** (1 / sides)) / (n * looks)), _WEIGHT


def _order_statistics(n: int, looks: float, rank: float) -> Quantiles:
    """Quantiles of the order statistic of n cells: that of n uniform ones is Beta(k, n - k + 1)."""
    from scipy.special import betaincinv, gammaincinv

    k = int(os_rank(np.array(n), rank))
    return np.asarray(gammaincinv(looks, np.minimum(betaincinv(k, n - k + 1, _V), 1 - 1e-16)) / looks), _WEIGHT


def _drawn(method: str, n: int, looks: float, trim: float) -> Quantiles:
    """Seeded draws of the trimmed mean of n cells."""
    draws = max(1024, min(8192, 200_000 // n))
    cells = np.sort(np.random.default_rng(n).gamma(looks, 1 / looks, (draws, n)), axis=1)
    low, high = (int(k) for k in kept_cells(method, np.array(n), trim))
    return cells[:, low : n - high].mean(axis=1), np.full(draws, 1 / draws)


def _tail_of(quantiles: Quantiles, looks: float) -> Callable[[float], float]:
    """Pfa as a function of the factor: the mean gamma tail beyond factor * z."""
    from scipy.special import gammaincc

    z, weight = quantiles
    return lambda a: float(weight @ (np.exp(-a * z) if looks == 1 else gammaincc(looks, looks * a * z)))


def _solve(tail: Callable[[float], float], pfa: float) -> float:
    """The factor at which a falling tail equals pfa, to 1e-5 of itself."""
    low, high = 0.0, 1.0
    while tail(high) > pfa and high < 1e12:
        low, high = high, 2 * high
    for _ in range(18):
        middle = (low + high) / 2
        low, high = (middle, high) if tail(middle) > pfa else (low, middle)
    return (low + high) / 2


def _of_one_look(method: str, pfa: float, n: int, rank: float, trim: float) -> float:
    """OS, TM, CS of n cells of exponential clutter.

    X_(i) = sum of E_j / (n - j + 1) over j <= i with E_j exponential of mean 1, so ln Pfa = - sum ln(1 + a c_j), c_j
    the share of the kept cells from the j-th on over n - j + 1. It is convex in a, and Newton's steps from 0 rise to
    the root without overshooting.
    """
    j = np.arange(n)
    if method == "os":
        shares = (j < int(os_rank(np.array(n), rank))).astype(np.float64)
    else:
        low, high = (int(k) for k in kept_cells(method, np.array(n), trim))
        shares = np.clip(n - high - np.maximum(j, low), 0, None) / (n - high - low)
    c = shares / (n - j)
    a = 0.0
    for _ in range(100):
        step = float((np.log1p(a * c).sum() + np.log(pfa)) / (c / (1 + a * c)).sum())
        a -= step
        if abs(step) < 1e-9 * a:
            break
    return a


def _padded(
    power: NDArray[np.float32], valid: BoolArray, rows: slice, reach: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A strip of the power and of the mask (as 0 and 1) with `reach` cells more on each side, 0 where none exist."""
    height, width = power.shape
    top, bottom = max(rows.start - reach, 0), min(rows.stop + reach, height)
    above = top - (rows.start - reach)
    size = (rows.stop - rows.start + 2 * reach, width + 2 * reach)
    cells, there = np.zeros(size, np.float32), np.zeros(size, np.float32)
    inner = slice(above, above + bottom - top), slice(reach, reach + width)
    there[inner] = valid[top:bottom]
    cells[inner] = power[top:bottom] * there[inner]
    return cells, there


def _integral(padded: NDArray[np.float32]) -> FloatArray:
    import cv2

    return np.asarray(cv2.integral(padded, sdepth=cv2.CV_64F))


def _ring_counts(there: NDArray[np.float32], guard: int, reach: int) -> IntArray:
    """(H, W) number of training cells that exist around each cell of a padded strip."""
    import cv2

    outer, inner = (
        np.asarray(cv2.boxFilter(there, -1, (2 * k + 1, 2 * k + 1), normalize=False, borderType=cv2.BORDER_CONSTANT))
        for k in (reach, guard)
    )
    ring = (outer - inner)[reach : there.shape[0] - reach, reach : there.shape[1] - reach]
    return (ring + np.float32(0.5)).astype(np.int64)
