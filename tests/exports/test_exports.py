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
from featreg.interfaces import FailedFit
from featreg.io import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.study.truth import read_truth
from featreg.types import Matches
from made.exported import MODEL, REFERENCE, SECONDARY, SHAPE, registration_in

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.mark.parametrize(("to", "name"), [("csv", "t.csv"), ("parquet", "t.parquet"), ("envi", "t.pts")])
def test_what_was_written_is_read_back(tmp_path: Path, to: str, name: str) -> None:
    assert export(registration_in(tmp_path), tmp_path / name, to=to, stage="all") == 12
    back = read_tie_points(tmp_path / name)
    exact = 0 if to != "envi" else 1e-6
    np.testing.assert_allclose(back.reference_xy, REFERENCE, atol=exact)
    np.testing.assert_allclose(back.secondary_xy, SECONDARY, atol=exact)
    if to != "envi":
        np.testing.assert_array_equal(back.score, [0, 1, 2, np.nan, *range(4, 12)])


def test_the_stage_chooses_the_rows(tmp_path: Path) -> None:
    reg = registration_in(tmp_path)
    assert [export(reg, tmp_path / "t.csv", to="csv", stage=s) for s in ("inliers", "gms", "all")] == [10, 11, 12]
    with pytest.raises(ParameterError, match=r"no stage 'gsm'.*'gms'"):
        export(reg, tmp_path / "t.csv", to="csv", stage="gsm")


def test_csv_has_every_column_and_pandas_reads_it(tmp_path: Path) -> None:
    import pandas as pd

    export(registration_in(tmp_path), tmp_path / "t.csv", to="csv")
    table = pd.read_csv(tmp_path / "t.csv")
    assert list(table.columns)[:7] == ["reference_x", "reference_y", "secondary_x", "secondary_y", "score", "residual",
                                       "inlier"]  # fmt: skip
    assert table["score"].isna().sum() == 1
    assert (table["residual"][1:] < 1e-9).all()
    assert table["residual"][0] == pytest.approx(np.hypot(3.25, 2.5))


def test_envi_counts_the_first_pixels_centre_as_one_and_a_half(tmp_path: Path) -> None:
    export(registration_in(tmp_path), tmp_path / "t.pts", to="envi")
    lines = (tmp_path / "t.pts").read_text().splitlines()
    assert lines[0] == "; ENVI Image to Image GCP File"
    first = next(line for line in lines if not line.startswith(";"))
    assert [float(v) for v in first.split()] == [1.5, 1.5, 1.5, 1.5]


def blob(data: bytes, dtype: str, columns: int) -> NDArray[Any]:
    return np.frombuffer(data, dtype).reshape(-1, columns)


def test_colmap_database_by_its_documented_schema(tmp_path: Path) -> None:
    export(registration_in(tmp_path), tmp_path / "t.db", to="colmap")
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
    registration_in(tmp_path).to_json(result)
    before = beside.read_bytes()
    with pytest.raises(InputError, match="would replace an input"):
        export(result, beside, to="parquet")
    assert main(["export", str(result), "--to", "parquet", "-o", str(beside)]) == 2
    assert beside.read_bytes() == before


def test_misuse(tmp_path: Path) -> None:
    reg = registration_in(tmp_path)
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
    export(registration_in(tmp_path), tmp_path / "t.pts", to="envi", stage="fsc")
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
    registration_in(tmp_path).to_json(result)
    assert main(["export", str(result), "--to", "qgis", "-o", str(tmp_path / "t.points")]) == 0
    assert "10 tie points (inliers)" in capsys.readouterr().out
    registration_in(tmp_path, status="unreliable").to_json(result)
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
