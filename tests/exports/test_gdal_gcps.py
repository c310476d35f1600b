"""Control points in a raster are all that GDAL sees of where it lies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.cli.main import main
from featreg.errors import InputError
from featreg.exports.formats import export
from featreg.geometry import Affine
from featreg.io import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.simulate.orbit import RangeDoppler
from featreg.types import Geolocation, Matches

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

UTM, SHAPE = "EPSG:32632", (100, 120)
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), UTM)
#: Where the secondary's own file says that it lies: 2 km off.
WRONG = (10.0, 0.0, 502_000.0, 0.0, -10.0, 6e6)
MOVE = Affine(np.array([[1.0, 0.0, 6.0], [0.0, 1.0, -4.0]]))


def made(folder: Path, place: Geolocation, points: int = 60) -> tuple[Registration, Any]:
    rng = np.random.default_rng(0)
    secondary = np.zeros(SHAPE, np.float32)
    secondary[36:39, 56:59] = 100.0  # the reference's (51, 41), in the middle of the patch
    write_geotiff(folder / "ref.tif", rng.random(SHAPE).astype(np.float32), PLACE)
    write_geotiff(folder / "sec.tif", secondary + rng.random(SHAPE).astype(np.float32), place)
    xy = rng.uniform(5, 95, (points, 2))
    images: Any = {role: InputImage(str(folder / f"{role[:3]}.tif"), SHAPE) for role in ("reference", "secondary")}
    found = Matches(xy, MOVE(xy), np.ones(points))
    return Registration(found, {}, np.ones(points, bool), MOVE, "ok", **images), secondary


@pytest.fixture(scope="module")
def rpc() -> dict[str, Any]:
    orbit = RangeDoppler.over((12.0, 47.0), SHAPE, incidence_deg=35.0, heading_deg=-12.0, pixel=3.0)
    return dict(orbit.rpc(SHAPE, 0.0, 1000.0, 15.0).rpcs)


@pytest.mark.parametrize("suffix", [".tif", ".vrt"])
@pytest.mark.parametrize("located", ["transform", "rpc", "both"])
def test_gdal_warps_by_the_control_points(suffix: str, located: str, rpc: dict[str, Any], tmp_path: Path) -> None:
    from rasterio.warp import reproject

    own = Geolocation(WRONG if located != "rpc" else None, UTM if located != "rpc" else None,
                      None if located == "transform" else rpc)  # fmt: skip
    result, _ = made(tmp_path, own)
    target = tmp_path / f"out{suffix}"
    assert export(result, target, to="gdal") == 60
    with rasterio.open(target) as dataset:
        assert len(dataset.gcps[0]) == 60
        assert dataset.gcps[1].to_epsg() == 32632
        assert dataset.transform.is_identity
        assert dataset.rpcs is None
        grid = rasterio.Affine(*PLACE.transform)  # type: ignore[misc]
        on_map = np.zeros(SHAPE, np.float32)
        reproject(rasterio.band(dataset, 1), on_map, dst_transform=grid, dst_crs=UTM)
    brightest = int(np.argmax(_mean3(on_map)))
    assert divmod(brightest, SHAPE[1]) == (41, 51)


def _mean3(values: Any) -> Any:
    from scipy.ndimage import uniform_filter

    return uniform_filter(values, 3)


def test_more_points_than_a_geotiff_holds_are_no_silent_loss(tmp_path: Path) -> None:
    result, _ = made(tmp_path, PLACE, points=11_000)
    with pytest.raises(InputError, match=r"GDAL reads 0 of 11000 control points back.*\.vrt"):
        export(result, tmp_path / "out.tif", to="gdal")
    assert export(result, tmp_path / "out.vrt", to="gdal") == 11_000


def test_a_name_that_a_vrt_cannot_hold_is_refused(tmp_path: Path) -> None:
    result, _ = made(tmp_path, PLACE)
    (tmp_path / "sec.tif").rename(tmp_path / "s\x01c.tif")
    with pytest.raises(InputError, match="control characters"):
        export(result, tmp_path / "out.vrt", to="gdal", secondary=tmp_path / "s\x01c.tif")


def test_points_without_a_coordinate_system_are_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    result, _ = made(tmp_path, PLACE)
    points = np.array([(x, y, 5e5 + 10 * x, 6e6 - 10 * y, 0.0) for x in (0, 60, 119) for y in (0, 50, 99)], float)
    write_geotiff(tmp_path / "ref.tif", np.ones(SHAPE, np.float32), Geolocation(None, None, None, points))
    export(result, tmp_path / "out.txt", to="gdal")
    assert "its ground control points have no coordinate system" in caplog.text
    first = (tmp_path / "out.txt").read_text().split("\n")[0].split()
    assert float(first[3]) == pytest.approx(result.matches.reference_xy[0, 0] + 0.5)


def test_a_result_is_used_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    result, _ = made(tmp_path, PLACE)
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path)
    images: Any = {role: InputImage(f"{role[:3]}.tif", SHAPE) for role in ("reference", "secondary")}
    replace(result, **images).to_json("out/r.json")
    for folder in (tmp_path, tmp_path / "out", tmp_path.parent):
        monkeypatch.chdir(folder)
        again = Registration.from_json(tmp_path / "out/r.json")
        assert again.reference is not None
        assert Path(again.reference.path).samefile(tmp_path / "ref.tif")
        export(tmp_path / "out/r.json", tmp_path / "a.txt", to="gdal")
        x, y = map(float, (tmp_path / "a.txt").read_text().split("\n")[0].split()[3:5])
        assert (x, y) == pytest.approx(tuple(result.matches.reference_xy[0] * (10, -10) + (500_005, 5_999_995)))
    # Moved away from its images, it says what is missing.
    (tmp_path / "gone").mkdir()
    (tmp_path / "out/r.json").rename(tmp_path / "gone/r.json")
    (tmp_path / "ref.tif").unlink()
    monkeypatch.chdir(tmp_path / "gone")
    capsys.readouterr()
    assert main(["export", "r.json", "--to", "gdal", "-o", "b.txt"]) == 0
    assert "the reference 'ref.tif' is not there, and the result does not say where it lies" in capsys.readouterr().err
    assert main(["warp", "r.json", str(tmp_path / "sec.tif"), "-o", "b.tif", "--workers", "1"]) == 0
    assert "the reference 'ref.tif' is not there" in capsys.readouterr().err


def test_a_result_that_knows_the_place_needs_no_file(tmp_path: Path) -> None:
    from dataclasses import replace

    result, _ = made(tmp_path, PLACE)
    assert result.reference is not None
    replace(result, reference=replace(result.reference, path="ref.tif", geolocation=PLACE)).to_json(tmp_path / "r.json")
    (tmp_path / "ref.tif").unlink()
    export(tmp_path / "r.json", tmp_path / "a.txt", to="gdal")
    assert float((tmp_path / "a.txt").read_text().split()[3]) > 500_000
    from featreg.products.warping import warp_file

    product = warp_file(tmp_path / "r.json", tmp_path / "sec.tif", tmp_path / "o.tif", workers=1)
    assert product.georeferenced
