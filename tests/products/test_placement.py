"""A product lands where its files say, or is refused: another place of the same size is another place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.geometry import Affine
from featreg.io import write_geotiff
from featreg.products.placement import Placed, relation
from featreg.products.warping import warp_file
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.simulate.orbit import RangeDoppler
from featreg.types import Geolocation, Matches

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

UTM = "EPSG:32632"
SHAPE = (120, 140)
GRID = (10.0, 0.0, 5e5, 0.0, -10.0, 6e6)
PLACE = Geolocation(GRID, UTM)


def moved(dx: float, dy: float, size: float = 10.0, crs: str | None = UTM) -> Geolocation:
    """The grid moved by pixels to the east and down, with another pixel size."""
    return Geolocation((size, 0.0, 5e5 + 10 * dx, 0.0, -size, 6e6 - 10 * dy), crs)


def picture() -> NDArray[np.float32]:
    """Smooth, so that a value names its place: x + 1000 y."""
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    return np.asarray(1.0 + x + 1000.0 * y, np.float32)


def registration(folder: Path, place: Geolocation | None = PLACE) -> Registration:
    write_geotiff(folder / "ref.tif", picture(), place)
    write_geotiff(folder / "sec.tif", picture())
    images: Any = {role: InputImage(str(folder / f"{role[:3]}.tif"), SHAPE) for role in ("reference", "secondary")}
    return Registration(Matches.empty(), {}, np.zeros(0, bool), Affine(np.eye(3)[:2]), "ok", **images)


def warped(folder: Path, like: Geolocation | None, place: Geolocation | None = PLACE) -> Any:
    result = registration(folder, place)
    write_geotiff(folder / "like.tif", picture(), like)
    warp_file(result, folder / "sec.tif", folder / "o.tif", like=folder / "like.tif", resampling="bilinear", workers=1)
    with rasterio.open(folder / "o.tif") as dataset:
        return dataset.read(1), dataset.transform


@pytest.mark.parametrize(("dx", "dy", "size"), [(50, 0, 10.0), (0, -30, 10.0), (7, 5, 20.0), (7, 5, 5.0)])
def test_a_grid_of_the_same_size_elsewhere_gets_its_own_part(dx: int, dy: int, size: float, tmp_path: Path) -> None:
    found, transform = warped(tmp_path, moved(dx, dy, size))
    assert tuple(transform)[:6] == moved(dx, dy, size).transform
    factor = size / 10
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)
    x, y = ((v + 0.5) * factor - 0.5 + d for v, d in ((x, dx), (y, dy)))
    inside = (x >= 0) & (y >= 0) & (x <= SHAPE[1] - 1) & (y <= SHAPE[0] - 1)
    assert np.array_equal(np.isfinite(found)[inside], np.ones(inside.sum(), bool))
    assert np.abs(found - (1 + x + 1000 * y))[inside].max() < 0.1
    outside = (x < -1) | (y < -1) | (x > SHAPE[1]) | (y > SHAPE[0])
    assert np.isnan(found[outside]).all()


@pytest.mark.parametrize(
    ("like", "place", "text"),
    [
        (moved(50, 0, crs=None), PLACE, "no coordinate system"),
        (moved(50, 0), moved(0, 0, crs=None), "no coordinate system"),
        (Geolocation(GRID, "EPSG:32633"), PLACE, "does not show|cannot hold|no valid pixel"),
    ],
)
def test_what_contradicts_is_named(like: Geolocation, place: Geolocation, text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=text):
        warped(tmp_path, like, place)


def test_another_coordinate_system_lands_where_its_map_says() -> None:
    from rasterio.warp import transform

    degrees = Geolocation((1.5e-4, 0, 9.0, 0, -1e-4, 54.147), "EPSG:4326")
    found = relation(Placed("a", SHAPE, degrees), Placed("b", SHAPE, PLACE))
    assert found is not None
    at = np.array([[0.0, 0], [139, 0], [0, 119], [139, 119], [70, 60]])
    east, north = transform("EPSG:4326", UTM, 9.0 + 1.5e-4 * (at[:, 0] + 0.5), 54.147 - 1e-4 * (at[:, 1] + 0.5))
    wanted = np.column_stack([(np.array(east) - 5e5) / 10, (6e6 - np.array(north)) / 10]) - 0.5
    assert np.abs(at @ found[:, :2].T + found[:, 2] - wanted).max() < 0.05


def test_maps_that_bend_against_each_other_are_refused() -> None:
    degrees = Geolocation((1.5e-4, 0, 9.0, 0, -1e-4, 54.147), "EPSG:4326")
    with pytest.raises(InputError, match="an affine map cannot hold that"):
        relation(Placed("a", (3000, 3000), degrees), Placed("b", (3000, 3000), PLACE))


def test_the_same_numbers_without_a_coordinate_system_are_the_same_place(tmp_path: Path) -> None:
    found, _ = warped(tmp_path, moved(0, 0, crs=None))
    assert np.array_equal(found, picture())


def _orbit() -> RangeDoppler:
    return RangeDoppler.over((12.0, 47.0), (400, 400), incidence_deg=35.0, heading_deg=-12.0, pixel=3.0)


def test_another_crop_located_by_rpc_gets_its_own_part() -> None:
    rpc = dict(_orbit().rpc((400, 400), 0.0, 1000.0, 15.0).rpcs)
    crop = {**rpc, "samp_off": rpc["samp_off"] - 50, "line_off": rpc["line_off"] + 20}
    whole, part = (Placed(n, SHAPE, Geolocation(rpcs=r)) for n, r in (("a", rpc), ("b", crop)))
    found = relation(whole, part)
    assert found is not None
    assert np.abs(found - [[1, 0, -50], [0, 1, 20]]).max() < 1e-3


def test_longitudes_on_another_turn_are_the_same_place() -> None:
    east = Geolocation((1e-4, 0, 200.0, 0, -1e-4, 10.0), "EPSG:4326")
    west = Geolocation((1e-4, 0, -160.0, 0, -1e-4, 10.0), "EPSG:4326")
    found = relation(Placed("a", SHAPE, east), Placed("b", SHAPE, west))
    assert found is not None
    assert np.array_equal(found, np.eye(3)[:2])


def test_a_reference_that_was_replaced_does_not_lend_its_place(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    from dataclasses import replace

    result = registration(tmp_path)
    assert result.reference is not None
    result = replace(result, reference=replace(result.reference, geolocation=PLACE))
    write_geotiff(tmp_path / "ref.tif", picture(), moved(50, 0))
    warp_file(result, tmp_path / "sec.tif", tmp_path / "o.tif", workers=1)
    with rasterio.open(tmp_path / "o.tif") as dataset:
        assert tuple(dataset.transform)[:6] == GRID
    assert "is not the reference any more: it lies elsewhere" in caplog.text
