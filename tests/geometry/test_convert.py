"""Models as matrices, JSON and local linear parts."""

from __future__ import annotations

import json
import pickle
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geometry import (
    Affine,
    Homography,
    Polynomial2,
    Polynomial3,
    Rigid,
    as_model,
    local_linear,
    model_from_dict,
    model_from_matrix,
    model_to_dict,
)
from featreg.interfaces import Model
from made.models import scattered

BENT = Polynomial2([[0, 1, 0, 0.01, 0, 0], [0, 0, 1, 0, 0, 0]])  # type: ignore[arg-type]


def test_local_linear_part(model: Model) -> None:
    at = np.array([[300.0, 400.0], [900.0, 100.0]])
    linear = local_linear(model, at)
    step = np.array([0.01, -0.02])
    np.testing.assert_allclose(model(at + step) - model(at), linear @ step, atol=1e-6)
    np.testing.assert_allclose(local_linear(model, at[0]), linear[0])
    if isinstance(model, Polynomial2 | Polynomial3):
        np.testing.assert_allclose(model.jacobian(at), linear, atol=1e-7)
    if isinstance(model, Homography):
        np.testing.assert_allclose(model._linear(), local_linear(model, np.zeros(2)), atol=1e-7)


def test_pickle_parameters_and_json_rebuild_it_exactly(model: Model) -> None:
    xy = scattered(50)
    for whole in (model, model.inverse):
        for again in (
            pickle.loads(pickle.dumps(whole)),
            type(whole)(**whole.parameters),
            model_from_dict(json.loads(json.dumps(model_to_dict(whole), allow_nan=False))),
        ):
            assert type(again) is type(whole)
            np.testing.assert_array_equal(again(xy), whole(xy))


def test_dict_holds_the_contract_keys() -> None:
    written = model_to_dict(Rigid(4.0, 1.0, 2.0))
    assert written["type"] == "rigid"
    assert written["rotation_deg"] == 4.0
    assert written["scale"] == 1.0
    np.testing.assert_array_equal(written["matrix"], Rigid(4.0, 1.0, 2.0).matrix)
    assert model_to_dict(BENT)["matrix"] is None


@pytest.mark.parametrize(
    "broken",
    [
        {},
        {"type": "rigid"},
        {"type": "no-such-model", "parameters": {}},
        {"type": "rigid", "parameters": {"angle": 4}},
        {"type": "affine", "parameters": {"coefficients": [[1, 2], [3, 4]]}},
        {"type": "inverse", "parameters": {"forward": {"type": "translation", "parameters": {"dx": 1, "dy": 2}}}},
    ],
)
def test_dict_that_is_no_model_is_refused(broken: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        model_from_dict(broken)


def test_matrix_becomes_the_simplest_model() -> None:
    two = np.array([[1.0, 0.1, 5], [-0.1, 1.0, 6]])
    three = np.vstack([two, [0, 0, 1]])
    xy = scattered(10)
    for matrix in (two, three, 4 * three, two.tolist()):
        model = model_from_matrix(matrix)
        assert isinstance(model, Affine)
        np.testing.assert_allclose(model(xy), Affine(two)(xy))
    three[2, 0] = 1e-5
    assert isinstance(model_from_matrix(three), Homography)
    assert as_model(BENT) is BENT
    assert isinstance(as_model(two), Affine)


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(2),
        np.zeros((2, 3)),
        np.zeros((3, 3)),
        np.full((2, 3), np.nan),
        [[1, 2, 3], [2, 4, 6]],
        "a.json",
        None,
        {},
    ],
)
def test_matrix_that_is_no_model_is_refused(matrix: Any) -> None:
    with pytest.raises(InputError):
        as_model(matrix)
