"""How well a window of two orientation fields places its peak: how its pieces scatter, and which peaks rival it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.sar.correlation import Peaks
from featreg.types import FloatArray, IntArray

F32 = NDArray[np.float32]

#: Pieces along a window.
PIECES = 12
#: Of how many blocks of pieces the scatter that all windows have in common counts, beside those of a window itself:
#: what `benchmarks/covariances.py` finds of how much more than by chance windows differ in it.
ALIKE = 10.0
#: Fewest blocks of equal weight that a window is taken to have.
FEWEST = 2.0
#: The scatter that windows have in common is at least so large a share of that of white noise of one sample: a pair
#: without any noise is known as far as its numbers are.
LEAST_SCATTER = 1e-6


@dataclass(frozen=True, eq=False)
class Part:
    """Two fields of which windows were correlated.

    Parameters
    ----------
    here, there : (h, w, 2) float32 on the grid of the displacements
    side : samples along a window
    weight : of its correlation coefficients among those of all parts
    """

    here: F32
    there: F32
    side: int
    weight: float = 1.0


def peak_covariances(parts: Sequence[Part], xy: FloatArray, values: F32, seen: Peaks) -> FloatArray:
    """Return the covariances (N, 2, 2), samples^2, of the peaks of N windows.

    Parameters
    ----------
    parts : what the surfaces are of
    xy : (N, 2) float64 centres of the windows, samples
    values : (N, K, K) surfaces, the weighted mean of the parts' correlation coefficients
    seen : their peaks, sound ones of positive height

    Notes
    -----
    A peak is where the slope of the correlation is 0, a sum over the pixels of the window. With S the variance of that
    slope and H minus the second derivatives of the peak its covariance is H^-1 S H^-1 (White 1980). S is the sum of
    squares of the slopes of blocks of pieces at the peak, overlapping by half. Blocks of side L leave out what
    neighbours share: a share u / L of the root of S for each axis, so that blocks of one piece and of two, over all
    windows, tell what blocks without end would give. Summed up at the peak, the slopes of n blocks of equal weight
    have lost one in n. The slope of a pixel is (a grad b - b grad a) / 2, which is 0 for a pair without noise.
    Windows have few blocks, and a peak that noise has made looks sharper than it is. So S is averaged with what the
    windows have in common, (1 - rho^2) / (n rho) H with one n for all (the Cramer-Rao bound of n independent samples of
    correlation rho), as if by `ALIKE` blocks.

    Speckle lets a window choose another peak than the right one. Taken as the logarithm of a likelihood, the
    correlation over k = tr(S H^-1) / 2 has at its peak the curvature that belongs to S. The covariance is that of
    the displacement under this likelihood, about the peak, over all that was searched (Chernozhukov and Hong 2003);
    the peak itself has its Gaussian integral and H^-1 S H^-1, what is more than a sample off counts sample by sample.

    References
    ----------
    H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48 (1980) 817, DOI
    10.2307/1912934; V. Chernozhukov, H. Hong, "An MCMC approach to classical estimation", J. Econometrics 115 (2003)
    293, DOI 10.1016/S0304-4076(03)00100-3
    """
    if not len(xy):
        return np.empty((0, 2, 2))
    side = values.shape[1]
    whole = np.stack(np.divmod(values.reshape(len(values), -1).argmax(axis=1), side)[::-1], axis=1) - side // 2
    moved, step = whole.astype(np.int64), seen.shift - whole
    curvature = seen.curvature
    scatter = _scatter(_slopes(parts, xy, moved), step)
    covariance, sharpness = _local(scatter, curvature, seen.height)
    return _with_rivals(covariance, sharpness, curvature, values, seen.height, moved, step)


@dataclass(frozen=True, eq=False)
class Scatter:
    """Variance of the slope of N windows.

    Parameters
    ----------
    variance : (N, 2, 2), in coefficients of correlation per sample, squared
    blocks : (N,) blocks of equal weight that tell it
    """

    variance: FloatArray
    blocks: FloatArray


def _slopes(parts: Sequence[Part], xy: FloatArray, moved: IntArray) -> FloatArray:
    """(N, P, P, 5) sums of `slopes_of_windows` of all parts, per coefficient, on the pieces of the widest one."""
    from featreg.sar.orientation.precision_kernels import SUMS, slopes_of_windows

    widest = max(part.side for part in parts)
    piece = max(1, widest // PIECES)
    total = np.zeros((len(xy), PIECES, PIECES, SUMS))
    for part in parts:
        count = min(part.side // piece, PIECES)
        sums, energy = np.empty((len(xy), count, count, SUMS), np.float32), np.empty((len(xy), 2), np.float32)
        first = np.rint(xy - (count * piece - 1) / 2).astype(np.int64)
        here, there = (np.ascontiguousarray(field).ravel() for field in (part.here, part.there))
        height, width = part.here.shape[:2]
        slopes_of_windows(
            here, there, height, width, first, np.ascontiguousarray(moved), count * piece, piece, sums, energy
        )
        # What whole pieces leave of a window counts as they do.
        unit = (
            part.weight
            * (count * piece / part.side)
            / np.sqrt(np.maximum(energy.prod(axis=1, dtype=np.float64), 1e-12))
        )
        low = (PIECES - count) // 2
        total[:, low : low + count, low : low + count] += sums * unit[:, None, None, None]
    return total


def _scatter(slopes: FloatArray, step: FloatArray) -> Scatter:
    """How the slope of windows varies, from those of their pieces at the peak, `step` (N, 2) from whole samples."""
    x, y = step[:, 0, None, None], step[:, 1, None, None]
    gx, gy, xx, xy, yy = np.moveaxis(slopes, -1, 0)
    at_peak = np.stack([gx - xx * x - xy * y, gy - xy * x - yy * y, xx + yy], axis=-1)
    single = np.einsum("nrci,nrcj->nij", at_peak[..., :2], at_peak[..., :2])
    double = _blocks(at_peak)
    variance = np.einsum("nrci,nrcj->nij", double[..., :2], double[..., :2]) / 4
    # Blocks that reach over the rim of the window hold less.
    sharp = (double[..., 2] ** 2).sum(axis=(1, 2)) / 4
    blocks = np.maximum(at_peak[..., 2].sum(axis=(1, 2)) ** 2 / np.maximum(sharp, 1e-30), FEWEST)
    one, two = (np.trace(part, axis1=1, axis2=2) for part in (single, variance))
    known = two > 0
    ratio = float(np.median(np.sqrt(one[known] / two[known]))) if known.any() else 1.0
    beyond = (2 - min(ratio, 1.0)) ** 2
    return Scatter(variance * (beyond * blocks / (blocks - 1))[:, None, None], blocks)


def _blocks(values: FloatArray) -> FloatArray:
    """(N, P + 1, P + 1, K) sums of 2 x 2 of (N, P, P, K) values, 0 around them."""
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1), (0, 0)))
    rows = padded[:, 1:] + padded[:, :-1]
    return np.asarray(rows[:, :, 1:] + rows[:, :, :-1])


def _local(scatter: Scatter, curvature: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariances (N, 2, 2) of the peaks, and by how much correlation falls in a unit of log-likelihood (N,)."""
    inverse = np.linalg.inv(curvature)
    # Of white noise S is so many times H.
    white = np.maximum(1 - height**2, 1e-6) / height
    own = np.einsum("nij,nji->n", scatter.variance, inverse) / 2
    share = max(float(np.sum(scatter.blocks * own / white) / np.sum(scatter.blocks)), LEAST_SCATTER)
    told = scatter.blocks - 1
    common = (share * white)[:, None, None] * curvature
    variance = (told[:, None, None] * scatter.variance + ALIKE * common) / (told + ALIKE)[:, None, None]
    return inverse @ variance @ inverse, np.einsum("nij,nji->n", variance, inverse) / 2


