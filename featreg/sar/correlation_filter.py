"""The filter before a correlation that places its peak best, from what two aligned images themselves have in common."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.types import FloatArray, IntArray

F32 = NDArray[np.float32]

#: Side of the squares over which spectra are averaged, px, and most of them.
SIDE, MOST = 32, 100
#: Largest coherence that is believed, squared: what interpolation and 8 bits leave is no signal.
MOST_COHERENT = 0.95


@dataclass(frozen=True, eq=False)
class CorrelationFilter:
    """A sum of separable filters.

    Parameters
    ----------
    across, down : (T, K) float32 taps along x and y
    coherence : (F,) float64 of the two images at frequencies of 0, 1, 2, ... periods over `SIDE` px
    """

    across: F32
    down: F32
    coherence: FloatArray

    @property
    def taps(self) -> tuple[F32, F32]:
        """(T, 1 + K // 2) taps along x and y from the middle on."""
        middle = self.across.shape[1] // 2
        return self.across[:, middle:].copy(), self.down[:, middle:].copy()

    def applied(self, view: F32, *, centred: bool = False) -> F32:
        """Return a filtered (H, W) map, beyond its rim mirrored; `centred` takes away what becomes of its mean."""
        import cv2

        from featreg.sar.correlation_filter_kernels import under_filter

        out = np.empty(view.shape, np.float32)
        # What a constant becomes, in float64: the sum of all taps.
        gain = float(np.einsum("tk,tl->", self.across.astype(np.float64), self.down)) if centred else 0.0
        level = np.float32(gain * cv2.mean(view)[0]) if centred else np.float32(0)
        under_filter(np.ascontiguousarray(view), *self.taps, level, out)
        return out


def filter_of_squares(first: F32, second: F32) -> CorrelationFilter | None:
    """Return the `correlation_filter` of two maps of which (N, SIDE, SIDE) squares are given."""
    corners = np.column_stack([np.zeros(len(first), np.int64), SIDE * np.arange(len(first))])
    return correlation_filter(first.reshape(-1, SIDE), second.reshape(-1, SIDE), corners)


def correlation_filter(first: F32, second: F32, corners: IntArray) -> CorrelationFilter | None:
    """Return the filter of two aligned maps that makes the peak of their correlation as sharp as their noise allows.

    Parameters
    ----------
    first, second : (H, W) float32, aligned to a fraction of a pixel, in which noise is additive (log-amplitudes)
    corners : (N, 2) int64 upper left (x, y) of squares of `SIDE` px, from which is learnt; see `square_corners`

    Returns
    -------
    The filter for both maps; None where there is no square, or nothing that they share in those there are.

    Notes
    -----
    Of maps s + n and s + m with spectra P and Q and cross-spectrum S, the correlation with the weight
    c^2 / ((1 - c^2) S) at each frequency, c^2 = S^2 / (P Q) being the squared coherence, has the peak whose position
    has the least variance (the maximum likelihood processor of [1]_): frequencies are whitened as far as both maps
    agree on them, and left out where speckle or change is all there is. Each map is filtered by the root of the weight.
    Spectra are averaged over squares under a Hann window, each of unit energy so that no bright target decides for all,
    and over directions, so that the filter has no direction of its own and does not move a peak.

    References
    ----------
    .. [1] C. H. Knapp, G. C. Carter, "The generalized correlation method for estimation of time delay", IEEE Trans.
       Acoust. Speech Signal Process. 24(4), 1976, DOI 10.1109/TASSP.1976.1162830
    """
    if not len(corners):
        return None
    turns = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.rfftfreq(SIDE)[None]) * SIDE
    cross, power, other = (_radial(part.T.astype(np.float64), turns) for part in _spectra(first, second, corners))
    cross = np.maximum(cross, 0.0)
    product = np.maximum(power * other, np.finfo(np.float64).tiny)
    squared = np.minimum(cross**2 / product, MOST_COHERENT)
    weight = np.divide(squared, (1 - squared) * cross, out=np.zeros_like(cross), where=cross > 0)
    # The mean of a square was taken away with its window's share of the lowest frequency.
    weight[0] = weight[1]
    if not weight.max() > 0:
        return None
    response = np.sqrt(np.interp(turns, np.arange(len(weight)), weight / weight.max()))
    return CorrelationFilter(*_separable(response), np.sqrt(squared))


