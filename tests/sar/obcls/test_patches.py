"""Patches find known shifts, and complex images keep their carrier when they are aligned."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.geometry import Rigid
from featreg.sar.obcls.alignment import aligned
from featreg.sar.obcls.patches import patch_shifts
from made.parking_lots import Floats


def smooth_noise(seed: int, complex_: bool) -> NDArray[np.complex128] | Floats:
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    parts = [gaussian_filter(rng.normal(size=(120, 140)), 2.0, mode="wrap") for _ in range(2)]
    return parts[0] + 1j * parts[1] if complex_ else parts[0]


@pytest.mark.parametrize("complex_", [False, True])
@pytest.mark.parametrize("padded", [False, True])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (2.3, -1.6), (9.0, 5.0)])
def test_patches_find_a_known_shift(complex_: bool, padded: bool, shift: tuple[float, float]) -> None:
    image = smooth_noise(0, complex_)
    ky, kx = np.fft.fftfreq(120)[:, None], np.fft.fftfreq(140)[None, :]
    moved = np.fft.ifft2(np.fft.fft2(image) * np.exp(-2j * np.pi * (kx * shift[0] + ky * shift[1])))
    first = image.astype(np.complex64 if complex_ else np.float32)
    second = moved.astype(np.complex64) if complex_ else moved.real.astype(np.float32)
    at = np.array([[20, 10], [50, 40], [70, 60]])
    found = patch_shifts(first, second, at, at, (48, 56), padded=padded)
    assert found.sound.all()
    # What leaves a patch pulls the peak towards no shift: that is what further passes are for.
    np.testing.assert_allclose(found.shift.mean(axis=0), shift, atol=0.1 + 0.06 * max(np.abs(shift)))
    same = patch_shifts(first, first, at, at, (48, 56), padded=padded)
    np.testing.assert_allclose(same.shift, 0, atol=1e-4)
    np.testing.assert_allclose(same.height, 1, atol=1e-5)


def test_patches_without_content_have_no_peak() -> None:
    flat, at = np.ones((50, 50), np.float32), np.array([[5, 5]])
    found = patch_shifts(flat, flat, at, at, (20, 20))
    assert not found.sound.any()
    assert found.height[0] == 0
    noise = np.random.default_rng(0).random((50, 50)).astype(np.float32)
    nowhere = np.zeros((50, 50), np.bool_)
    assert not patch_shifts(noise, noise, at, at, (20, 20), first_valid=nowhere).sound.any()
    assert patch_shifts(noise, noise, at[:0], at[:0], (20, 20)).shift.shape == (0, 2)


def test_complex_images_keep_their_carrier_when_aligned() -> None:
    """A carrier that plain interpolation would destroy."""
    y, x = np.mgrid[:90, :90]
    wave = np.exp(1j * (2.4 * x - 1.9 * y)).astype(np.complex64)
    matrix = Rigid(10.0, 3.3, 18.4).matrix[:2]
    moved, inside = aligned(wave, np.ones(wave.shape, np.bool_), matrix, (60, 60))
    sx, sy = (matrix[i, 0] * x[:60, :60] + matrix[i, 1] * y[:60, :60] + matrix[i, 2] for i in (0, 1))
    inner = inside & (sx > 3) & (sy > 3) & (sx < 86) & (sy < 86)
    assert inner.sum() > 2000
    np.testing.assert_allclose(moved[inner], np.exp(1j * (2.4 * sx - 1.9 * sy))[inner], atol=0.02)
