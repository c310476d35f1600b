"""The STAC item beside a product: valid against the specification, and right about where and when."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.cli.main import main
from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine
from featreg.io import write_geotiff
from featreg.products.stac import acquired
from featreg.products.warping import warp_file
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (90, 120)
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
WHEN = "2024-05-01T07:11:20+02:00"


def made(folder: Path, place: Geolocation | None = PLACE, dtype: Any = np.uint16) -> Registration:
    rng = np.random.default_rng(0)
    write_geotiff(folder / "ref.tif", rng.integers(1, 200, SHAPE).astype(dtype), place)
    write_geotiff(folder / "sec.tif", rng.integers(1, 200, SHAPE).astype(dtype))
    xy = rng.uniform(5, 80, (12, 2))
    model = Affine(np.eye(3)[:2])
    images: Any = {role: InputImage(str(folder / f"{role[:3]}.tif"), SHAPE) for role in ("reference", "secondary")}
    return Registration(
        Matches(xy, xy, np.ones(12)), {}, np.ones(12, bool), model, "ok", provenance={"method": "m"}, **images
    )


def validated(path: Path) -> Any:
    """The item as pystac reads it, whole by the schemas of the specification that pystac brings along."""
    pystac = pytest.importorskip("pystac")
    jsonschema = pytest.importorskip("jsonschema")
    from pystac.validation.local_validator import get_local_schema_cache
    from referencing import Registry, Resource

    schemas = get_local_schema_cache()
    known: Any = Registry().with_resources([(k, Resource.from_contents(v)) for k, v in schemas.items()])
    whole = next(schema for address, schema in schemas.items() if address.endswith("/item.json"))
    validator = jsonschema.Draft7Validator(whole, registry=known)
    assert [error.message for error in validator.iter_errors(json.loads(path.read_text()))] == []
    return pystac.Item.from_file(str(path))


def test_the_item_is_valid_and_says_where_and_when(tmp_path: Path) -> None:
    product = warp_file(made(tmp_path), tmp_path / "sec.tif", tmp_path / "out.tif", stac=WHEN)
    assert product.items == (tmp_path / "out.json",)
    item = validated(tmp_path / "out.json")
    from pystac.extensions.projection import ProjectionExtension

    projection = ProjectionExtension.ext(item)
    assert projection.code == "EPSG:32632"
    assert (projection.shape, projection.transform) == ([90, 120], [10.0, 0.0, 5e5, 0.0, -10.0, 6e6])
    assert projection.bbox == [5e5, 6e6 - 900, 5e5 + 1200, 6e6]
    assert item.datetime is not None
    assert item.datetime.isoformat() == "2024-05-01T05:11:20+00:00"
    from rasterio.warp import transform_bounds

    np.testing.assert_allclose(item.bbox, transform_bounds(32632, 4326, *projection.bbox, densify_pts=101), atol=1e-7)
    asset = item.assets["data"]
    assert Path(tmp_path, asset.href).is_file()
    assert asset.extra_fields["bands"] == [{"name": "b1", "data_type": "uint16", "nodata": 0.0}]
    assert [link.href for link in item.links if link.rel == "derived_from"] == ["sec.tif", "ref.tif"]
    assert item.properties["featreg:status"] == "ok"


def test_times_are_stated_and_understood() -> None:
    assert acquired("2024-05-01T05:11:20/2024-05-01T05:11:45Z") == {
        "datetime": None, "start_datetime": "2024-05-01T05:11:20Z", "end_datetime": "2024-05-01T05:11:45Z",
    }  # fmt: skip
    assert acquired("2024-05-01") == {"datetime": "2024-05-01T00:00:00Z"}
    for wrong in ("yesterday", "", "2024-05-01/2024-04-01", "a/b/c", "0001-01-01T00:00:00+05:00"):
        with pytest.raises(ParameterError, match=r"is needed, or START/END|ends before it begins"):
            acquired(wrong)


def test_nothing_is_made_where_the_item_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a STAC item needs a georeferenced reference"):
        warp_file(made(tmp_path, None), tmp_path / "sec.tif", tmp_path / "out.tif", stac=WHEN)
    (tmp_path / "out.json").write_text('{"mine": 1}')
    with pytest.raises(InputError, match="is no STAC item"):
        warp_file(made(tmp_path), tmp_path / "sec.tif", tmp_path / "out.tif", stac=WHEN)
    assert not (tmp_path / "out.tif").exists()
    assert (tmp_path / "out.json").read_text() == '{"mine": 1}'


def test_the_command_never_replaces_its_own_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made(tmp_path, dtype=np.complex64).to_json(tmp_path / "r.json")
    arguments = ["warp", str(tmp_path / "r.json"), str(tmp_path / "sec.tif"), "--stac", WHEN]
    assert main([*arguments, "-o", str(tmp_path / "r.tif")]) == 2
    assert "input" in capsys.readouterr().err
    assert main([*arguments, "-o", str(tmp_path / "o.tif"), "--coherence", str(tmp_path / "c.tif")]) == 0
    out = capsys.readouterr().out
    assert f"written: {tmp_path / 'c.json'}, a STAC item" in out
    assert validated(tmp_path / "c.json").assets["data"].extra_fields["bands"][0]["nodata"] == "nan"
    assert validated(tmp_path / "o.json").assets["data"].extra_fields["bands"] == [
        {"name": "b1", "data_type": "cfloat32"}
    ]


def test_slant_geometry_and_the_date_line(tmp_path: Path) -> None:
    x, y = (values.ravel() for values in np.meshgrid([0.0, 60.0, 119.0], [0.0, 45.0, 89.0]))
    gcps = np.column_stack([x, y, 179.95 + 0.001 * x, -16 - 0.001 * y, np.zeros(9)])
    warp_file(
        made(tmp_path, Geolocation(crs="EPSG:4326", gcps=gcps)), tmp_path / "sec.tif", tmp_path / "o.tif", stac=WHEN
    )
    item = validated(tmp_path / "o.json")
    assert item.geometry["type"] == "MultiPolygon"
    assert item.properties["proj:code"] is None
    west, _, east, _ = item.bbox
    assert west > 179.9
    assert east < -179.9
