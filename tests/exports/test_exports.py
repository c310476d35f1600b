"""Exports: each file says of the first pixel's centre what its program says, and is read back by it or by its rule."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.cli.export import NAMES
from featreg.cli.main import main
from featreg.errors import InputError, ParameterError
from featreg.exports.colmap import pair_id
from featreg.exports.formats import FORMATS, export, read_tie_points
from featreg.fitting import fit
from featreg.geometry import Affine
from featreg.interfaces import FailedFit
from featreg.io import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.study.truth import read_truth
from featreg.types import Geolocation, Matches

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
MODEL = Affine(np.array([[0.99, 0.05, 3.25], [-0.05, 1.01, -2.5]]))
SHAPE = (90, 120)
# The first tie point is the first pixel's centre in both images.
REFERENCE = np.vstack([[0.0, 0.0], np.random.default_rng(0).uniform(5, 80, (11, 2))])
SECONDARY = np.vstack([[0.0, 0.0], MODEL(REFERENCE[1:])])


def one() -> list[float]:
    return [1.0] + [0.0] * 19


RPCS: dict[str, Any] = {
    "line_off": 45.0, "samp_off": 60.0, "line_scale": 45.0, "samp_scale": 60.0, "lat_off": 41.0, "lat_scale": 0.05,
    "long_off": 15.0, "long_scale": 0.05, "height_off": 120.0, "height_scale": 100.0,
    "line_num_coeff": [0, 0, -1.0] + [0.0] * 17, "line_den_coeff": one(),
    "samp_num_coeff": [0, 1.0] + [0.0] * 18, "samp_den_coeff": one(), "err_bias": 1.0, "err_rand": 1.0,
}  # fmt: skip


def made(folder: Path, place: Geolocation | None = PLACE, status: str = "ok") -> Registration:
    """Twelve tie points, two of them no inliers, and files of both images."""
    rng = np.random.default_rng(1)
    write_geotiff(folder / "ref.tif", rng.integers(1, 200, SHAPE).astype(np.uint16), place)
    write_geotiff(folder / "sec.tif", rng.integers(1, 200, SHAPE).astype(np.uint16), nodata=0)
    score = np.arange(12.0)
    score[3] = np.nan
    matches = Matches(REFERENCE, SECONDARY, score)
    inliers = np.arange(12) < 10
    paths = {"reference": folder / "ref.tif", "secondary": folder / "sec.tif"}
    images: dict[str, Any] = {role: InputImage(str(path), SHAPE) for role, path in paths.items()}
    stages = {"gms": np.arange(12) < 11, "fsc": inliers}
    reason = "" if status == "ok" else "made up"
    return Registration(matches, stages, inliers, MODEL, status, reason, provenance={"method": "m"}, **images)


@pytest.mark.parametrize(("to", "name"), [("csv", "t.csv"), ("parquet", "t.parquet"), ("envi", "t.pts")])
def test_what_was_written_is_read_back(tmp_path: Path, to: str, name: str) -> None:
    assert export(made(tmp_path), tmp_path / name, to=to, stage="all") == 12
    back = read_tie_points(tmp_path / name)
    exact = 0 if to != "envi" else 1e-6
    np.testing.assert_allclose(back.reference_xy, REFERENCE, atol=exact)
    np.testing.assert_allclose(back.secondary_xy, SECONDARY, atol=exact)
    if to != "envi":
        np.testing.assert_array_equal(back.score, [0, 1, 2, np.nan, *range(4, 12)])


def test_the_stage_chooses_the_rows(tmp_path: Path) -> None:
    reg = made(tmp_path)
    assert [export(reg, tmp_path / "t.csv", to="csv", stage=s) for s in ("inliers", "gms", "all")] == [10, 11, 12]
    with pytest.raises(ParameterError, match=r"no stage 'gsm'.*'gms'"):
        export(reg, tmp_path / "t.csv", to="csv", stage="gsm")


def test_csv_has_every_column_and_pandas_reads_it(tmp_path: Path) -> None:
    import pandas as pd

    export(made(tmp_path), tmp_path / "t.csv", to="csv")
    table = pd.read_csv(tmp_path / "t.csv")
    assert list(table.columns)[:7] == ["reference_x", "reference_y", "secondary_x", "secondary_y", "score", "residual",
                                       "inlier"]  # fmt: skip
    assert table["score"].isna().sum() == 1
    assert (table["residual"][1:] < 1e-9).all()
    assert table["residual"][0] == pytest.approx(np.hypot(3.25, 2.5))


def test_envi_counts_the_first_pixels_centre_as_one_and_a_half(tmp_path: Path) -> None:
    export(made(tmp_path), tmp_path / "t.pts", to="envi")
    lines = (tmp_path / "t.pts").read_text().splitlines()
    assert lines[0] == "; ENVI Image to Image GCP File"
    first = next(line for line in lines if not line.startswith(";"))
    assert [float(v) for v in first.split()] == [1.5, 1.5, 1.5, 1.5]


def test_qgis_points_on_the_map(tmp_path: Path) -> None:
    export(made(tmp_path), tmp_path / "t.points", to="qgis")
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
    reg = made(tmp_path)
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
    made(tmp_path)
    write_geotiff(tmp_path / "sec.tif", np.ones(SHAPE), PLACE)
    rows = np.hstack([REFERENCE + 0.5, SECONDARY + 0.5])[1:] * (1, -1, 1, -1)
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    (tmp_path / "t.points").write_text(f"mapX,mapY,sourceX,sourceY\n{text}\n")
    truth = read_truth(tmp_path / "t.points", images=(tmp_path / "ref.tif", tmp_path / "sec.tif"))
    assert np.allclose(truth(REFERENCE[1:]), SECONDARY[1:])


def test_qgis_points_without_a_map_are_pixels(tmp_path: Path) -> None:
    export(made(tmp_path, None), tmp_path / "t.points", to="qgis")
    assert "#CRS" not in (tmp_path / "t.points").read_text()
    np.testing.assert_allclose(read_tie_points(tmp_path / "t.points").reference_xy, REFERENCE[:10], atol=1e-12)


def test_points_that_were_disabled_or_written_by_old_versions(tmp_path: Path) -> None:
    text = "mapX,mapY,pixelX,pixelY,enable\n10.5,-20.5,30.5,-40.5,1\n1,-1,1,-1,0\n"
    (tmp_path / "old.points").write_text(text)
    back = read_tie_points(tmp_path / "old.points")
    assert back.reference_xy.tolist() == [[10, 20]]
    assert back.secondary_xy.tolist() == [[30, 40]]


@pytest.mark.parametrize("name", ["t.vrt", "t.tif"])
def test_gdal_gcps_give_the_reference_ground_at_the_secondary_pixels(tmp_path: Path, name: str) -> None:
    export(made(tmp_path), tmp_path / name, to="gdal")
    with rasterio.open(tmp_path / name) as dataset:
        gcps, crs = dataset.gcps
        assert crs == rasterio.crs.CRS.from_epsg(32632)
        assert (gcps[0].col, gcps[0].row, gcps[0].x, gcps[0].y) == (0.5, 0.5, 500005.0, 5999995.0)
        assert len(gcps) == 10
        # GDAL's own transformer takes a pixel centre of the secondary to the ground of the reference's pixel.
        with rasterio.transform.GCPTransformer(gcps[1:]) as transformer:
            at = np.array([[30.0, 20.0]])
            u, v = MODEL(at)[0]
            x, y = transformer.xy(v, u, offset="center")
            assert np.allclose([x, y], [500000 + 10 * 30.5, 6000000 - 10 * 20.5], atol=1e-3)
        with rasterio.open(tmp_path / "sec.tif") as source:
            np.testing.assert_array_equal(dataset.read(1), source.read(1))
            assert dataset.nodata == 0


def test_gdal_gcps_of_a_reference_with_rpcs_lie_at_the_height_offset(tmp_path: Path) -> None:
    export(made(tmp_path, Geolocation(rpcs=RPCS)), tmp_path / "t.vrt", to="gdal")
    with rasterio.open(tmp_path / "t.vrt") as dataset:
        gcps, crs = dataset.gcps
    assert crs == rasterio.crs.CRS.from_epsg(4326)
    assert gcps[0].z == 120
    assert np.allclose([gcps[0].x, gcps[0].y], [15 - 0.05, 41 + 0.05])  # column 0 is samp_off - samp_scale


def test_gdal_options_and_image_to_image(tmp_path: Path) -> None:
    export(made(tmp_path, None), tmp_path / "t.txt", to="gdal")
    first = (tmp_path / "t.txt").read_text().splitlines()[0]
    assert first == "-gcp 0.5 0.5 0.5 -0.5 0.0"


def test_gdal_needs_the_secondarys_file(tmp_path: Path) -> None:
    reg = made(tmp_path)
    (tmp_path / "sec.tif").rename(tmp_path / "moved.tif")
    with pytest.raises(InputError, match=r"need the secondary's file.*sec\.tif"):
        export(reg, tmp_path / "t.vrt", to="gdal")
    assert not (tmp_path / "t.vrt").exists()
    assert export(reg, tmp_path / "t.vrt", to="gdal", secondary=tmp_path / "moved.tif") == 10
    write_geotiff(tmp_path / "small.tif", np.ones((20, 20)))
    with pytest.raises(InputError, match="20 x 20 pixels, but the secondary of the result was 120 x 90"):
        export(reg, tmp_path / "t.vrt", to="gdal", secondary=tmp_path / "small.tif")


def blob(data: bytes, dtype: str, columns: int) -> NDArray[Any]:
    return np.frombuffer(data, dtype).reshape(-1, columns)


def test_colmap_database_by_its_documented_schema(tmp_path: Path) -> None:
    export(made(tmp_path), tmp_path / "t.db", to="colmap")
    database = sqlite3.connect(tmp_path / "t.db")
    assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert database.execute("PRAGMA foreign_key_check").fetchall() == []
    cameras = database.execute("SELECT model, width, height, params FROM cameras").fetchall()
    assert cameras[0][:3] == (0, 120, 90)
    assert np.frombuffer(cameras[0][3], "<f8").tolist() == [144.0, 60.0, 45.0]
    names = database.execute("SELECT image_id, name FROM images ORDER BY image_id").fetchall()
    assert names == [(1, "ref.tif"), (2, "sec.tif")]
    keypoints = {i: blob(d, "<f4", c) for i, c, d in database.execute("SELECT image_id, cols, data FROM keypoints")}
    np.testing.assert_allclose(keypoints[1], REFERENCE[:10] + 0.5, rtol=1e-6)
    np.testing.assert_allclose(keypoints[2], SECONDARY[:10] + 0.5, rtol=1e-6)
    number, rows, data = database.execute("SELECT pair_id, rows, data FROM matches").fetchone()
    assert (number, rows) == (2147483647 * 1 + 2, 10)
    assert number == pair_id(2, 1)
    assert blob(data, "<u4", 2).tolist() == [[k, k] for k in range(10)]
    config, matrix = database.execute("SELECT config, H FROM two_view_geometries").fetchone()
    assert config == 4
    h = np.frombuffer(matrix, "<f8").reshape(3, 3)
    mapped = np.column_stack([REFERENCE + 0.5, np.ones(12)]) @ h.T
    np.testing.assert_allclose(mapped[1:, :2], SECONDARY[1:] + 0.5, atol=1e-9)


def test_every_format_is_listed_everywhere() -> None:
    assert tuple(FORMATS) == NAMES
    modules = {p.stem for p in Path(__file__).parents[2].joinpath("featreg", "exports").glob("*.py")}
    assert modules == {*FORMATS, "npy", "__init__", "columns", "content", "formats", "frames", "layers"}


@pytest.mark.parametrize("name", sorted(set(FORMATS) - {"rpc"}))
def test_nothing_to_export_is_no_error(tmp_path: Path, name: str) -> None:
    write_geotiff(tmp_path / "sec.tif", np.ones(SHAPE))
    failed = Registration(
        Matches.empty(), {}, np.zeros(0, bool), FailedFit("no points"), "unreliable", "no points",
        secondary=InputImage(str(tmp_path / "sec.tif"), (90, 120)),
    )  # fmt: skip
    target = tmp_path / f"t{FORMATS[name].suffixes[0]}"
    assert export(failed, target, to=name) == 0
    assert target.is_file()


def test_the_tie_points_of_the_result_itself_are_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("featreg.results.json_file.MAX_ROWS", 5)
    result, beside = tmp_path / "r.json", tmp_path / "r.tie_points.parquet"
    made(tmp_path).to_json(result)
    before = beside.read_bytes()
    with pytest.raises(InputError, match="would replace an input"):
        export(result, beside, to="parquet")
    assert main(["export", str(result), "--to", "parquet", "-o", str(beside)]) == 2
    assert beside.read_bytes() == before


def test_misuse(tmp_path: Path) -> None:
    reg = made(tmp_path)
    with pytest.raises(ParameterError, match="did you mean 'csv'"):
        export(reg, tmp_path / "t.csv", to="cvs")
    with pytest.raises(ParameterError, match=r"needs a name that ends in \.pts"):
        export(reg, tmp_path / "t.csv", to="envi")
    with pytest.raises(InputError, match="would replace an input"):
        export(reg, tmp_path / "sec.tif", to="gdal")
    with pytest.raises(InputError, match="cannot be written"):
        export(reg, tmp_path / "none" / "t.csv", to="csv")
    assert not list(tmp_path.glob(".*"))


def test_tie_points_of_others_fit_and_are_a_truth(tmp_path: Path) -> None:
    export(made(tmp_path), tmp_path / "t.pts", to="envi", stage="fsc")
    matches = read_tie_points(tmp_path / "t.pts").take(np.arange(1, 10))
    result = fit(matches, filters=[], model="affine")
    assert result.model
    assert np.allclose(np.asarray(result.model.matrix), MODEL.matrix, atol=1e-5)
    text = "\n".join(",".join(map(str, r)) for r in np.hstack([REFERENCE, SECONDARY])[1:].tolist())
    (tmp_path / "bare.csv").write_text(text)
    truth = read_truth(tmp_path / "bare.csv")
    assert np.allclose(truth(REFERENCE[1:]), SECONDARY[1:])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.xyz", "", "must be a .points"),
        ("none.csv", None, "No such file"),
        ("a.csv", "", "is empty"),
        ("a.csv", "reference_x,reference_y,secondary_x\n1,2,3\n", "secondary_y not found"),
        ("a.csv", "1,2,3\n", r"\(M, 4\)"),
        ("a.csv", "1,2,3,4\n1,2,3\n", "row 2 has 3 columns"),
        ("a.csv", "1,2,3,four\n", "columns reference_x"),
        ("a.pts", "; Map (x,y), Image (x,y)\n1 2 3 4\n", "image to image"),
        ("a.points", "a,b\n1,2\n", "header must name mapX"),
        ("a.parquet", "nothing", "not a whole Parquet"),
    ],
)
def test_files_that_are_no_tie_points(tmp_path: Path, name: str, text: str | None, words: str) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_tie_points(tmp_path / name)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = tmp_path / "r.json"
    made(tmp_path).to_json(result)
    assert main(["export", str(result), "--to", "qgis", "-o", str(tmp_path / "t.points")]) == 0
    assert "10 tie points (inliers)" in capsys.readouterr().out
    made(tmp_path, status="unreliable").to_json(result)
    assert main(["export", str(result), "--to", "csv", "-o", str(tmp_path / "t.csv"), "--stage", "all"]) == 3
    assert (tmp_path / "t.csv").exists()
    assert "made up" in capsys.readouterr().err
    for wrong, words in [
        (["--to", "qgs", "-o", "t.points"], "'qgis'"),
        (["--to", "qgis", "-o", "t.csv"], ".points"),
        (["--to", "csv", "-o", "none/t.csv"], "does not exist"),
        (["--to", "csv", "-o", str(tmp_path / "u.csv"), "--stage", "fcs"], "'fsc'"),
    ]:
        assert main(["export", str(result), *wrong]) == 2
        err = capsys.readouterr().err
        assert words in err
        assert err.count("\n") == 1
    assert main(["export", str(tmp_path / "none.json"), "--to", "csv", "-o", str(tmp_path / "u.csv")]) == 2
    assert "none.json" in capsys.readouterr().err
