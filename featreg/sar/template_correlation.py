"""Templates of many channels sought in a search area by FFT, and how far their best place stands out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.sar.correlation import Peaks, peaks
from featreg.types import FloatArray, IntArray

F32 = NDArray[np.float32]

#: Correlations are related to the energy at their place, at least to this share of the largest.
LEAST_ENERGY = 0.3
#: Surfaces that are kept at a time, and their bytes together, where one alone has fewer.
BATCH, BATCH_BYTES = 32, 64 << 20


@dataclass(frozen=True, eq=False)
class Places:
    """Where N templates fit best.

    Parameters
    ----------
    peaks : of their correlation surfaces
    runner_up : (N,) float64, the highest correlation away from the peak over that at the peak; 0 where none is positive
    """

    peaks: Peaks
    runner_up: FloatArray


def best_places(here: F32, there: F32, corners: IntArray, side: int, reach: int, apart: int) -> Places:
    """Seek templates of `side` pixels at every displacement up to `reach` along x and y.

    Parameters
    ----------
    here : (K, h, w) float32 channels that hold the templates
    there : (K, h + 2 reach, w + 2 reach) float32 channels of the aligned other image, whose pixel (reach, reach) lies
        where (0, 0) of `here` does; 0 where nothing is known
    corners : (N, 2) int64 upper left pixels (x, y) of the templates in `here`
    side, reach : px
    apart : a second place differs from the best one by more than this along x or y, px

    Notes
    -----
    The surface is the sum over the channels of the products of template and search area, by the correlation theorem in
    one inverse transform, over the root of both energies.
    """
    import cv2
    from scipy import fft

    wide, shifts = side + 2 * reach, 2 * reach + 1
    n = fft.next_fast_len(wide, real=True)
    energies = []
    for channels in (here, there):
        total = np.einsum("kij,kij->ij", channels, channels)
        box = cv2.boxFilter(total, -1, (side, side), anchor=(0, 0), normalize=False, borderType=cv2.BORDER_CONSTANT)
        energies.append(np.maximum(np.asarray(box, np.float32), 0))
    parts, ratios = [], []
    together = max(1, min(BATCH, BATCH_BYTES // (np.dtype(np.float64).itemsize * shifts * shifts)))
    for start in range(0, len(corners), together):
        batch = corners[start : start + together]
        values = np.empty((len(batch), shifts, shifts))
        for row, (x, y) in enumerate(batch.tolist()):
            template = fft.rfft2(here[:, y : y + side, x : x + side], (n, n))
            product = fft.rfft2(there[:, y : y + wide, x : x + wide], (n, n))
            product *= np.conjugate(template, out=template)
            found = fft.irfft2(product.sum(axis=0), (n, n))[:shifts, :shifts]
            energy = energies[1][y : y + shifts, x : x + shifts]
            energy = np.maximum(energy, LEAST_ENERGY * energy.max()) * energies[0][y, x]
            values[row] = found / np.sqrt(energy + np.float32(1e-12))
        parts.append(peaks(values))
        ratios.append(runner_up(values, apart))
    if not parts:
        return Places(peaks(np.zeros((0, shifts, shifts))), np.zeros(0))
    found_peaks = Peaks(*(np.concatenate([getattr(p, name) for p in parts]) for name in Peaks.__dataclass_fields__))
    return Places(found_peaks, np.concatenate(ratios))


def runner_up(surfaces: FloatArray, apart: int) -> FloatArray:
    """Return the (N,) highest value of each (N, K, K) surface away from its peak, over the peak.

    The pixels within `apart` of the peak along x and y are suppressed. 0 where nothing positive is left.
    """
    count, side, _ = surfaces.shape
    best = surfaces.reshape(count, -1).argmax(axis=1)
    y, x = np.divmod(best, side)
    steps = np.arange(side)
    near = (np.abs(steps - y[:, None]) <= apart)[:, :, None] & (np.abs(steps - x[:, None]) <= apart)[:, None, :]
    top = surfaces.reshape(count, -1)[np.arange(count), best]
    second = np.where(near, 0.0, surfaces).max(axis=(1, 2), initial=0.0)
    return np.asarray(np.where(top > 0, second / np.where(top > 0, top, 1.0), 0.0))
