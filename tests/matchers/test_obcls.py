"""OBCLS: the methods on scenes of extended targets, and their parameters."""

from __future__ import annotations

import numpy as np
import pytest

import featreg
from featreg import registry
from featreg.errors import InputError, ParameterError
from featreg.geometry import Rigid
from featreg.io import as_image
from made.parking_lots import CENTRE, parking, rigid


def errors(result: featreg.Registration, truth: Rigid) -> tuple[float, float]:
    """Degrees of rotation and pixels at the image centre."""
    model = result.model
    assert isinstance(model, Rigid)
    turn = (model.rotation_deg - truth.rotation_deg + 180) % 360 - 180
    return abs(turn), float(np.hypot(*(model(CENTRE) - truth(CENTRE))[0]))


# Methods


@pytest.mark.parametrize(("rotation", "shift"), [(0.0, (0.0, 0.0)), (7.3, (12.0, -30.0)), (-141.2, (5.4, 3.7))])
@pytest.mark.parametrize("method", ["rc-obcls", "c-obcls"])
def test_any_rotation_and_shift_are_found(method: str, rotation: float, shift: tuple[float, float]) -> None:
    truth = rigid(rotation, shift)
    result = featreg.match(*parking(truth, seed=1), method=method)
    turn, apart = errors(result, truth)
    assert (result.status, result.reason) == ("ok", "")
    assert turn < 0.15
    assert apart < 0.5


def test_the_spectra_associate_as_well() -> None:
    truth = rigid(63.4, (-8.0, 14.0))
    result = featreg.match(*parking(truth, seed=2), method="rc-obcls", association="fourier-mellin")
    assert result.status == "ok"
    assert errors(result, truth)[0] < 0.15


def test_a_secondary_turned_counter_clockwise_has_a_positive_rotation() -> None:
    first, _ = parking(rigid(0.0), seed=3)
    result = featreg.match(first, np.rot90(first), method="rc-obcls")
    assert errors(result, rigid(90.0)) == pytest.approx((0, 0), abs=0.01)


@pytest.mark.parametrize("method", ["c-obcls-paper", "rc-obcls-paper", "cls"])
def test_nearly_aligned_images_are_registered_on_the_papers_path(method: str) -> None:
    truth = rigid(1.5, (1.0, 0.0))
    result = featreg.match(*parking(truth, seed=4), method=method)
    assert errors(result, truth)[0] < 0.3


def test_cancellation_matters_and_can_be_switched_off() -> None:
    truth = rigid(4.0)
    off = []
    for seed in range(5, 9):
        pair = parking(truth, seed=seed)
        kept = featreg.match(*pair, method="rc-obcls-paper")
        everything = featreg.match(*pair, method="rc-obcls-paper", cancellation=False)
        assert everything.stages["mad"].all()
        off.append((errors(kept, truth)[0], errors(everything, truth)[0]))
    with_it, without = np.mean(off, axis=0)
    assert with_it < 0.2
    assert without > 3 * with_it


def test_identical_images_are_identical() -> None:
    first, _ = parking(rigid(0.0), seed=10)
    for method in ("rc-obcls", "rc-obcls-paper", "c-obcls", "cls"):
        assert errors(featreg.match(first, first, method=method), rigid(0.0)) == pytest.approx((0, 0), abs=0.01)


def test_the_complex_correlation_is_the_finest_where_speckle_agrees() -> None:
    rng = np.random.default_rng(11)
    truth = Rigid(0.0, 3.0, -2.0)
    amplitude, _ = parking(rigid(0.0), seed=11)
    whole = amplitude * (rng.normal(size=amplitude.shape) + 1j * rng.normal(size=amplitude.shape))
    first, second = whole[20:300, 20:300], whole[22:302, 17:297]
    result = featreg.match(first, second, method="cc-obcls", refine=False)
    assert isinstance(result.model, Rigid)
    np.testing.assert_allclose(result.model(CENTRE), truth(CENTRE), atol=0.02)


def test_parameters_reach_the_one_part_they_belong_to() -> None:
    first, second = parking(rigid(2.0), seed=12)
    parameters = featreg.match(
        first, second, method="c-obcls", association="nearest", cancellation=False, threshold="mad", passes=2, patch=32,
        subpixel=False,
    ).provenance["parameters"]  # fmt: skip
    given = {k: parameters["matcher"][k] for k in ("association", "passes", "patch", "subpixel")}
    assert given == {"association": "nearest", "passes": 2, "patch": 32, "subpixel": False}
    assert (parameters["mad"]["cancellation"], parameters["mad"]["threshold"]) == (False, "mad")
    assert parameters["model"] == "rigid"


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("target-centroids", {"tie_points": "x"}),
        ("target-centroids", {"association": "x"}),
        ("target-centroids", {"passes": 0}),
        ("target-centroids", {"patch": 2}),
        ("target-centroids", {"cfar": "x"}),
        ("target-centroids", {"median": 2}),
        ("target-centroids", {"guard": 600}),
        ("patch-grid", {"tie_points": "c"}),
        ("patch-grid", {"step": -1}),
    ],
)
def test_impossible_parameters_are_refused(name: str, wrong: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        registry.create("matcher", name, **wrong)
    with pytest.raises(ParameterError):
        registry.create("filter", "mad", threshold="x")


# Cancellation


def test_the_covariance_of_tie_points_has_the_size_of_their_errors() -> None:
    truth = rigid(3.0)
    matches = registry.create("matcher", "target-centroids").match(*(as_image(i) for i in parking(truth, seed=14)))
    off = matches.secondary_xy - truth(matches.reference_xy)
    near = np.hypot(*off.T) < 3
    assert matches.covariance is not None
    squared = np.einsum("ni,nij,nj->n", off[near], np.linalg.inv(matches.covariance[near]), off[near])
    assert 0.4 < np.nanmedian(squared) / (2 * np.log(2)) < 2.5


def test_equal_input_gives_equal_bits() -> None:
    pair = parking(rigid(12.0), seed=15)
    runs = [featreg.match(*pair, method="rc-obcls") for _ in range(2)]
    np.testing.assert_array_equal(runs[0].matches.secondary_xy, runs[1].matches.secondary_xy)
    np.testing.assert_array_equal(runs[0].inliers, runs[1].inliers)


# Trust


def test_complex_correlation_needs_complex_images() -> None:
    first, second = parking(rigid(0.0), seed=20)
    for method in ("cc-obcls", "cc-obcls-paper", "cls-paper"):
        with pytest.raises(InputError, match="needs two complex images"):
            featreg.match(first.astype(np.complex64), second, method=method)
