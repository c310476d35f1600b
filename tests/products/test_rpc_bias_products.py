"""Products and exports of a result whose model is an RPC bias: they rest on its elevation model too."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from featreg.cli.main import main
from featreg.geolocation import DemHeights, RpcBias, RpcSensor, Sensor, sensor_of
from featreg.geolocation.transfer import on_ground
from featreg.geometry import Translation
from featreg.io import as_image, read_image
from featreg.products.lattice import lattice_of
from featreg.products.resample import resample
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.simulate.scene import ScenePair, simulate_scene
from featreg.types import Matches

SHAPE = (256, 320)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> ScenePair:
    return simulate_scene(tmp_path_factory.mktemp("scene"), SHAPE, relief=16.0, seed=4)


@pytest.fixture(scope="module")
def model(scene: ScenePair) -> RpcBias:
    sensors: list[Sensor] = []
    for path in (scene.reference, scene.secondary):
        image = read_image(path)
        sensors.append(sensor_of(image.geolocation, image.shape, image.name))
    bias = Translation(*scene.bias).matrix[:2]
    return RpcBias(sensors[0], sensors[1], DemHeights(str(scene.dem)), "shift", bias)


@pytest.fixture
def result(scene: ScenePair, model: RpcBias, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    here = np.random.default_rng(0).uniform([40, 40], [280, 216], (30, 2))
    paths = {"reference": scene.reference, "secondary": scene.secondary}
    images: dict[str, Any] = {role: InputImage(str(p), (256, 320), "amplitude") for role, p in paths.items()}
    matches = Matches(here, scene.truth(here), np.ones(30))
    made = Registration(matches, {}, np.ones(30, bool), model, "ok", provenance={"method": "m"}, **images)
    made.to_json(tmp_path / "r.json")
    return tmp_path / "r.json"


@pytest.fixture
def without_dem(scene: ScenePair) -> Iterator[None]:
    away = scene.dem.with_suffix(".away")
    shutil.move(scene.dem, away)
    yield
    shutil.move(away, scene.dem)


def test_the_secondary_lies_on_the_reference_by_the_exact_geometry(scene: ScenePair, result: Path) -> None:
    assert main(["warp", str(result), str(scene.secondary), "-o", "o.tif", "--workers", "1"]) == 0
    with rasterio.open("o.tif") as made, rasterio.open(scene.reference) as reference:
        assert made.rpcs is not None
        assert made.rpcs.samp_off == reference.rpcs.samp_off
        values = made.read(1).astype(float)
    exact = resample(as_image(scene.secondary), scene.truth, SHAPE)
    both = exact.mask & (values > 0)
    assert both.mean() > 0.8
    assert np.sqrt(((values - exact.pixels)[both] ** 2).mean()) < 0.02 * exact.pixels[both].std()


def test_positions_over_the_ground_are_interpolated_to_a_hundredth(model: RpcBias) -> None:
    nodes = lattice_of(model, 30, 20, (200, 240))
    assert nodes.step == 4
    x, y = nodes.positions()
    rows, columns = np.mgrid[20:220, 30:270].astype(float)
    exact = model(np.column_stack([columns.ravel(), rows.ravel()]))
    assert np.abs(np.column_stack([x.ravel(), y.ravel()]) - exact).max() < 0.015


def test_relief_between_nodes_is_not_overlooked(model: RpcBias, tmp_path: Path) -> None:
    """A mast on a plain, of which nodes 8 px apart and the middles between them see nothing."""
    place = model.reference.image_to_ground(np.array([[104.0, 100.0]]), 100.0)[0]
    heights = np.full((400, 400), 100.0, np.float32)
    heights[200, 200] = 180.0
    step = 3.0 / 111_320.0
    transform = rasterio.transform.from_origin(place[0] - 200.5 * step, place[1] + 200.5 * step, step, step)
    profile = {"width": 400, "height": 400, "count": 1, "dtype": "float32", "crs": "EPSG:4326", "driver": "GTiff"}
    with rasterio.open(tmp_path / "mast.tif", "w", transform=transform, **profile) as dataset:
        dataset.write(heights, 1)
    on = RpcBias(model.reference, model.secondary, DemHeights(str(tmp_path / "mast.tif")), "shift", model.bias)
    x, _ = lattice_of(on, 50, 50, (128, 128)).positions()
    rows, columns = np.mgrid[50:178, 50:178].astype(float)
    exact = on(np.column_stack([columns.ravel(), rows.ravel()]))[:, 0].reshape(128, 128)
    plane = np.median(np.diff(exact, axis=1))
    assert np.abs(np.diff(exact, axis=1) - plane).max() > 0.1
    assert np.abs(x - exact).max() < 0.02


@pytest.mark.parametrize("name", ["t.vrt", "t.txt"])
def test_control_points_lie_on_the_ground_of_the_model(
    scene: ScenePair, model: RpcBias, result: Path, name: str
) -> None:
    """The corrected RPC of the secondary takes each to its pixel; at one height for all they would be pixels off."""
    assert main(["export", str(result), "--to", "gdal", "-o", name]) == 0
    if name == "t.vrt":
        with rasterio.open(name) as dataset:
            rows = np.array([(p.col, p.row, p.x, p.y, p.z) for p in dataset.gcps[0]])
    else:
        rows = np.array([[float(v) for v in line.split()[1:]] for line in Path(name).read_text().splitlines()])
    assert np.ptp(rows[:, 4]) > 5
    sensor = RpcSensor(model.corrected_rpc())
    assert np.abs(sensor.ground_to_image(rows[:, 2:4], rows[:, 4]) + 0.5 - rows[:, :2]).max() < 0.05


@pytest.mark.parametrize(("to", "name"), [("csv", "t.csv"), ("envi", "t.pts"), ("colmap", "t.db")])
def test_tie_points_need_no_elevation_model(
    without_dem: None, result: Path, capsys: pytest.CaptureFixture[str], to: str, name: str
) -> None:
    assert main(["export", str(result), "--to", to, "-o", name]) == 0
    assert "residuals are left out" in capsys.readouterr().err
    assert Path(name).is_file()


def test_what_needs_the_elevation_model_names_it(
    without_dem: None, scene: ScenePair, result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in (["warp", str(result), str(scene.secondary)], ["export", str(result), "--to", "gdal"]):
        assert main([*command, "-o", "o.tif"]) == 2
        assert str(scene.dem) in capsys.readouterr().err.splitlines()[-1]
    assert sorted(p.name for p in result.parent.iterdir()) == ["r.json"]


def test_the_elevation_model_is_never_replaced(
    scene: ScenePair, result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = scene.dem.read_bytes()
    for command in (["warp", str(result), str(scene.secondary)], ["export", str(result), "--to", "gdal"]):
        assert main([*command, "-o", str(scene.dem)]) == 2
        assert "would replace an input" in capsys.readouterr().err
    assert scene.dem.read_bytes() == before


@pytest.mark.parametrize("name", ["sec_RPC.TXT", "sec.RPB"])
def test_the_corrected_rpc_is_exported_and_read_by_gdal(
    scene: ScenePair,
    model: RpcBias,
    result: Path,
    tmp_path: Path,
    name: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    copy = tmp_path / "sec.tif"
    with rasterio.open(copy, "w", driver="GTiff", width=320, height=256, count=1, dtype="uint8") as file:
        file.write(np.random.default_rng(0).integers(1, 255, (1, 256, 320)).astype(np.uint8))
    assert main(["export", str(result), "--to", "rpc", "-o", str(tmp_path / name)]) == 0
    assert capsys.readouterr().out == f"written: {tmp_path / name}, the secondary's corrected RPC\n"
    with rasterio.open(copy) as file:
        assert file.rpcs is not None
    image = read_image(copy)
    corrected = sensor_of(image.geolocation, image.shape, image.name)
    here = np.random.default_rng(1).uniform([40, 40], [280, 216], (20, 2))
    lonlat, height = on_ground(model.transfer.reference, here, model.transfer.heights)
    np.testing.assert_allclose(corrected.ground_to_image(lonlat, height), model(here), atol=0.02)


def test_a_corrected_rpc_needs_an_rpc_bias(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here = np.random.default_rng(0).uniform(0, 90, (10, 2))
    image = InputImage("array", (100, 100))
    reg = Registration(
        Matches(here, here, np.ones(10)), {}, np.ones(10, bool), Translation(1.0, 2.0), "ok",
        provenance={"method": "m"}, reference=image, secondary=image,
    )  # fmt: skip
    reg.to_json(tmp_path / "r.json")
    assert main(["export", str(tmp_path / "r.json"), "--to", "rpc", "-o", str(tmp_path / "x_RPC.TXT")]) == 2
    assert "rpc-bias" in capsys.readouterr().err
    assert not (tmp_path / "x_RPC.TXT").exists()
