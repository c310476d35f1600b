"""Keywords of match: those of the parts, and those that are no such."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from featreg import registry
from featreg.errors import InputError, ParameterError, UnknownNameError
from featreg.simulate import SimulatedPair
from made.matched import matched

# Keywords


def test_a_misspelt_keyword_suggests_the_right_one(pair: SimulatedPair) -> None:
    for wrong, right in (
        ("treshold", "threshold"),
        ("n_feature", "n_features"),
        ("detektor", "detector"),
        ("quota_decy", "quota_decay"),
    ):
        with pytest.raises(ParameterError, match=f"'{right}'"):
            matched(pair, **{wrong: 3})


def test_a_keyword_of_two_parts_names_both(pair: SimulatedPair) -> None:
    with pytest.raises(ParameterError) as caught:
        matched(pair, threshold=3)
    assert "detector.threshold" in str(caught.value)
    assert "fsc.threshold" in str(caught.value)


def test_a_keyword_with_its_part_reaches_only_that_part(pair: SimulatedPair) -> None:
    parameters = matched(pair, **{"fsc.threshold": 1.5, "detector.threshold": 20}).provenance["parameters"]
    assert parameters["fsc"]["threshold"] == 1.5
    assert parameters["detector"]["threshold"] == 20
    with pytest.raises(ParameterError, match=r"nobody\.threshold"):
        matched(pair, **{"nobody.threshold": 1})
    with pytest.raises(ParameterError, match=r"gms\.threshold"):
        matched(pair, **{"gms.threshold": 1})


def test_a_keyword_of_one_part_needs_no_prefix(pair: SimulatedPair) -> None:
    parameters = matched(pair, alpha=3.0, grid=15, half=20, least_inliers=20).provenance["parameters"]
    assert parameters["detector"]["alpha"] == 3.0
    assert parameters["gms"]["grid"] == 15
    assert parameters["refinement"]["half"] == 20
    assert parameters["trust"]["least_inliers"] == 20


def test_the_features_of_the_detector_alone_can_be_limited(pair: SimulatedPair) -> None:
    """What a user writes is obeyed or refused, never dropped."""
    found = matched(pair, refine=False, **{"detector.n_features": 150})
    assert found.provenance["parameters"]["detector"]["n_features"] == 150
    assert np.count_nonzero(found.matches.origin < 0) <= 150


def test_parts_are_replaced_by_name_or_object(pair: SimulatedPair) -> None:
    by_name = matched(pair, detector="fast", descriptor="brief", filters=["gms", "ransac"])
    assert list(by_name.stages)[:2] == ["gms", "ransac"]
    assert by_name.provenance["parameters"]["detector"]["name"] == "fast"
    by_object = matched(
        pair, detector=registry.create("detector", "fast"), filters=["gms", registry.create("filter", "ransac")]
    )
    np.testing.assert_array_equal(by_object.matches.reference_xy, by_name.matches.reference_xy)
    assert by_object.status == by_name.status == "ok"


@pytest.mark.parametrize(
    ("keywords", "error"),
    [
        ({"method": "sar-orbs"}, UnknownNameError),
        ({"model": "afine"}, UnknownNameError),
        ({"detector": "fats"}, UnknownNameError),
        ({"filters": ["gsm"]}, UnknownNameError),
        ({"filters": ["gms", "gms"]}, ParameterError),
        ({"detector": 3}, ParameterError),
        ({"descriptor": registry.create("nearest", "brute-force")}, ParameterError),
        ({"filters": [3]}, ParameterError),
        ({"seed": -1}, ParameterError),
        ({"seed": 1.5}, ParameterError),
        ({"n_features": 0}, ParameterError),
        ({"n_features": 10.5}, ParameterError),
        ({"scale": "decibel"}, ParameterError),
        ({"alpha": "wide"}, ParameterError),
        ({"half": "wide"}, ParameterError),
        ({"least_spread": "wide"}, ParameterError),
        ({"search_radius": 5.0}, ParameterError),
        ({"initial": np.eye(3)}, ParameterError),
        ({"initial": np.eye(3), "search_radius": -2.0}, ParameterError),
        ({"initial": np.eye(4), "search_radius": 2.0}, InputError),
        ({"initial": {"a": 1}, "search_radius": 2.0}, ParameterError),
        ({"reference_mask": np.ones((5, 5))}, InputError),
    ],
    ids=str,
)
def test_misuse_raises_from_our_tree(pair: SimulatedPair, keywords: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error) as caught:
        matched(pair, **keywords)
    assert "\n" not in str(caught.value)


def test_numpy_numbers_are_numbers(pair: SimulatedPair) -> None:
    found = matched(pair, n_features=np.int64(300), seed=np.int64(1))
    assert found.inliers.sum() <= 300
