"""Simulated scenes: files as spaceborne products have them, and a truth that the images really obey."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

import featreg
from featreg.errors import InputError, ParameterError
from featreg.geolocation import DemHeights, RpcBias, RpcSensor, Transfer, find_overlap, sensor_of
from featreg.geometry import Affine
from featreg.io import read_image
from featreg.io.ellipsoid import earth_fixed
from featreg.simulate.orbit import RangeDoppler
from featreg.simulate.scene import ScenePair, read_scene_truth, simulate_scene
from featreg.types import FloatArray

SHAPE = (512, 600)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> ScenePair:
    return simulate_scene(tmp_path_factory.mktemp("scene"), SHAPE, relief=150.0, seed=3)


@pytest.fixture(scope="module")
def transfer(scene: ScenePair) -> Transfer:
    """The pair's geometry as its files have it."""
    images = [read_image(path) for path in (scene.reference, scene.secondary)]
    first, second = (sensor_of(image.geolocation, image.shape, image.name) for image in images)
    return Transfer(first, second, DemHeights(str(scene.dem)))


def grid() -> FloatArray:
    x, y = np.meshgrid(np.linspace(0.1, 0.9, 9) * SHAPE[1], np.linspace(0.1, 0.9, 9) * SHAPE[0])
    return np.column_stack([x.ravel(), y.ravel()])


def test_the_files_are_tiled_products_with_rpcs(scene: ScenePair) -> None:
    for path in (scene.reference, scene.secondary):
        with rasterio.open(path) as dataset:
            assert dataset.shape == SHAPE
            assert dataset.dtypes == ("uint16",)
            assert dataset.nodata == 0
            assert dataset.block_shapes == [(512, 512)]
            assert dataset.rpcs is not None
            assert dataset.read(1).min() > 0
    assert sorted(p.name for p in scene.reference.parent.iterdir()) == [
        "dem.tif", "reference.tif", "secondary.tif", "truth.json",
    ]  # fmt: skip


def test_the_rpcs_know_everything_but_the_bias(scene: ScenePair, transfer: Transfer) -> None:
    off = scene.truth(grid()) - transfer(grid())
    assert np.abs(off - scene.bias).max() < 0.02
    assert np.abs(scene.bias).min() >= 4


def test_the_displacement_is_not_affine(scene: ScenePair) -> None:
    there = scene.truth(grid())
    plane = Affine.from_estimate(grid(), there)
    assert plane
    assert plane.residuals(grid(), there).max() > 2


def test_the_images_obey_the_truth(scene: ScenePair, transfer: Transfer) -> None:
    """Tie points of the images, measured by refinement around an affine fit, agree with the truth without a bias."""
    found = featreg.match(scene.reference, scene.secondary, model="polynomial3", refine=True, seed=0)
    ties = found.matches.take(found.inliers)
    error = scene.truth(ties.reference_xy) - ties.secondary_xy
    assert len(error) > 200
    assert np.abs(np.median(error, axis=0)).max() < 0.08
    assert np.median(np.hypot(*error.T)) < 0.4
    kind = RpcBias.bind(transfer.reference, transfer.secondary, transfer.heights)
    result = featreg.fit(ties, model=kind, reference_shape=SHAPE, secondary_shape=SHAPE)
    assert result.status == "ok", result.reason
    assert result.model
    assert np.sqrt(((result.model(grid()) - scene.truth(grid())) ** 2).sum(axis=1).mean()) < 0.15


def test_the_images_overlap(scene: ScenePair, transfer: Transfer) -> None:
    overlap = find_overlap(transfer.reference, transfer.secondary, SHAPE, SHAPE, transfer.heights)
    assert overlap.reference.width * overlap.reference.height > 0.7 * SHAPE[0] * SHAPE[1]
    assert overlap.uncertainty_px > max(map(abs, scene.bias))


def test_the_truth_file_holds_the_truth(scene: ScenePair) -> None:
    assert np.allclose(read_scene_truth(scene.truth_file)(grid()), scene.truth(grid()), rtol=0, atol=1e-9)
    ties = np.array(json.loads(scene.truth_file.read_text())["tie_points"]["rows"])
    assert ties.shape == (400, 4)
    assert np.allclose(scene.truth(ties[:, :2]), ties[:, 2:], rtol=0, atol=1e-9)