def _with_rivals(
    covariance: FloatArray,
    unit: FloatArray,
    curvature: FloatArray,
    values: F32,
    height: FloatArray,
    moved: IntArray,
    step: FloatArray,
) -> FloatArray:
    """Covariances (N, 2, 2) about the peaks that count what else of the surface may be the right displacement."""
    side = values.shape[1]
    axis = np.arange(side) - side // 2
    dx, dy = axis - moved[:, 0, None], axis - moved[:, 1, None]
    far = np.maximum(np.abs(dx)[:, None, :], np.abs(dy)[:, :, None]) > 1
    top = height + np.einsum("ni,nij,nj->n", step, curvature, step) / 2
    likely = np.where(far, np.exp(np.minimum((values - top[:, None, None]) / unit[:, None, None], 0.0)), 0.0)
    # The integral of the peak itself, of which its quadratic is the logarithm.
    own = 2 * math.pi * unit / np.sqrt(np.linalg.det(curvature))
    total = own + likely.sum(axis=(1, 2))
    x, y = dx - step[:, 0, None], dy - step[:, 1, None]
    along, down = likely.sum(axis=1), likely.sum(axis=2)
    both = np.einsum("nyx,nx,ny->n", likely, x, y)
    second = np.stack([(along * x**2).sum(axis=1), both, both, (down * y**2).sum(axis=1)], axis=-1).reshape(-1, 2, 2)
    return np.asarray((own[:, None, None] * covariance + second) / total[:, None, None])
