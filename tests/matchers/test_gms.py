"""GMS keeps what OpenCV's keeps, has cells of one size on the ground, and refuses sizes it cannot hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.geometry import Affine
from featreg.interfaces import FilterContext
from featreg.types import Matches

cv2 = pytest.importorskip("cv2")
SHAPES = ((400, 520), (400, 520))


def keep(matches: Matches, shapes: Any = SHAPES, **parameters: Any) -> NDArray[np.bool_]:
    context = FilterContext(shapes[0], shapes[1], Affine)
    return registry.create("filter", "gms", **parameters).keep(matches, context)


def mixed(
    seed: int, *, turn: float = 0.0, zoom: float = 1.0, good: int = 1500, bad: int = 1000
) -> tuple[Matches, NDArray[np.bool_]]:
    """Coherent matches by a turn and a zoom about the centres, and random ones, all inside the images."""
    rng = np.random.default_rng(seed)
    sizes = [np.array(s[::-1], np.float64) for s in SHAPES]
    first = rng.uniform(0, 1, (good, 2)) * (sizes[0] - 1)
    c, s = zoom * np.cos(turn), zoom * np.sin(turn)
    second = (first - sizes[0] / 2) @ np.array([[c, s], [-s, c]]).T + sizes[1] / 2
    inside = ((second >= 0) & (second <= sizes[1] - 1)).all(axis=1)
    first, second = first[inside], second[inside]
    noise = [rng.uniform(0, 1, (bad, 2)) * (size - 1) for size in sizes]
    order = rng.permutation(len(first) + bad)
    a, b = np.concatenate([first, noise[0]])[order], np.concatenate([second, noise[1]])[order]
    # OpenCV has float32 points
    a, b = (p.astype(np.float32).astype(np.float64) for p in (a, b))
    return Matches(a, b, np.ones(len(a))), (np.arange(len(order)) < len(first))[order]


def opencv(matches: Matches, rotation: bool, scale: bool, factor: float) -> NDArray[np.bool_]:
    first, second = (
        [cv2.KeyPoint(float(x), float(y), 1.0) for x, y in xy] for xy in (matches.reference_xy, matches.secondary_xy)
    )
    pairs = [cv2.DMatch(i, i, 0.0) for i in range(len(first))]
    size = [tuple(int(v) for v in shape[::-1]) for shape in SHAPES]
    found = cv2.xfeatures2d.matchGMS(size[0], size[1], first, second, pairs, rotation, scale, factor)
    kept = np.zeros(len(first), np.bool_)
    kept[[m.queryIdx for m in found]] = True
    return kept


@pytest.mark.parametrize("rotation", [False, True])
@pytest.mark.parametrize("scale", [False, True])
@pytest.mark.parametrize(("turn", "zoom"), [(0.0, 1.0), (0.8, 1.0), (3.1, 1.0), (0.1, 0.5), (-1.5, 1.4)])
def test_keeps_the_matches_that_opencv_keeps(rotation: bool, scale: bool, turn: float, zoom: float) -> None:
    for seed, factor in ((0, 6.0), (1, 2.0)):
        matches, _ = mixed(seed, turn=turn, zoom=zoom)
        found = keep(matches, rotation=rotation, scale=scale, threshold_factor=factor)
        np.testing.assert_array_equal(found, opencv(matches, rotation, scale, factor))


def test_keeps_the_good_and_drops_the_bad() -> None:
    matches, good = mixed(3)
    kept = keep(matches)
    assert kept[good].mean() > 0.6
    assert kept[~good].mean() < 0.02


def test_a_quarter_turn_needs_the_rotation_option() -> None:
    matches, good = mixed(4, turn=np.pi / 2)
    assert keep(matches, rotation=True)[good].mean() > 0.7
    assert keep(matches, rotation=False)[good].mean() < 0.2


def test_random_matches_are_dropped() -> None:
    matches, _ = mixed(5, good=0, bad=3000)
    assert keep(matches).mean() < 0.01


def test_points_outside_their_image_are_dropped_and_leave_the_others_alone() -> None:
    matches, _ = mixed(6)
    (h0, w0), (h1, w1) = SHAPES
    outside = np.array([[-0.6, 50], [w0 - 0.5, 50], [50, -3], [50, h0], [1e9, 1e9], [-1e9, 5]], np.float64)
    beyond = np.array([[w1 - 0.4, 9], [9, h1 + 1], [-2, 9]], np.float64)
    first = np.concatenate([matches.reference_xy, outside, np.full((3, 2), 50.0)])
    second = np.concatenate([matches.secondary_xy, np.full((6, 2), 50.0), beyond])
    kept = keep(Matches(first, second, np.ones(len(first))))
    assert not kept[-9:].any()
    np.testing.assert_array_equal(kept[:-9], keep(matches))


def test_points_on_the_outermost_half_pixel_are_inside() -> None:
    rng = np.random.default_rng(0)
    xy = np.column_stack([rng.uniform(-0.5, 0, 400), rng.uniform(-0.5, 20, 400)])
    assert keep(Matches(xy, xy, np.ones(400)), ((400, 400), (400, 400))).all()


def test_the_order_of_the_matches_does_not_matter() -> None:
    matches, _ = mixed(7)
    order = np.random.default_rng(0).permutation(len(matches))
    np.testing.assert_array_equal(keep(matches.take(order)), keep(matches)[order])


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_matches_give_a_mask_of_their_length(count: int) -> None:
    xy = np.full((count, 2), 50.0)
    assert keep(Matches(xy, xy, np.ones(count))).shape == (count,)


@pytest.mark.parametrize(
    "parameters", [{"grid": 2}, {"grid": 100000}, {"threshold_factor": 0.0}, {"threshold_factor": float("nan")}]
)
def test_impossible_parameters_are_refused(parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create("filter", "gms", **parameters)


def chip(ratio: float, swap: bool = False) -> tuple[Matches, Any, dict[str, Any]]:
    """240 right of 1600 matches of a scene and a chip of 6 % of it, whose pixels are `ratio` times as large."""
    rng = np.random.default_rng(0)
    scene, size = np.array([800.0, 655.0]), np.array([193.0, 167.0])
    right = rng.uniform(0, 1, (240, 2)) * (size - 1)
    first = np.concatenate([right + np.array([300, 250]), rng.uniform(0, 1, (1360, 2)) * (scene - 1)])
    second = np.concatenate([right, rng.uniform(0, 1, (1360, 2)) * (size - 1)]) / ratio
    shapes = (655, 800), (round(167 / ratio), round(193 / ratio))
    pixels = (ratio, ratio)
    if swap:
        first, second, shapes, pixels = second, first, shapes[::-1], (1 / ratio, 1 / ratio)
    return Matches(first, second, np.ones(len(first))), shapes, {"pixel_ratio": pixels}


@pytest.mark.parametrize("ratio", [1.0, 0.25])
@pytest.mark.parametrize("swap", [False, True])
def test_a_chip_has_cells_of_the_size_that_the_scene_has(ratio: float, swap: bool) -> None:
    matches, shapes, known = chip(ratio, swap)
    context = FilterContext(shapes[0], shapes[1], Affine, **known)
    kept = registry.create("filter", "gms").keep(matches, context)
    assert kept[:240].mean() > 0.6
    assert kept[240:].mean() < 0.05


def test_the_roles_of_two_sizes_do_not_matter() -> None:
    kept = [
        registry.create("filter", "gms").keep(matches, FilterContext(shapes[0], shapes[1], Affine, **known))
        for matches, shapes, known in (chip(1.0), chip(1.0, swap=True))
    ]
    np.testing.assert_array_equal(kept[0], kept[1])


def test_a_tiny_chip_has_four_cells_along_a_side() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 63, (300, 2))
    assert keep(Matches(xy + 500, xy, np.ones(300)), ((1500, 1500), (64, 64))).mean() > 0.9
