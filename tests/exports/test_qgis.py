"""Tie points of QGIS: on the map, in pixels, of old versions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from featreg.errors import InputError
from featreg.exports.formats import export, read_tie_points
from featreg.io import write_geotiff
from featreg.study.truth import read_truth
from featreg.types import Geolocation
from made.exported import PLACE, REFERENCE, SECONDARY, SHAPE, registration_in

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def test_qgis_points_on_the_map(tmp_path: Path) -> None:
    export(registration_in(tmp_path), tmp_path / "t.points", to="qgis")
    lines = (tmp_path / "t.points").read_text().splitlines()
    assert lines[0].startswith("#CRS: PROJCS[")
    assert rasterio.crs.CRS.from_wkt(lines[0][6:]) == rasterio.crs.CRS.from_epsg(32632)
    assert lines[1] == "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"
    row = [float(v) for v in lines[2].split(",")]
    assert row[:5] == [500005.0, 5999995.0, 0.5, -0.5, 1]
    with pytest.raises(InputError, match="give the reference image"):
        read_tie_points(tmp_path / "t.points")
    back = read_tie_points(tmp_path / "t.points", reference=tmp_path / "ref.tif")
    np.testing.assert_allclose(back.reference_xy, REFERENCE[:10], atol=1e-7)
    np.testing.assert_allclose(back.secondary_xy, SECONDARY[:10], atol=1e-12)
    write_geotiff(tmp_path / "far.tif", np.ones(SHAPE), Geolocation(PLACE.transform, "EPSG:32633"))
    with pytest.raises(InputError, match="coordinate system is not that of"):
        read_tie_points(tmp_path / "t.points", reference=tmp_path / "far.tif")


@pytest.mark.parametrize(
    "place",
    [PLACE, Geolocation((0.001, 0.0, 15.8, 0.0, -0.001, -12.1), "EPSG:4326")],
    ids=["metres", "degrees that could be pixels"],
)
def test_qgis_has_the_source_on_its_own_map_where_it_has_one(tmp_path: Path, place: Geolocation) -> None:
    reg = registration_in(tmp_path)
    write_geotiff(tmp_path / "sec.tif", np.ones(SHAPE), place)
    export(reg, tmp_path / "t.points", to="qgis")
    assert place.transform is not None
    a, _, c, _, e, f = place.transform
    row = [float(v) for v in (tmp_path / "t.points").read_text().splitlines()[2].split(",")]
    assert row[2:4] == [c + 0.5 * a, f + 0.5 * e]
    images = {"reference": tmp_path / "ref.tif", "secondary": tmp_path / "sec.tif"}
    back = read_tie_points(tmp_path / "t.points", **images)
    np.testing.assert_allclose(back.secondary_xy, SECONDARY[:10], atol=1e-7)
    (tmp_path / "t.points").write_text("mapX,mapY,sourceX,sourceY\n1.5,-1.5,500005,5999995\n")
    with pytest.raises(InputError, match=r"sourceX, sourceY are no pixels.*give the secondary image"):
        read_tie_points(tmp_path / "t.points")


def test_points_marked_in_pixels_stay_pixels_beside_images_on_a_map(tmp_path: Path) -> None:
    registration_in(tmp_path)
    write_geotiff(tmp_path / "sec.tif", np.ones(SHAPE), PLACE)
    rows = np.hstack([REFERENCE + 0.5, SECONDARY + 0.5])[1:] * (1, -1, 1, -1)
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    (tmp_path / "t.points").write_text(f"mapX,mapY,sourceX,sourceY\n{text}\n")
    truth = read_truth(tmp_path / "t.points", images=(tmp_path / "ref.tif", tmp_path / "sec.tif"))
    assert np.allclose(truth(REFERENCE[1:]), SECONDARY[1:])


def test_qgis_points_without_a_map_are_pixels(tmp_path: Path) -> None:
    export(registration_in(tmp_path, None), tmp_path / "t.points", to="qgis")
    assert "#CRS" not in (tmp_path / "t.points").read_text()
    np.testing.assert_allclose(read_tie_points(tmp_path / "t.points").reference_xy, REFERENCE[:10], atol=1e-12)


def test_points_that_were_disabled_or_written_by_old_versions(tmp_path: Path) -> None:
    text = "mapX,mapY,pixelX,pixelY,enable\n10.5,-20.5,30.5,-40.5,1\n1,-1,1,-1,0\n"
    (tmp_path / "old.points").write_text(text)
    back = read_tie_points(tmp_path / "old.points")
    assert back.reference_xy.tolist() == [[10, 20]]
    assert back.secondary_xy.tolist() == [[30, 40]]
