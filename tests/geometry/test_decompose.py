"""What a linear part does, by name."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

from featreg.errors import NoModelError
from featreg.geometry import Affine, Polynomial2, decompose, local_linear


def test_each_part_is_found_alone() -> None:
    turn = math.radians(20)
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    found = decompose(1.5 * rotation)
    assert found == pytest.approx((20.0, 1.5, 1.0, 0.0))
    assert (found.rotation_deg, found.scale, found.anisotropy, found.shear_deg) == found
    stretched = decompose(np.diag([2.0, 0.5]) @ rotation)
    assert (stretched.scale, stretched.anisotropy) == pytest.approx((1.0, 4.0))
    assert decompose(np.array([[1.0, math.tan(turn)], [0.0, 1.0]])).shear_deg == pytest.approx(20.0)


def test_a_reflection_has_no_rotation_and_a_flat_part_no_end_of_anisotropy() -> None:
    mirrored = decompose(np.diag([-1.0, 1.0]))
    assert math.isnan(mirrored.rotation_deg)
    assert (mirrored.scale, mirrored.anisotropy) == (1.0, 1.0)
    flat = decompose(np.array([[1.0, 2.0], [2.0, 4.0]]))
    assert flat.scale == 0.0
    assert flat.anisotropy > 1e12


def test_a_model_that_turns_differently_from_place_to_place_says_how_to_ask() -> None:
    bent = Polynomial2(np.array([[0.0, 1, 0, 1e-3, 0, 0], [0.0, 0, 1, 0, 0, 0]]), (0.0, 0.0), 1.0)
    for model in (pickle.loads(pickle.dumps(bent)), bent.inverse):
        assert not hasattr(model, "rotation_deg")
        with pytest.raises(NoModelError, match=r"decompose\(.*\)\.rotation_deg is that of one"):
            _ = model.rotation_deg
    assert decompose(local_linear(bent, (50.0, 0.0))).scale == pytest.approx(math.sqrt(1.1))
    with pytest.raises(AttributeError, match="'Affine' object has no attribute 'rotation'"):
        _ = Affine(np.eye(2, 3)).rotation  # type: ignore[attr-defined]
    assert Affine(np.eye(2, 3)).shift_at([3, 4]).tolist() == [0.0, 0.0]
