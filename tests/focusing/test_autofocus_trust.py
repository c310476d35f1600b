"""Autofocus: phases that are wrong, or that nothing can check, are not trusted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import featreg
from featreg.focusing import METHODS
from featreg.focusing.azimuth_filter import image_entropy
from made.blurred_scenes import (
    SIDE,
    blurred,
    low_contrast,
    mixed_phase,
    phase_error,
    points_in_clutter,
    rows_and_columns,
    smooth_phase,
    speckle,
)

# The phase


def test_other_methods_do_not_claim_what_they_cannot_do_at_low_contrast() -> None:
    clean, phase = low_contrast(1), mixed_phase(1)
    for method in ("mea", "pmea", "mca", "pga", "legendre"):
        result = featreg.focus(blurred(clean, phase), method)
        assert result.status == "unreliable" or phase_error(clean, phase, result.phase) < 0.3, method


# What is not trusted


@pytest.mark.parametrize("method", ["mea", "pmea"])
def test_without_normalisation_the_strong_row_collapses_and_is_not_trusted(method: str) -> None:
    clean, phase = rows_and_columns(3), mixed_phase(3)
    kw: dict[str, Any] = {"fraction": 0.1, "normalize": False}
    result = featreg.focus(blurred(clean, phase), method, **kw)
    assert phase_error(clean, phase, result.phase) > 0.7
    assert result.image_entropy[1] < image_entropy(clean)  # entropy alone would call it the better image
    assert result.status == "unreliable"
    assert "halves" in result.reason


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(256, 200), (64, 80)])
def test_homogeneous_speckle_is_not_trusted(method: str, shape: tuple[int, int]) -> None:
    for seed in range(2):
        result = featreg.focus(speckle(shape, seed).astype(np.complex64), method)
        assert result.status == "unreliable"
        assert result.reason


@pytest.mark.parametrize("method", METHODS)
def test_a_single_scatterer_cannot_be_checked(method: str) -> None:
    result = featreg.focus(blurred(points_in_clutter([(100, 100, 1.0)], 0.0, 0), smooth_phase()), method, fraction=0.01)
    assert result.status in ("ok", "unreliable")
    assert np.isfinite(result.image).all()


def test_few_cells_are_not_enough() -> None:
    result = featreg.focus(blurred(rows_and_columns(), mixed_phase()), "mea", fraction=0.005)
    assert result.status == "unreliable"
    assert "too few range cells" in result.reason


def test_neighbouring_cells_are_one_place_however_many() -> None:
    image = np.zeros((SIDE, 96), np.complex64)
    image[:, 40:46] = speckle((SIDE, 6))
    result = featreg.focus(image, "pga")
    assert result.reason.startswith("too few range cells with independent scatterers to check the phase: ")
    assert not result.gates["cells"].passed
    assert result.gates["cells"].value is None
    assert result.gates["entropy"].passed


# Range blocks, carrier, inputs


def test_a_constant_image_is_not_trusted() -> None:
    assert featreg.focus(np.full((40, 40), 1 + 1j, np.complex64)).status == "unreliable"
