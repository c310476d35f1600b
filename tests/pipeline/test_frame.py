"""What two geographies state is taken out before features are compared, and the gates judge what is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.geometry import Affine, Rigid, Similarity, decompose
from featreg.io import as_image
from featreg.pipeline.frame import Frame, frame_of, stated_frame
from featreg.results.registration import Registration
from featreg.results.summary import model_facts
from featreg.types import FloatArray, Geolocation, Image, Matches

UTM, SIDE = "EPSG:32633", 360
EAST, NORTH = 5e5, 5e6
#: Where the secondary really begins in the reference, and where its georeference says, px.
SHIFT, STATED = (7, 4), (9, 6)
Scene = NDArray[np.float64]


@pytest.fixture(scope="module")
def scene(sar_texture: Callable[..., NDArray[np.float32]]) -> Scene:
    """Amplitude without speckle of its own."""
    return np.asarray(sar_texture(SIDE + 20, SIDE + 20, 4, 1e4), np.float64)


def looked(amplitude: Any, seed: int) -> NDArray[np.float32]:
    """The same ground under speckle of four looks."""
    speckle = np.random.default_rng(seed).gamma(4.0, 0.25, amplitude.shape)
    return np.asarray(np.maximum(amplitude, 0.01) * np.sqrt(speckle), np.float32)


def placed(pixels: NDArray[np.float32], transform: tuple[float, ...] | None, **place: Any) -> Image:
    image = as_image(np.ascontiguousarray(pixels))
    return replace(image, geolocation=Geolocation(transform, place.pop("crs", UTM), **place))  # type: ignore[arg-type]


def reference_of(scene: Scene) -> Image:
    return placed(looked(scene[:SIDE, :SIDE], 1), (10.0, 0.0, EAST, 0.0, -10.0, NORTH))


def off(result: Registration, truth: Callable[[FloatArray], FloatArray]) -> float:
    assert result.model
    x, y = np.meshgrid(np.linspace(20, SIDE - 20, 5), np.linspace(20, SIDE - 20, 5))
    at = np.column_stack([x.ravel(), y.ravel()])
    return float(np.hypot(*(result.model(at) - truth(at)).T).max())


def cut(scene: Scene, kind: str) -> tuple[Image, Callable[[FloatArray], FloatArray]]:
    """The secondary of a kind, and the true map of reference points to it."""
    (dx, dy), (sx, sy) = SHIFT, STATED
    west, top = EAST + 10 * sx, NORTH - 10 * sy
    part, last = looked(scene, 2)[dy : dy + SIDE, dx : dx + SIDE], SIDE - 1
    end = 10.0 * SIDE
    if kind == "south-up":
        flipped = placed(part[::-1], (10.0, 0.0, west, 0.0, 10.0, top - end))
        return flipped, lambda p: p * (1, -1) + np.array([-dx, last + dy])
    if kind == "east-left":
        return placed(
            part[:, ::-1], (-10.0, 0.0, west + end, 0.0, -10.0, top)
        ), lambda p: p * (-1, 1) + np.array([last + dx, -dy])
    if kind == "turned":
        turned = placed(np.rot90(part), (0.0, -10.0, west + end, -10.0, 0.0, top))
        return turned, lambda p: p[:, ::-1] * (1, -1) + (-dy, last + dx)
    factor = int(kind)
    tall = cv2.resize(scene, (scene.shape[1], scene.shape[0] * factor), interpolation=cv2.INTER_CUBIC)
    fine = looked(tall, 3)[dy * factor : (dy + SIDE) * factor, dx : dx + SIDE]
    grid = (10.0, 0.0, west, 0.0, -10.0 / factor, top)
    return placed(fine, grid), lambda p: (p - (dx, dy) + 0.5) * (1, factor) - 0.5


@pytest.mark.parametrize("keywords", [{}, {"block": 200, "workers": 1, "executor": "serial"}], ids=["whole", "blocks"])
@pytest.mark.parametrize("kind", ["south-up", "east-left", "turned", "2", "6"])
def test_a_stated_mirror_turn_or_stretch_is_ok_and_right(scene: Scene, kind: str, keywords: dict[str, Any]) -> None:
    secondary, truth = cut(scene, kind)
    result = featreg.match(reference_of(scene), secondary, **keywords)
    assert (result.status, result.reason) == ("ok", "")
    assert off(result, truth) < (0.3 if not kind.isdigit() else 0.15 * int(kind))
    assert result.gates["determinant"].value == pytest.approx(1.0, abs=0.02)
    assert result.gates["anisotropy"].value == pytest.approx(1.0, abs=0.02)
    # Tie points are in the secondary's own pixels.
    kept = result.inliers
    gap = truth(result.matches.reference_xy[kept]) - result.matches.secondary_xy[kept]
    assert np.median(np.abs(gap)) < (0.2 if not kind.isdigit() else 0.1 * int(kind))


def test_degrees_far_north_against_a_map(scene: Scene) -> None:
    from featreg.geolocation import ConstantHeight, Transfer, sensor_of

    reference = placed(looked(scene[:SIDE, :SIDE], 1), (10.0, 0.0, EAST, 0.0, -10.0, 6.9e6))
    grid = Geolocation((9e-5, 0.0, 15.0, 0.0, -9e-5, 62.2305), "EPSG:4326")
    shape = (350, 760)
    sensors = sensor_of(grid, shape, "s"), sensor_of(reference.geolocation, (SIDE, SIDE), "r")
    there = Transfer(sensors[0], sensors[1], ConstantHeight())
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    at = there(np.column_stack([x.ravel(), y.ravel()]).astype(float)) + np.array([3.0, 2.0])
    column, row = (at[:, k].reshape(shape).astype(np.float32) for k in (0, 1))
    sampled = cv2.remap(scene.astype(np.float32), column, row, cv2.INTER_CUBIC)
    secondary = replace(as_image(looked(sampled, 5)), geolocation=grid)
    result = featreg.match(reference, secondary)
    assert result.status == "ok", result.reason
    assert off(result, lambda p: there.inverse(p - (3.0, 2.0))) < 0.5


def test_an_ascending_image_located_by_control_points(scene: Scene) -> None:
    x, y = np.meshgrid(np.linspace(0, SIDE - 1, 9), np.linspace(0, SIDE - 1, 9))
    # Its lines go north, and its samples west of north-east by 12 degrees.
    turn = np.radians(-12)
    u, v = x - SIDE / 2, SIDE / 2 - y
    mx = np.cos(turn) * u - np.sin(turn) * v + SIDE / 2
    my = np.sin(turn) * u + np.cos(turn) * v + SIDE / 2
    points = np.column_stack([x.ravel(), y.ravel(), EAST + 10 * (mx.ravel() + 0.5), NORTH - 10 * (my.ravel() + 0.5)])
    design = np.column_stack([points[:, :2], np.ones(len(points))])
    to_map = np.linalg.lstsq(design, np.column_stack([mx.ravel(), my.ravel()]))[0].T
    to_map[:, 2] += (3.0, 2.0)
    pixels = cv2.warpAffine(scene, to_map, (SIDE, SIDE), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    secondary = placed(looked(pixels, 6), None, gcps=np.column_stack([points, np.zeros(len(points))]))
    result = featreg.match(reference_of(scene), secondary)
    assert result.status == "ok", result.reason
    assert off(result, Affine(to_map).inverse) < 0.3


def test_nothing_changes_where_geography_states_nothing_of_the_kind(scene: Scene) -> None:
    part = looked(scene, 2)[SHIFT[1] : SHIFT[1] + SIDE, SHIFT[0] : SHIFT[0] + SIDE]
    secondary = placed(part, (10.0, 0.0, EAST + 90, 0.0, -10.0, NORTH - 60))
    reference = reference_of(scene)
    assert stated_frame(reference, secondary) is None
    located = featreg.match(reference, secondary)
    bare = featreg.match(replace(reference, geolocation=None), replace(secondary, geolocation=None))
    assert np.array_equal(located.matches.secondary_xy, bare.matches.secondary_xy)
    assert "frame" not in located.provenance


def test_a_geography_that_lies_does_not_cost_the_answer(scene: Scene) -> None:
    part = looked(scene, 2)[SHIFT[1] : SHIFT[1] + SIDE, SHIFT[0] : SHIFT[0] + SIDE]
    secondary = placed(part, (10.0, 0.0, EAST, 0.0, 10.0, NORTH - 10 * SIDE))
    result = featreg.match(reference_of(scene), secondary)
    assert result.status == "ok"
    assert off(result, lambda p: p - SHIFT) < 0.3


@pytest.mark.parametrize(("kind", "model"), [("south-up", "rigid"), ("2", "similarity")])
def test_a_narrow_model_is_fitted_in_the_frame_and_affine_in_pixels(scene: Scene, kind: str, model: str) -> None:
    secondary, truth = cut(scene, kind)
    result = featreg.match(reference_of(scene), secondary, model=model)
    assert (result.status, result.reason) == ("ok", "")
    assert isinstance(result.model, Affine)
    assert off(result, truth) < 0.3
    assert result.provenance["frame"]["model"] == model
    assert f"a {model} but for what both images state" in dict(model_facts(result))["model"]
    # Without the frame's share it is of the class that was asked for.
    left = np.linalg.inv(np.array(result.provenance["frame"]["linear"])) @ result.model.coefficients[:, :2]
    assert decompose(left).anisotropy == pytest.approx(1.0, abs=1e-6)


def test_a_slight_stretch_is_taken_out_for_a_model_that_does_not_hold_it(scene: Scene) -> None:
    """Two map projections differ so: too little to be seen by features, too much for a similarity."""
    tall = cv2.resize(scene, (scene.shape[1], round(scene.shape[0] * 1.05)), interpolation=cv2.INTER_CUBIC)
    ratio = tall.shape[0] / scene.shape[0]
    secondary = placed(looked(tall, 4), (10.0, 0.0, EAST, 0.0, -10.0 / ratio, NORTH))
    reference = reference_of(scene)
    assert stated_frame(reference, secondary, Affine) is None
    result = featreg.match(reference, secondary, model="similarity")
    assert (result.status, result.reason) == ("ok", "")
    assert off(result, lambda p: (p + 0.5) * (1, ratio) - 0.5) < 0.3
    assert isinstance(result.model, Affine)
    blocks = featreg.match(reference, secondary, model="similarity", block=200, workers=1, executor="serial")
    assert (blocks.status, blocks.provenance["prior"]["model"]) == ("ok", "similarity")
    assert off(blocks, lambda p: (p + 0.5) * (1, ratio) - 0.5) < 0.3
    assert "no similarity holds what both images state" in dict(model_facts(blocks))["model"]
    plain = featreg.match(reference, secondary, model="similarity", prior="none")
    assert plain.status == "unreliable"
    # A zoom is one, and needs no frame.
    wide = cv2.resize(scene, tall.shape[:1] * 2, interpolation=cv2.INTER_CUBIC)
    zoomed = placed(looked(wide, 4), (10.0 / ratio, 0.0, EAST, 0.0, -10.0 / ratio, NORTH))
    assert stated_frame(reference, zoomed, Similarity) is None
    assert stated_frame(reference, zoomed, Rigid) is not None


def test_points_go_to_a_frame_and_back() -> None:
    linear = np.array([[0.3, -1.9], [-0.8, -0.2]])
    frame = frame_of(linear, (50, 80))
    corners = np.array([[0, 0], [79, 0], [0, 49], [79, 49]], float)
    inside = frame.from_secondary(corners)
    assert (inside > -1.5).all()
    assert (inside < np.array(frame.shape[::-1]) + 0.5).all()
    assert np.abs(frame.to_secondary(inside) - corners).max() < 1e-9
    covariance = np.array([[[0.2, 0.05], [0.05, 0.1]]])
    back = frame.back(Matches(corners[:1], inside[:1], np.ones(1), covariance, rotation=np.zeros(1)))
    assert back.covariance is not None
    assert np.allclose(back.covariance[0], linear @ covariance[0] @ linear.T)
    assert back.rotation is None  # behind a mirror


@pytest.mark.parametrize("linear", [np.diag([-1.0, 1.0]), np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [-1.0, 0.0]])])
def test_a_frame_of_whole_pixels_keeps_the_samples(linear: FloatArray) -> None:
    pixels = np.random.default_rng(0).uniform(1, 9, (30, 40)).astype(np.float32)
    mask = np.ones(pixels.shape, bool)
    mask[4:9, 10:20] = False
    frame = frame_of(linear, pixels.shape)
    for image in (as_image(pixels), as_image(pixels, mask=mask)):
        seen = frame.resampled(image)
        x, y = np.meshgrid(np.arange(seen.shape[1]), np.arange(seen.shape[0]))
        at = np.rint(frame.to_secondary(np.column_stack([x.ravel(), y.ravel()]).astype(float))).astype(int)
        assert seen.mask.sum() == image.mask.sum()
        assert np.allclose(seen.pixels.ravel(), image.pixels[at[:, 1], at[:, 0]], atol=1e-4)


def test_a_shrinking_frame_averages() -> None:
    pixels = np.random.default_rng(0).gamma(4, 0.25, (400, 100)).astype(np.float32)
    seen = Frame(np.array([[1.0, 0.0, 0.0], [0.0, 4.0, 1.5]]), (100, 100)).resampled(as_image(pixels))
    assert seen.pixels[5:-5].mean() == pytest.approx(pixels.mean(), rel=0.02)
    assert seen.pixels[5:-5].std() < 0.65 * pixels.std()