def test_the_same_seed_gives_the_same_files(tmp_path: Path) -> None:
    made = [simulate_scene(tmp_path / name, (256, 256), seed=s) for name, s in (("a", 5), ("b", 5), ("c", 6))]
    pixels = [rasterio.open(pair.secondary).read(1) for pair in made]
    assert np.array_equal(pixels[0], pixels[1])
    assert not np.array_equal(pixels[0], pixels[2])
    assert made[0].truth_file.read_text() == made[1].truth_file.read_text()


@pytest.mark.parametrize(
    "given",
    [
        {"shape": (100, 300)},
        {"relief": -1.0},
        {"relief": float("nan")},
        {"change": 2.0},
        {"looks": 0},
        {"incidence_deg": (5.0, 30.0)},
        {"pixel": (0.0, 3.0)},
        {"bias": (float("nan"), 0.0)},
    ],
)
def test_impossible_arguments_are_refused(tmp_path: Path, given: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        simulate_scene(tmp_path / "scene", **given)
    assert not (tmp_path / "scene").exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        simulate_scene(tmp_path / "file" / "scene", (256, 256))
    with pytest.raises(InputError, match="not the truth"):
        read_scene_truth(_text(tmp_path / "other.json", "{}"))


def _text(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


class TestRangeDoppler:
    view = RangeDoppler.over((12.0, 47.0), SHAPE, incidence_deg=35.0, heading_deg=-12.0, pixel=3.0, height=300.0)

    def test_points_are_seen_at_their_closest_approach(self) -> None:
        """Zero Doppler by brute force: the satellite's distance over its flight has its minimum at the line found."""
        ground = self.view.image_to_ground(np.array([[40.0, 500.0]]), 300.0)
        place = earth_fixed(ground, np.array([300.0]))[0]
        lines = np.linspace(400, 600, 2001)
        angle = (lines - self.view.middle[1]) * self.view.spacing[1]
        path = 6_885_000.0 * (np.outer(np.cos(angle), self.view.toward) + np.outer(np.sin(angle), self.view.along))
        distance = np.linalg.norm(path - place, axis=1)
        assert lines[distance.argmin()] == pytest.approx(500.0, abs=0.1)
        column = (distance.min() - self.view.distance) / self.view.spacing[0] + self.view.middle[0]
        assert column == pytest.approx(40.0, abs=1e-3)

    def test_heights_lean_towards_the_radar(self) -> None:
        at = self.view.image_to_ground(np.array([[300.0, 250.0]]), 300.0)
        moved = self.view.ground_to_image(at, 400.0) - self.view.ground_to_image(at, 300.0)
        # 100 m of height over the tangent of the incidence angle, in pixels of 3 m on the ground.
        assert moved[0, 0] == pytest.approx(-100 / np.tan(np.radians(35)) / 3.0, rel=0.02)
        # The vertical of the ellipsoid does not quite point to the centre of the orbit.
        assert abs(moved[0, 1]) < 0.2

    def test_pixels_have_the_stated_size(self) -> None:
        assert self.view.pixel_size(300.0) == pytest.approx((3.0, 3.0), rel=0.01)

    def test_there_and_back(self) -> None:
        xy = np.random.default_rng(0).uniform(0, 500, (100, 2))
        assert np.abs(self.view.ground_to_image(self.view.image_to_ground(xy, 350.0), 350.0) - xy).max() < 1e-6
        assert isinstance(self.view.rpc(SHAPE, 0.0, 900.0, 10.0), RpcSensor)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_lines(tmp_path: Path) -> None:
    import tracemalloc

    peaks = []
    for rows in (384, 1152):
        tracemalloc.start()
        simulate_scene(tmp_path / str(rows), (rows, 256), looks=1, seed=0)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Landscape blocks are kept by the longer side, up to a limit.
    assert peaks[1] < 1.5 * peaks[0] + 30e6
