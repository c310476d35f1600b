"""Prewitt feature points: the gradient of known edges, the threshold, and both lengths."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.registry import create


def step_edge() -> np.ndarray:
    image = np.ones((40, 50), np.float32)
    image[:, 25:] = 3.0
    return image


def test_a_step_edge_has_points_on_both_its_sides() -> None:
    found = create("detector", "prewitt").detect_features(as_image(step_edge()))
    assert set(found.xy[:, 0]) == {24.0, 25.0}
    assert set(found.xy[:, 1]) == set(range(1, 39))  # the window leaves the image at the outermost rows
    np.testing.assert_allclose(found.score, 6.0)  # three rows of a step of 2 (Eq. 6 and 7)
    np.testing.assert_allclose(found.angle, 0.0)


@pytest.mark.parametrize(("turns", "angle"), [(1, 90.0), (2, 180.0), (3, 270.0)])
def test_angles_are_counter_clockwise_as_seen(turns: int, angle: float) -> None:
    found = create("detector", "prewitt").detect_features(as_image(np.rot90(step_edge(), turns).copy()))
    np.testing.assert_allclose(np.rad2deg(found.angle), angle)


def test_the_two_lengths_differ_on_a_corner() -> None:
    image = np.ones((30, 30), np.float32)
    image[15:, 15:] = 2.0
    at = {}
    for length in ("euclidean", "absolute"):
        found = create("detector", "prewitt", length=length).detect_features(as_image(image))
        at[length] = {tuple(p): s for p, s in zip(found.xy.tolist(), found.score.tolist(), strict=True)}
    assert at["euclidean"][14.0, 14.0] == pytest.approx(np.sqrt(2))
    assert at["absolute"][14.0, 14.0] == pytest.approx(2)


def test_thresholds_are_relative_to_the_mean_or_the_largest_gradient() -> None:
    image = step_edge()
    image[:, 10:] += 1.0  # half as high a step
    few = create("detector", "prewitt", relative_to="max", threshold=0.6).detect_features(as_image(image))
    both = create("detector", "prewitt", relative_to="max", threshold=0.4).detect_features(as_image(image))
    assert set(few.xy[:, 0]) == {24.0, 25.0}
    assert set(both.xy[:, 0]) == {9.0, 10.0, 24.0, 25.0}
    assert len(create("detector", "prewitt", threshold=100.0).detect_features(as_image(image))) == 0


@pytest.mark.parametrize(
    "wrong", [{"n_features": 0}, {"threshold": -1.0}, {"relative_to": "median"}, {"length": "city"}]
)
def test_impossible_parameters_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ParameterError, match=f"'prewitt\\.{next(iter(wrong))}' must be "):
        create("detector", "prewitt", **wrong)
