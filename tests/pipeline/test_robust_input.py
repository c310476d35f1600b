"""Invalid samples, absurd ones and gaps leave a registration as good as it is without them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.geometry import Affine
from featreg.results.registration import Registration
from featreg.simulate import sar_pair

PAIR = sar_pair((360, 380), rotation_deg=4.0, shift=(6.0, -3.0), looks=2, seed=3)
TRUTH = Affine(PAIR.truth)


def error(result: Registration) -> float:
    """RMS distance of the model from the truth over the reference, px."""
    assert result.model, result.reason
    x, y = np.meshgrid(np.linspace(20, 359, 8), np.linspace(20, 339, 8))
    grid = np.column_stack([x.ravel(), y.ravel()])
    return float(np.sqrt(((result.model(grid) - TRUTH(grid)) ** 2).sum(axis=1).mean()))


def scattered(share: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    rng = np.random.default_rng(0)
    return rng.random(PAIR.reference.shape) < share, rng.random(PAIR.secondary.shape) < share


def stripes(first: int) -> NDArray[np.bool_]:
    return np.broadcast_to(((np.arange(360) + first) % 60 < 12)[:, None], (360, 380))


def none_inside(result: Registration, holes: Any) -> bool:
    points = result.matches.reference_xy, result.matches.secondary_xy
    at = [np.rint(xy).astype(int) for xy in points]
    return not any(hole[xy[:, 1], xy[:, 0]].any() for hole, xy in zip(holes, at, strict=True))


def spoilt(holes: Any, value: float, power: bool = False) -> list[NDArray[Any]]:
    images = [PAIR.reference.copy(), PAIR.secondary.copy()]
    images = [image**2 for image in images] if power else images
    for image, hole in zip(images, holes, strict=True):
        image[hole] = value * np.median(image)
    return images


@pytest.mark.parametrize("method", ["sar-orb", "orb"])
@pytest.mark.parametrize("share", [0.001, 0.05])
def test_scattered_nan_cost_nothing(method: str, share: float) -> None:
    holes = scattered(share)
    result = featreg.match(*spoilt(holes, np.nan), method=method)
    assert result.status == "ok"
    assert error(result) < 0.2
    assert none_inside(result, holes)


@pytest.mark.parametrize("method", ["sar-sift", "rift", "bfsift", "sift", "m-gof"])
def test_every_kind_of_method_bridges(method: str) -> None:
    holes = scattered(0.01)
    result = featreg.match(*spoilt(holes, np.nan), method=method, n_features=2000)
    assert result.status == "ok"
    assert error(result) < 0.3
    assert none_inside(result, holes)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.05])
def test_negative_intensities_are_as_good_as_clipped_ones(share: float) -> None:
    holes = scattered(share)
    result = featreg.match(*spoilt(holes, -0.01, power=True), scale="intensity")
    clipped = featreg.match(*spoilt(holes, 0.0, power=True), scale="intensity")
    assert result.status == "ok"
    assert error(result) <= error(clipped) + 0.01


def test_minus_infinite_decibels() -> None:
    with np.errstate(divide="ignore"):
        images = [20 * np.log10(image) for image in spoilt(scattered(0.02), 0.0)]
    result = featreg.match(*images, scale="db")
    assert result.status == "ok"
    assert error(result) < 0.2


@pytest.mark.parametrize("method", ["sar-orb", "sar-sift"])
def test_stripes_without_data(method: str) -> None:
    holes = stripes(0), stripes(25)
    result = featreg.match(*spoilt(holes, np.nan), method=method)
    assert result.status == "ok"
    assert error(result) < 0.3
    assert none_inside(result, holes)


def test_blocks_bridge_too() -> None:
    holes = scattered(0.02)
    result = featreg.match(*spoilt(holes, np.nan), block=200, workers=1, initial=TRUTH, search_radius=8)
    assert result.status == "ok"
    assert error(result) < 0.3
    assert none_inside(result, holes)


def test_no_tie_point_lies_in_a_wedge() -> None:
    x, y = np.meshgrid(np.arange(380), np.arange(360))
    holes = x + y < 250, (x - y > 200) | (np.random.default_rng(1).random(x.shape) < 0.01)
    result = featreg.match(*spoilt(holes, np.nan))
    assert result.status == "ok"
    assert error(result) < 0.3
    assert none_inside(result, holes)


def test_the_record_counts_the_pixels_that_are_data() -> None:
    holes = scattered(0.01)
    result = featreg.match(*spoilt(holes, np.nan))
    assert result.reference is not None
    assert result.reference.valid_pixels == np.count_nonzero(~holes[0])


def test_one_absurd_sample() -> None:
    reference = PAIR.reference.copy()
    reference[100, 120] = 1e8 * np.median(reference)
    result = featreg.match(reference, PAIR.secondary)
    assert result.status == "ok"
    assert error(result) < 0.2


@pytest.mark.parametrize("value", [9999.0, 1e20, 3.4e38])
def test_an_undeclared_fill_is_left_out_or_named(value: float) -> None:
    reference = PAIR.reference.copy()
    reference[np.add.outer(np.arange(360), np.arange(380)) < 200] = value
    result = featreg.match(reference, PAIR.secondary)
    if result.status == "ok":
        assert error(result) < 0.2
    else:
        assert f"hold {value:.6g}" in result.reason
        assert "nodata=" in result.reason


@pytest.mark.parametrize("method", ["sar-orb", "rift"])
def test_a_chip_is_found_in_its_scene(method: str) -> None:
    scene = sar_pair((655, 800), seed=5, rotation_deg=3.0).reference
    chip = np.ascontiguousarray(scene[250:417, 300:493])
    there = featreg.match(scene, chip, method=method)
    back = featreg.match(chip, scene, method=method)
    for result, at, wanted in ((there, (396, 333), (96, 83)), (back, (96, 83), (396, 333))):
        assert result.status == "ok", result.reason
        assert result.model
        np.testing.assert_allclose(result.model(np.array([at], np.float64))[0], wanted, atol=0.15)


@pytest.mark.parametrize("model", ["rigid", "affine", "homography", "polynomial2"])
@pytest.mark.parametrize("filters", [("fsc",), ("gms", "fsc")])
def test_a_fit_does_not_depend_on_the_origin(model: str, filters: tuple[str, ...]) -> None:
    rng = np.random.default_rng(0)
    here = rng.uniform(20, 500, (600, 2))
    there = here @ np.array([[1.001, 0.02], [-0.02, 1.0]]) + [5, -3] + rng.normal(0, 0.2, here.shape)
    there[:100] = rng.uniform(0, 500, (100, 2))
    at = np.array([[250.0, 250.0]])
    plain = featreg.fit(np.hstack([here, there]), model=model, filters=filters)
    assert plain.status == "ok"
    assert plain.model
    for a, b in (((500_123, 4_595_820), (500_100, 4_595_900)), ((-4000, -700), (-3990, -650)), ((900, 0), (0, 0))):
        moved = featreg.fit(np.hstack([here + a, there + b]), model=model, filters=filters)
        assert moved.status == "ok", moved.reason
        assert moved.model
        np.testing.assert_array_equal(moved.inliers, plain.inliers)
        assert moved.gates["spread"].value == plain.gates["spread"].value
        np.testing.assert_allclose(moved.model(at + a) - b, plain.model(at), atol=1e-2)
        np.testing.assert_array_equal(moved.matches.reference_xy, here + a)
