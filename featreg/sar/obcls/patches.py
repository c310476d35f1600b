"""Shifts between patches of two images by the peak of their whole cross-correlation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.sar.correlation import Peaks, peaks
from featreg.types import BoolArray, FloatArray, IntArray

#: Patches correlated at once: few enough to stay in the cache.
BATCH = 16
#: Share of a patch that must be data, or it is not correlated.
LEAST_COVERED = 0.25


def patch_shifts(
    first: NDArray[Any], second: NDArray[Any], first_at: IntArray, second_at: IntArray, size: tuple[int, int],
    *, first_valid: BoolArray | None = None, second_valid: BoolArray | None = None, padded: bool = True,
) -> Peaks:  # fmt: skip
    """Return by how much the content of patches of the second image is shifted against that of the first.

    Parameters
    ----------
    first, second : (H, W) float32 amplitude, or complex64: then the modulus of the complex correlation counts
    first_at, second_at : (N, 2) int64 first (left, upper) pixel of the patches, which lie inside the images
    size : (H, W) of a patch
    first_valid, second_valid : pixels that are data; None for all
    padded : whether the correlation is the whole one; if not, patches wrap around, for shifts that are small

    Returns
    -------
    Peaks
        `shift` is that of the content within its patch; at the highest sample and, where the peak is `sound`, beyond it
        by the quadratic through its neighbourhood. `height` is over the root of both patches' energies, at most 1.

    Notes
    -----
    The mean of each patch is removed, without which the correlation of amplitudes peaks at no shift whatever the
    content; pixels that are no data count as the mean. The correlation is the whole one of (2 H - 1) x (2 W - 1)
    shifts, with nothing outside the patches, as in section III of L. Pallotta et al., "SAR coregistration by robust
    selection of extended targets and iterative outlier cancellation". Patches hardly covered by data, or constant, have
    height 0 and are not sound.
    """
    parts = [
        _batch(
            first, second, first_at[i : i + BATCH], second_at[i : i + BATCH], size, first_valid, second_valid, padded
        )
        for i in range(0, max(len(first_at), 1), BATCH)
    ]
    return Peaks(*(np.concatenate([getattr(p, name) for p in parts]) for name in Peaks.__dataclass_fields__))


def _batch(
    first: NDArray[Any], second: NDArray[Any], first_at: IntArray, second_at: IntArray, size: tuple[int, int],
    first_valid: BoolArray | None, second_valid: BoolArray | None, padded: bool,
) -> Peaks:  # fmt: skip
    from scipy import fft

    a, a_energy = _cut(first, first_at, size, first_valid)
    b, b_energy = _cut(second, second_at, size, second_valid)
    # One shift more than needed on each side, 0 by the padding, so that every peak has neighbours.
    shape = tuple(fft.next_fast_len(2 * n + 1, real=True) for n in size) if padded else size
    if np.iscomplexobj(a):
        spectrum = fft.fft2(b, shape) * fft.fft2(a, shape).conj()
        correlation = np.abs(fft.ifft2(spectrum, overwrite_x=True))
    else:
        correlation = fft.irfft2(fft.rfft2(b, shape) * fft.rfft2(a, shape).conj(), shape)
    n = len(a)
    best = correlation.reshape(n, shape[0] * shape[1]).argmax(axis=1)
    row, column = best // shape[1], best % shape[1]
    y, x = (row[:, None] + np.arange(-1, 2)) % shape[0], (column[:, None] + np.arange(-1, 2)) % shape[1]
    energy = np.sqrt(a_energy * b_energy)
    scale = np.divide(1.0, energy, out=np.zeros(n), where=energy > 0)
    block = correlation[np.arange(n)[:, None, None], y[:, :, None], x[:, None, :]] * scale[:, None, None]
    found = peaks(np.asarray(block, np.float64))
    whole = np.column_stack([_signed(column, shape[1]), _signed(row, shape[0])]).astype(np.float64)
    return Peaks(whole + found.shift, found.height, found.curvature, found.sound & (energy > 0))


def _signed(index: IntArray, length: int) -> IntArray:
    """FFT index -> shift."""
    return np.where(index > length // 2, index - length, index)


def _cut(
    image: NDArray[Any], at: IntArray, size: tuple[int, int], valid: BoolArray | None
) -> tuple[NDArray[Any], FloatArray]:
    """(N, H, W) patches less their means, 0 where no data is, and their energies (N,), 0 where hardly any data is."""
    patch = _patches(image, at, size)
    inside = None if valid is None else _patches(valid, at, size)
    if inside is None or inside.all():
        patch = patch - patch.mean(axis=(1, 2), keepdims=True)
        share = np.ones(len(at))
    else:
        count = np.maximum(inside.sum(axis=(1, 2)), 1)
        share = count / (size[0] * size[1])
        mean = (patch * inside).sum(axis=(1, 2)) / count
        patch = (patch - mean[:, None, None].astype(image.dtype)) * inside
    flat = patch.reshape(len(at), size[0] * size[1])
    energy = np.einsum("np,np->n", flat, flat.conj()).real.astype(np.float64)
    return patch, np.where(share >= LEAST_COVERED, energy, 0.0)


def _patches(image: NDArray[Any], at: IntArray, size: tuple[int, int]) -> NDArray[Any]:
    """(N, H, W) copies of the patches."""
    out = np.empty((len(at), *size), image.dtype)
    for i, (x, y) in enumerate(at):
        out[i] = image[y : y + size[0], x : x + size[1]]
    return out
