"""Autofocus: known phase errors are recovered, and the phase is that of the image's Fourier transform."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.focusing.azimuth_filter import image_entropy
from featreg.focusing.phase_error import Band
from made.blurred_scenes import (
    SIDE,
    blurred,
    low_contrast,
    mixed_phase,
    phase_error,
    points_in_clutter,
    rows_and_columns,
    smooth_phase,
)

# The phase


@pytest.mark.parametrize("method", ["auto", "mea", "pmea", "mca"])
@pytest.mark.parametrize("seed", [1, 2])
def test_point_targets_are_focused(method: str, seed: int) -> None:
    clean, phase = rows_and_columns(seed), mixed_phase(seed)
    result = featreg.focus(blurred(clean, phase), method, fraction=None if method == "auto" else 0.1)
    assert result.status == "ok", result.reason
    assert phase_error(clean, phase, result.phase) < 0.06
    assert result.image_entropy[1] < result.image_entropy[0] - 0.5
    assert result.deviation < 0.1


def test_pga_focuses_isolated_points() -> None:
    rng = np.random.default_rng(0)
    clean = points_in_clutter([(rng.uniform(30, 226), 5 + 6 * i, 1.0) for i in range(40)], 1e-3, 0)
    phase = mixed_phase()
    result = featreg.focus(blurred(clean, phase), "pga")
    assert result.status == "ok", result.reason
    assert phase_error(clean, phase, result.phase) < 0.15


def test_a_polynomial_phase_is_found_where_contrast_is_low() -> None:
    clean = low_contrast()
    for method in ("legendre", "auto"):
        result = featreg.focus(blurred(clean, smooth_phase()), method)
        assert result.status == "ok", result.reason
        assert phase_error(clean, smooth_phase(), result.phase) < 0.12


def test_the_phase_belongs_to_the_fft_of_the_image() -> None:
    image = blurred(rows_and_columns(), mixed_phase())
    for axis, given in ((0, image), (1, np.ascontiguousarray(image.T))):
        result = featreg.focus(given, "mea", azimuth_axis=axis)
        turn = np.exp(-1j * result.phase)
        turn = turn[:, None] if axis == 0 else turn
        again = np.fft.ifft(np.fft.fft(given, axis=axis) * turn, axis=axis)
        np.testing.assert_allclose(result.image, again, atol=2e-6 * np.abs(again).max())
        assert result.image.dtype == np.complex64
        assert result.phase.shape == (SIDE,)
        assert len(result.entropy) == result.iterations + 1


def test_turning_the_axes_turns_the_result() -> None:
    image = blurred(rows_and_columns(), mixed_phase())
    a, b = featreg.focus(image, "pmea"), featreg.focus(np.ascontiguousarray(image.T), "pmea", azimuth_axis=1)
    np.testing.assert_array_equal(a.cells, b.cells)
    np.testing.assert_allclose(a.image, b.image.T, atol=1e-5 * np.abs(a.image).max())


def test_the_gain_of_the_image_does_not_matter() -> None:
    image = blurred(rows_and_columns(), mixed_phase())
    a, b = featreg.focus(image), featreg.focus(image * np.complex64(1e6j))
    assert Band.of(np.ones(SIDE)).difference(a.phase, b.phase) < 1e-2
    assert b.image_entropy[1] == pytest.approx(a.image_entropy[1], abs=1e-3)


def test_entropy_is_that_of_the_cells_and_with_all_cells_that_of_the_image() -> None:
    image = blurred(low_contrast(), smooth_phase())
    for normalize in (True, False):
        result = featreg.focus(image, "mea", fraction=1.0, normalize=normalize, max_iterations=12)
        np.testing.assert_allclose(result.entropy[[0, -1]], result.image_entropy, rtol=1e-5)
        assert result.image_entropy[1] == pytest.approx(image_entropy(result.image))


def test_detrending_leaves_the_image_where_it_was() -> None:
    clean = rows_and_columns()
    shift = np.exp(-2j * np.pi * np.fft.fftfreq(SIDE) * 20)
    image = blurred(
        np.asarray(np.fft.ifft(np.fft.fft(clean, axis=0) * shift[:, None], axis=0)), smooth_phase(strength=0.5)
    )

    def centre(values: NDArray[Any]) -> float:
        power = np.abs(values) ** 2
        return float(np.angle(np.sum(power * np.exp(2j * np.pi * np.arange(SIDE) / SIDE)[:, None])) * SIDE / 2 / np.pi)

    result = featreg.focus(image, detrend=True)
    assert centre(result.image) == pytest.approx(centre(image), abs=0.5)


# Pieces


@pytest.mark.realdata
def test_real_apertures_find_the_error_that_was_put_in(realdata: Any) -> None:
    """Self-consistency: what is found in the blurred image less what is found in the image as it is."""
    history = featreg.read_phase_history(realdata / "gotcha", polarisation="HH")
    image = featreg.back_project(history, featreg.GroundGrid((301, 301), 0.2)).pixels
    rng = np.random.default_rng(0)
    phase = smooth_phase(301) + 0.1 * rng.normal(size=301)
    made = blurred(image.astype(np.complex128), phase)
    own, found = (featreg.focus(i, "mea", fraction=0.2) for i in (image, made))
    power = np.mean(np.abs(np.fft.fft(image, axis=0)) ** 2, axis=1)
    assert found.status == "ok", found.reason
    assert Band.of(power).difference(found.phase - own.phase, phase) < 0.05
