"""Vector formats are read back by programs that know nothing of featreg, and say where things lie."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.exports import layers
from featreg.exports.content import ground_of
from featreg.exports.formats import export, read_tie_points
from featreg.geolocation.footprint import outline
from featreg.geometry import Affine
from featreg.interfaces import FailedFit
from featreg.io import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (90, 120)
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
#: The same ground in the next zone, turned and finer, and 30 m off to the east.
OTHER = Geolocation((5.0, 0.0, 106_000.0, 0.0, -5.0, 6_014_000.0), "EPSG:32633")
MODEL = Affine(np.array([[0.0, -1.0, 100.0], [1.0, 0.0, 5.0]]))  # a quarter turn
RNG = np.random.default_rng(0)
REFERENCE = RNG.uniform(5, 80, (12, 2))
SECONDARY = MODEL(REFERENCE) + RNG.normal(0, 0.3, (12, 2))
COVARIANCE = np.tile(np.array([[0.09, 0.0], [0.0, 0.01]]), (12, 1, 1))


def result(
    folder: Path,
    place: Geolocation | None = PLACE,
    other: Geolocation | None = None,
    model: Any = MODEL,
    count: int = 12,
) -> Registration:
    write_geotiff(folder / "ref.tif", np.ones(SHAPE, np.float32), place)
    write_geotiff(folder / "sec.tif", np.ones(SHAPE, np.float32), other)
    covariance = COVARIANCE.copy()
    covariance[3] = np.nan
    matches = Matches(REFERENCE, SECONDARY, np.arange(12.0), covariance).take(np.arange(count))
    images: Any = {role: InputImage(str(folder / f"{role[:3]}.tif"), SHAPE) for role in ("reference", "secondary")}
    inliers = np.arange(count) < 10
    return Registration(matches, {"fsc": inliers}, inliers, model, "ok", provenance={"method": "m"}, **images)


def ground(xy: np.ndarray[Any, Any], place: Geolocation = PLACE) -> np.ndarray[Any, Any]:
    assert place.transform is not None
    a, _, c, _, e, f = place.transform
    return np.column_stack([c + a * (xy[:, 0] + 0.5), f + e * (xy[:, 1] + 0.5)])


def test_a_geopackage_has_four_layers_in_the_reference_system(tmp_path: Path) -> None:
    gpd = pytest.importorskip("geopandas")
    pyogrio = pytest.importorskip("pyogrio")
    assert export(result(tmp_path), tmp_path / "t.gpkg", to="gpkg", stage="all") == 12
    assert [name for name, _ in pyogrio.list_layers(tmp_path / "t.gpkg")] == [
        "tie_points", "arrows", "ellipses", "footprints",
    ]  # fmt: skip
    points, arrows, ellipses, outlines = (
        gpd.read_file(tmp_path / "t.gpkg", layer=n) for n in ("tie_points", "arrows", "ellipses", "footprints")
    )
    assert points.crs.to_epsg() == ellipses.crs.to_epsg() == 32632
    np.testing.assert_allclose(points.get_coordinates(), ground(REFERENCE), atol=1e-6)
    np.testing.assert_allclose(points["residual"], np.hypot(*(MODEL(REFERENCE) - SECONDARY).T), atol=1e-12)
    assert points["inlier"].sum() == 10
    assert points["stage"].tolist() == [1] * 10 + [0] * 2
    # The secondary says nothing of where it lies: the arrow ends where its point comes to lie by the model.
    assert set(arrows["placed_by"]) == {"model"}
    ends = np.array([line.coords[-1] for line in arrows.geometry])
    np.testing.assert_allclose(ends, ground(MODEL.inverse(SECONDARY)), atol=1e-6)
    # 95 % of 0.3 px along x and 0.1 px along y of the secondary: a quarter turn and pixels of 10 m later.
    assert ellipses["row"].tolist() == [k for k in range(12) if k != 3]
    reach = 10 * np.sqrt(-2 * np.log(0.05))
    bounds = ellipses.geometry.iloc[0].bounds
    np.testing.assert_allclose(bounds[2] - bounds[0], 2 * 0.1 * reach, rtol=1e-6)
    np.testing.assert_allclose(bounds[3] - bounds[1], 2 * 0.3 * reach, rtol=1e-6)
    areas = dict(zip(outlines["image"], outlines.geometry.area, strict=True))
    assert areas == pytest.approx({"reference": 1200.0 * 900.0, "secondary": 1200.0 * 900.0})
    assert outlines["status"].tolist() == ["ok", "ok"]


def test_arrows_end_where_the_secondary_says_that_it_lies(tmp_path: Path) -> None:
    gpd = pytest.importorskip("geopandas")
    pyproj = pytest.importorskip("pyproj")
    export(result(tmp_path, other=OTHER), tmp_path / "t.gpkg", to="gpkg", stage="all")
    arrows = gpd.read_file(tmp_path / "t.gpkg", layer="arrows")
    to_reference = pyproj.Transformer.from_crs(32633, 32632, always_xy=True)
    wanted = np.column_stack(to_reference.transform(*ground(SECONDARY, OTHER).T))
    ends = np.array([line.coords[-1] for line in arrows.geometry])
    np.testing.assert_allclose(ends, wanted, atol=1e-3)
    assert set(arrows["placed_by"]) == {"geolocation"}
    outlines = gpd.read_file(tmp_path / "t.gpkg", layer="footprints").set_index("image")
    assert outlines.geometry["secondary"].area == pytest.approx(600 * 450, rel=0.01)


def test_geoparquet_is_read_by_geopandas_and_pyarrow(tmp_path: Path) -> None:
    gpd = pytest.importorskip("geopandas")
    import pyarrow.parquet as pq

    assert export(result(tmp_path), tmp_path / "t.parquet", to="geoparquet") == 10
    table = gpd.read_parquet(tmp_path / "t.parquet")
    assert table.crs.to_epsg() == 32632
    np.testing.assert_allclose(table.get_coordinates(), ground(REFERENCE[:10]), atol=1e-6)
    assert table["arrow"].crs.to_epsg() == 32632
    assert table["ellipse"].isna().tolist() == [k == 3 for k in range(10)]
    kept = pq.read_metadata(tmp_path / "t.parquet").metadata
    about = json.loads(kept[b"geo"])
    assert about["primary_column"] == "geometry"
    assert set(about["columns"]) == {"geometry", "arrow", "ellipse"}
    # The same file is a table of tie points to featreg, and they are those that went in.
    back = read_tie_points(tmp_path / "t.parquet")
    np.testing.assert_array_equal(back.secondary_xy, SECONDARY[:10])


def test_geojson_is_longitude_and_latitude(tmp_path: Path) -> None:
    gpd = pytest.importorskip("geopandas")
    pyproj = pytest.importorskip("pyproj")
    assert export(result(tmp_path), tmp_path / "t.geojson", to="geojson") == 10
    table = gpd.read_file(tmp_path / "t.geojson")
    assert table.crs.to_epsg() == 4326
    assert table["layer"].value_counts().to_dict() == {"tie_points": 10, "arrows": 10, "ellipses": 9, "footprints": 2}
    points = table[table["layer"] == "tie_points"]
    to_lonlat = pyproj.Transformer.from_crs(32632, 4326, always_xy=True)
    wanted = np.column_stack(to_lonlat.transform(*ground(REFERENCE[:10]).T))
    np.testing.assert_allclose(points.get_coordinates(), wanted, atol=1e-9)
    # RFC 7946: outer rings run anticlockwise.
    assert all(shape.exterior.is_ccw for shape in table[table["layer"] == "footprints"].geometry)
    whole = json.loads((tmp_path / "t.geojson").read_text())
    assert "crs" not in whole
    scores = [f["properties"]["score"] for f in whole["features"] if f["properties"]["layer"] == "tie_points"]
    assert scores == list(range(10))


def test_a_rim_beside_the_ground_costs_the_outline_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def of(image: Any, xy: Any, model: Any) -> Any:
        if len(xy) == len(outline(SHAPE)) and "ref" in image.path:
            raise InputError("they have no place on the ground")
        return ground_of(image, xy, model)

    monkeypatch.setattr(layers, "ground_of", of)
    assert export(result(tmp_path), tmp_path / "t.geojson", to="geojson") == 10
    names = [f["properties"]["layer"] for f in json.loads((tmp_path / "t.geojson").read_text())["features"]]
    assert (names.count("tie_points"), names.count("footprints")) == (10, 0)
    assert "ref.tif: its rim does not lie on the ground" in caplog.text


def test_geojson_is_cut_at_the_date_line(tmp_path: Path) -> None:
    fiji = Geolocation((0.001, 0.0, 179.95, 0.0, -0.001, -16.0), "EPSG:4326")
    export(result(tmp_path, fiji), tmp_path / "t.geojson", to="geojson")
    features = json.loads((tmp_path / "t.geojson").read_text())["features"]
    outline = next(f for f in features if f["properties"].get("image") == "reference")
    assert outline["geometry"]["type"] == "MultiPolygon"
    west, east = (np.array(part[0]) for part in outline["geometry"]["coordinates"])
    areas = []
    for part in (west, east):
        assert part[0].tolist() == part[-1].tolist()
        assert np.abs(part[:, 0]).max() == 180
        areas.append(np.ptp(part[:, 0]) * np.ptp(part[:, 1]))
    # 0.12 x 0.09 degrees, 0.05 of the 0.12 before the line.
    assert sorted(areas) == pytest.approx([0.05 * 0.09, 0.07 * 0.09])


def test_without_a_map_there_are_pixels_and_no_geojson(tmp_path: Path) -> None:
    gpd = pytest.importorskip("geopandas")
    reg = result(tmp_path, None)
    with pytest.raises(InputError, match="nothing says where the reference"):
        export(reg, tmp_path / "t.geojson", to="geojson")
    assert not (tmp_path / "t.geojson").exists()
    export(reg, tmp_path / "t.gpkg", to="gpkg", stage="all")
    points = gpd.read_file(tmp_path / "t.gpkg", layer="tie_points")
    assert points.crs is None or "unknown" in str(points.crs).lower() or "undefined" in str(points.crs).lower()
    np.testing.assert_allclose(points.get_coordinates(), (REFERENCE + 0.5) * (1, -1), atol=1e-9)
    arrows = gpd.read_file(tmp_path / "t.gpkg", layer="arrows")
    ends = np.array([line.coords[-1] for line in arrows.geometry])
    np.testing.assert_allclose(ends, (SECONDARY + 0.5) * (1, -1), atol=1e-9)


@pytest.mark.parametrize("to", ["gpkg", "geoparquet", "geojson"])
def test_nothing_found_is_an_empty_file_of_the_right_form(tmp_path: Path, to: str) -> None:
    gpd = pytest.importorskip("geopandas")
    reg = result(tmp_path, model=FailedFit("nothing to fit"), count=0)
    path = tmp_path / f"t.{ {'geoparquet': 'parquet'}.get(to, to) }"
    assert export(reg, path, to=to) == 0
    layer = {"layer": "tie_points"} if to == "gpkg" else {}
    table = gpd.read_parquet(path) if to == "geoparquet" else gpd.read_file(path, **layer)
    assert len(table) == (1 if to == "geojson" else 0)  # the reference's outline


def test_a_missing_library_is_named_with_its_cure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "geopandas", None)
    with pytest.raises(InputError, match=r"geopandas.*pip install 'featreg\[vectors\]'"):
        export(result(tmp_path), tmp_path / "t.gpkg", to="gpkg")
    assert not (tmp_path / "t.gpkg").exists()
