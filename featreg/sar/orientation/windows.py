"""Local orientation correlation: what each window of two aligned fields says of its own displacement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from featreg.sar.orientation.levels import Level
from featreg.sar.orientation.precision import Part
from featreg.types import FloatArray, IntArray

F32 = NDArray[np.float32]

#: Least share of a window that both images must hold.
LEAST_VALID = 0.5
#: Correlations are related to the energy at their shift, at least to this share of the largest.
LEAST_ENERGY = 0.3
#: Windows that are transformed at once, so that they stay in the cache.
BATCH = 64


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Correlation surfaces of N windows.

    Parameters
    ----------
    xy : (N, 2) float64 centres of the windows, samples
    values : (N, 2 S + 1, 2 S + 1) float32 correlation coefficients; element [i, S + dy, S + dx] for the window of the
        second field displaced by (dx, dy)
    samples : (N,) float64 samples of a window that both images hold
    side : samples along a window
    parts : the fields that were correlated
    """

    xy: FloatArray
    values: F32
    samples: FloatArray
    side: int
    parts: tuple[Part, ...] = ()

    def __len__(self) -> int:
        return len(self.xy)

    @property
    def reach(self) -> int:
        """S, the largest displacement."""
        return int(self.values.shape[1]) // 2


def correlated(level: Level, side: int, reach: int, step: int | None = None, most: int | None = None) -> Surfaces:
    """Correlate windows of `side` samples, on a regular grid, over all displacements up to `reach`.

    Parameters
    ----------
    level : the aligned fields
    side, reach : samples
    step : between neighbouring windows; None for windows that touch
    most : at most so many of them, evenly taken; None for all

    Notes
    -----
    The real part of the sum of z1* z2 over the root of the sums of |z1|^2 and |z2|^2. Without data z is 0.
    """
    import cv2

    height, width = level.valid.shape
    step = step or side
    count = [max(0, (n - side) // step + 1) for n in (height, width)]
    down, across = (
        (n - side - (k - 1) * step) // 2 + step * np.arange(k) for n, k in zip((height, width), count, strict=True)
    )
    at = np.stack(np.meshgrid(down, across, indexing="ij"), -1).reshape(-1, 2)
    held = cv2.integral(level.valid.view(np.uint8))
    y, x = at.T
    samples = np.asarray(held[y + side, x + side] - held[y, x + side] - held[y + side, x] + held[y, x], np.int64)
    kept = np.flatnonzero(samples >= LEAST_VALID * side**2)
    if most is not None and len(kept) > most:
        kept = kept[np.arange(most) * len(kept) // most]
    at, samples = at[kept], samples[kept]
    values, middles = _values(level, at, side, reach), at[:, ::-1] + (side - 1) / 2
    return Surfaces(middles, values, samples.astype(np.float64), side, (Part(level.here, level.there, side),))


def correlated_around(level: Level, reference_xy: FloatArray, side: int, reach: int) -> F32:
    """As the values of `correlated`, of windows around (N, 2) points of the reference, moved into the level."""
    room = np.array(level.valid.shape)
    side = min(side, *level.valid.shape)
    back = np.linalg.inv(level.to_reference)
    middle = reference_xy @ back[:2, :2].T + back[:2, 2]
    return _values(
        level, np.clip(np.rint(middle[:, ::-1] - (side - 1) / 2).astype(np.int64), 0, room - side), side, reach
    )


def _values(level: Level, at: IntArray, side: int, reach: int) -> F32:
    """(N, 2 S + 1, 2 S + 1) coefficients of the windows that begin at (y, x), (N, 2), S being the reach."""
    from featreg.sar.orientation import window_kernels

    values = np.zeros((len(at), 2 * reach + 1, 2 * reach + 1), np.float32)
    (_directly if side + 2 * reach <= window_kernels.MOST_WIDE else _by_spectra)(level, at, side, reach, values)
    return values


def _directly(level: Level, at: IntArray, side: int, reach: int, values: F32) -> None:
    """Fill the values by sums of products: a third of the time of spectra for few displacements."""
    from featreg.sar.orientation import window_kernels

    here, there = (np.ascontiguousarray(field).ravel() for field in (level.here, level.there))
    y, x = np.ascontiguousarray(at.T)
    height, width = level.valid.shape
    window_kernels.correlations_of_windows(here, there, height, width, y, x, side, reach, LEAST_ENERGY, values)


def _by_spectra(level: Level, at: IntArray, side: int, reach: int, values: F32) -> None:
    """Fill the values by Fourier transforms, of any window and any displacement."""
    import cv2
    from scipy import fft

    wide, shifts = side + 2 * reach, 2 * reach + 1
    n = fft.next_fast_len(wide)
    padded = cv2.copyMakeBorder(level.there, *(reach,) * 4, cv2.BORDER_CONSTANT, value=0)
    here, there = (np.ascontiguousarray(field).view(np.complex64)[..., 0] for field in (level.here, padded))
    energies = _energy(level.here, side), _energy(np.asarray(padded, np.float32), side)
    for start in range(0, len(at), BATCH):
        y, x = at[start : start + BATCH].T
        one = fft.fft2(sliding_window_view(here, (side, side))[y, x], (n, n))
        product = fft.fft2(sliding_window_view(there, (wide, wide))[y, x], (n, n))
        product *= np.conjugate(one, out=one)
        found = fft.ifft2(product, overwrite_x=True).real[:, :shifts, :shifts]
        energy = sliding_window_view(energies[1], (shifts, shifts))[y, x]
        energy = np.maximum(energy, LEAST_ENERGY * energy.max(axis=(1, 2), keepdims=True))
        energy *= energies[0][y, x][:, None, None]
        values[start : start + BATCH] = found / np.sqrt(energy + 1e-12)


def _energy(field: F32, side: int) -> F32:
    """Sum of the squared lengths of a field (H, W, 2) over the window that begins at each sample, float32."""
    import cv2

    square = field[..., 0] ** 2 + field[..., 1] ** 2
    total = cv2.boxFilter(square, -1, (side, side), anchor=(0, 0), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(np.maximum(total, 0), np.float32)


def together(found: Surfaces, rotation_deg: float, zoom: float, steps: int) -> tuple[float, FloatArray]:
    """Return what displacement of all windows by one similarity fits best.

    Parameters
    ----------
    found : of N windows
    rotation_deg, zoom : rotations up to this, and zooms up to this factor less 1, are tried about their middle
    steps : of each, an odd number

    Returns
    -------
    mean : of the correlation coefficients there
    affine : (2, 3) samples -> displaced samples
    """
    from featreg.sar.orientation import orientation_kernels

    middle = found.xy.mean(axis=0)
    angles, zooms = np.radians(np.linspace(-rotation_deg, rotation_deg, steps)), np.linspace(-zoom, zoom, steps)
    angle, size = (part.ravel() for part in np.meshgrid(angles, np.exp(zooms), indexing="ij"))
    c, s = size * np.cos(angle), size * np.sin(angle)
    linear = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    moves = np.rint(np.einsum("hij,nj->hni", linear - np.eye(2), found.xy - middle)).astype(np.int64)
    out = np.empty((len(linear), 3))
    orientation_kernels.stacked(found.values, moves, out)
    best = int(out[:, 0].argmax())
    shift = out[best, [2, 1]]
    return float(out[best, 0]) / len(found), np.column_stack([linear[best], middle + shift - linear[best] @ middle])


def log10_chance(found: Surfaces, tolerance: int, affine: FloatArray | None = None) -> float:
    """Return the probability, as log10, that windows of unrelated fields speak for one displacement so well.

    It is that by an affine map (2, 3) of samples, none by default.

    A window's p value is the share of all displacements around which, within the tolerance in samples, its
    correlation gets as high as it does around that. Their logarithms are summed (R. A. Fisher): for N unrelated windows
    minus that sum has a gamma distribution of shape N.
    """
    import cv2

    from featreg.sar.orientation import orientation_kernels

    if not len(found):
        return 0.0
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * tolerance + 1,) * 2)
    around = np.argwhere(disc)[:, ::-1] - tolerance
    moves = np.zeros((len(found), 2)) if affine is None else found.xy @ affine[:, :2].T + affine[:, 2] - found.xy
    at = np.clip(np.rint(moves).astype(np.int64) + found.reach - tolerance, 0, 2 * (found.reach - tolerance))
    shares, values = np.empty(len(found)), np.ascontiguousarray(found.values).ravel()
    orientation_kernels.shares_as_high(
        values, 2 * found.reach + 1, np.ascontiguousarray(around), tolerance, np.ascontiguousarray(at), shares
    )
    return _log10_gamma_tail(-float(np.log(shares).sum()), len(found))


def _log10_gamma_tail(value: float, shape: int) -> float:
    """log10 of the probability that a gamma variable of a whole-number shape exceeds a value."""
    # exp(-x) times the sum over k < shape of x^k / k!, in logarithms.
    if not value > 0:
        return 0.0
    terms = np.array([k * math.log(value) - math.lgamma(k + 1) for k in range(shape)])
    top = float(terms.max())
    return (top - value + math.log(float(np.exp(terms - top).sum()))) / math.log(10)