def square_corners(shape: tuple[int, int]) -> IntArray:
    """Return the (N, 2) upper left corners (x, y) of squares spread evenly, at least half a square apart."""
    height, width = shape
    if min(height, width) < SIDE:
        return np.zeros((0, 2), np.int64)
    step = max(SIDE / 2, np.sqrt((height - SIDE + 1) * (width - SIDE + 1) / MOST))
    y, x = (
        np.rint(np.linspace(0, size - SIDE, max(1, int((size - SIDE) / step) + 1))).astype(np.int64)
        for size in (height, width)
    )
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def _spectra(first: F32, second: F32, corners: IntArray) -> F32:
    """(3, SIDE / 2 + 1, SIDE) cross-spectrum (its real part) and power spectra of squares of unit energy, by x and y.

    Of many small squares the transform is quickest as a product of matrices; squares lie by x first, then by y, so that
    none has to be turned between the two products.
    """
    from featreg.sar.square_spectra_kernels import summed_spectra, unit_squares

    window = np.hanning(SIDE + 2)[1:-1].astype(np.float32)
    along, around = _waves()
    both: list[F32] = []
    for view in (first, second):
        squares = np.empty((SIDE, len(corners), SIDE), np.float32)
        unit_squares(np.ascontiguousarray(view), np.ascontiguousarray(corners), window, squares)
        rows = along @ squares.reshape(SIDE, -1)
        waves = np.asarray(rows.reshape(-1, SIDE) @ around, np.float32)
        both.append(waves.reshape(2, SIDE // 2 + 1, len(corners), 2 * SIDE))
    sums = np.empty((3, SIDE // 2 + 1, SIDE), np.float32)
    summed_spectra(both[0], both[1], sums)
    return sums


@lru_cache(maxsize=1)
def _waves() -> tuple[F32, F32]:
    """Matrices of a real transform along x (2 * F, SIDE), real parts first, and of a complex one along y beside it."""
    angle = 2 * np.pi / SIDE * np.arange(SIDE)[:, None] * np.arange(SIDE)
    cosine, sine = np.cos(angle).astype(np.float32), -np.sin(angle).astype(np.float32)
    half = SIDE // 2 + 1
    return np.concatenate([cosine[:half], sine[:half]]), np.concatenate([cosine, sine], axis=1)


def _radial(values: FloatArray, turns: FloatArray) -> FloatArray:
    """Means over the directions of a half spectrum, by whole numbers of periods over a square."""
    weight = np.full(values.shape, 2.0)
    weight[:, [0, -1]] = 1.0
    ring = np.rint(turns).astype(np.int64).ravel()
    return np.asarray(np.bincount(ring, (values * weight).ravel()) / np.bincount(ring, weight.ravel()))


def _separable(response: FloatArray) -> tuple[F32, F32]:
    """(T, K) taps along x and along y whose products add up to the filter of a real frequency response, cut to size."""
    from featreg.sar.correlation_filter_kernels import HALF, TERMS

    kernel = np.fft.fftshift(np.fft.irfft2(response, (SIDE, SIDE)))
    middle = slice(SIDE // 2 - HALF, SIDE // 2 + HALF + 1)
    taper = np.sqrt(np.hanning(2 * HALF + 3)[1:-1])
    down, size, across = np.linalg.svd(kernel[middle, middle] * taper[:, None] * taper)
    down, across = down[:, :TERMS].T * size[:TERMS, None], across[:TERMS]
    # Symmetric but for rounding, which would move a peak.
    down, across = ((taps + taps[:, ::-1]) / 2 for taps in (down, across))
    return across.astype(np.float32), down.astype(np.float32)
