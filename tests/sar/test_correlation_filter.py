"""The filter before a correlation: what it keeps, sharper peaks than any smoothing, no direction, no pixel locking."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import fourier_shift, gaussian_filter

from featreg.sar.correlation import local_correlations, peaks
from featreg.sar.correlation_filter import SIDE, CorrelationFilter, _spectra, correlation_filter, square_corners
from featreg.sar.correlation_filter_kernels import HALF, TERMS

F32 = NDArray[np.float32]


def maps(
    noise: float, smooth: float = 1.0, shift: tuple[float, float] = (0.0, 0.0), size: int = 300
) -> tuple[F32, F32]:
    """The same texture twice, the second moved by `shift` (x, y), each under white noise of its own."""
    rng = np.random.default_rng(3)
    texture = gaussian_filter(rng.normal(size=(size, size)), smooth, mode="wrap")
    texture /= texture.std()
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(texture), shift[::-1])).real
    first, second = (one + rng.normal(0, noise, one.shape) for one in (texture, moved))
    return first.astype(np.float32), second.astype(np.float32)


def made(first: F32, second: F32, corners: NDArray[np.int64] | None = None) -> CorrelationFilter:
    found = correlation_filter(first, second, square_corners(first.shape) if corners is None else corners)
    assert found is not None
    return found


def response(found: CorrelationFilter) -> NDArray[np.float64]:
    """At 0, 1, 2, ... periods over SIDE px, along x."""
    kernel = np.einsum("ty,tx->yx", found.down.astype(np.float64), found.across)
    wide = np.zeros((SIDE, SIDE))
    wide[: 2 * HALF + 1, : 2 * HALF + 1] = kernel
    return np.asarray(np.abs(np.fft.rfft2(wide))[0], np.float64)


def shifts(first: F32, second: F32) -> NDArray[np.float64]:
    x, y = np.meshgrid(np.arange(32, 268, 12), np.arange(32, 268, 12))
    found = peaks(local_correlations(first, second, np.column_stack([x.ravel(), y.ravel()]), 24, 2))
    assert found.sound.mean() > 0.9
    return found.shift[found.sound]


def test_the_coherence_is_that_of_the_maps() -> None:
    """A texture of Gaussian spectrum in white noise: c = S / (S + N)."""
    found = made(*maps(0.5))
    f = np.arange(SIDE // 2 + 1) / SIDE
    signal = np.exp(-((2 * np.pi * f) ** 2))
    signal *= 4 * np.pi  # unit variance: the integral over all frequencies is 1
    wanted = signal / (signal + 0.25)
    np.testing.assert_allclose(found.coherence[2:9], wanted[2:9], atol=0.08)


def test_noise_decides_how_much_is_smoothed() -> None:
    little, much = (response(made(*maps(noise))) for noise in (0.2, 2.0))
    high = slice(9, 13)  # 0.28 to 0.4 periods a pixel
    assert (little[high] / little.max()).min() > 0.8
    assert (much[high] / much.max()).max() < 0.5


@pytest.mark.parametrize("noise", [0.5, 1.0, 2.0])
def test_peaks_are_placed_better_than_after_any_smoothing(noise: float) -> None:
    first, second = maps(noise, shift=(0.3, -0.4))

    def error(one: F32, other: F32) -> float:
        return float(np.sqrt(((shifts(one, other) - (0.3, -0.4)) ** 2).sum(axis=1).mean()))

    best = made(first, second)
    filtered = error(best.applied(first), best.applied(second))
    smoothed = [
        error(*(np.asarray(gaussian_filter(one, sigma), np.float32) for one in (first, second)))
        for sigma in (0.5, 0.7, 1.0, 1.5)
    ]
    assert filtered < 1.03 * min(smoothed)
    assert filtered < 0.95 * smoothed[2]


def test_no_fraction_of_a_pixel_is_preferred() -> None:
    for off in np.linspace(-0.5, 0.5, 6):
        first, second = maps(0.3, shift=(off, -off))
        best = made(first, second)
        bias = (shifts(best.applied(first), best.applied(second)) - (off, -off)).mean(axis=0)
        np.testing.assert_allclose(bias, 0, atol=0.02)


def test_mirrored_maps_are_filtered_alike() -> None:
    first, second = maps(0.5)
    plain = made(first, second).applied(first)
    mirrored = made(np.ascontiguousarray(first[:, ::-1]), np.ascontiguousarray(second[:, ::-1]))
    np.testing.assert_allclose(mirrored.applied(np.ascontiguousarray(first[:, ::-1]))[:, ::-1], plain, atol=0.05)


def test_only_the_given_squares_count() -> None:
    first, second = maps(0.3)
    corners = square_corners(first.shape)
    spoilt = second.copy()
    spoilt[:, 150:] = 100 * np.random.default_rng(0).normal(size=(300, 150))
    half, whole = made(first, spoilt, corners[corners[:, 0] <= 150 - SIDE]), made(first, second)
    np.testing.assert_allclose(half.coherence[1:9], whole.coherence[1:9], atol=0.1)
    assert correlation_filter(first, second, corners[:0]) is None


def test_nothing_in_common_or_no_room_is_no_filter() -> None:
    first, _ = maps(0.1)
    corners = square_corners(first.shape)
    assert correlation_filter(first, np.zeros_like(first), corners) is None
    assert not len(square_corners((20, 300)))
    assert correlation_filter(first, -first, corners) is None


def test_spectra_are_those_of_the_fast_transform() -> None:
    rng = np.random.default_rng(3)
    views = rng.normal(size=(2, 80, 90)).astype(np.float32)
    views[1, :SIDE, 20 : 20 + SIDE] = 3.0  # a square without energy
    window = np.hanning(SIDE + 2)[1:-1]
    corners = np.array([[0, 0], [58, 48], [20, 0]])
    spectra = []
    for view in views.astype(np.float64):
        squares = np.stack([view[y : y + SIDE, x : x + SIDE] for x, y in corners])
        squares = (squares - squares.mean(axis=(1, 2), keepdims=True)) * (window[:, None] * window)
        energy = np.sqrt((squares**2).sum(axis=(1, 2), keepdims=True))
        spectra.append(np.fft.rfft2(np.divide(squares, energy, out=np.zeros_like(squares), where=energy > 1e-6)))
    one, two = spectra
    wanted = np.stack([(one * two.conj()).real, np.abs(one) ** 2, np.abs(two) ** 2]).sum(axis=1).swapaxes(1, 2)
    np.testing.assert_allclose(_spectra(views[0], views[1], corners), wanted, atol=2e-5)


@pytest.mark.parametrize("shape", [(150, 300), (64, 128), (3, 7), (1, 140)])
def test_the_compiled_filter_is_that_of_opencv(shape: tuple[int, int]) -> None:
    """Tiles, their rims and those of the map, where it is mirrored."""
    rng = np.random.default_rng(4)
    view, taps = rng.normal(size=shape).astype(np.float32), rng.normal(size=(2, TERMS, 2 * HALF + 1)).astype(np.float32)
    across, down = (one + one[:, ::-1] for one in taps)
    terms = [
        cv2.sepFilter2D(view, -1, x, y, borderType=cv2.BORDER_REFLECT_101) for x, y in zip(across, down, strict=True)
    ]
    wanted = np.sum(terms, axis=0)
    best = CorrelationFilter(across, down, np.zeros(1))
    found = best.applied(view)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())
    # On a high level, that and what the filter makes of it are taken away.
    high = best.applied(view + np.float32(50), centred=True)
    gain = best.applied(np.ones_like(view))
    np.testing.assert_allclose(high, wanted - view.mean() * gain, atol=1e-4 * np.abs(wanted).max())
