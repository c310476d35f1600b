"""What COLMAP, pycolmap, GDAL's own programs and QGIS's own formula make of the exports."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.exports.formats import export
from featreg.geometry import Affine
from featreg.io import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (90, 120)
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
MODEL = Affine(np.array([[0.99, 0.05, 3.25], [-0.05, 1.01, -2.5]]))
REFERENCE = np.random.default_rng(0).uniform(5, 80, (30, 2))


def result(folder: Path, secondary: Geolocation | None = None, off: Any = 0.0) -> Registration:
    write_geotiff(folder / "ref.tif", np.ones(SHAPE, np.float32), PLACE)
    write_geotiff(folder / "sec.tif", np.ones(SHAPE, np.float32), secondary)
    images: Any = {role: InputImage(str(folder / f"{role[:3]}.tif"), SHAPE) for role in ("reference", "secondary")}
    matches = Matches(REFERENCE, MODEL(REFERENCE) + off, np.ones(30))
    return Registration(matches, {}, np.ones(30, bool), MODEL, "ok", **images)


@pytest.mark.parametrize("place", [None, PLACE], ids=["no map", "own map"])
def test_qgis_residuals_are_those_of_its_own_formula(tmp_path: Path, place: Geolocation | None) -> None:
    off = np.random.default_rng(1).normal(0, 0.5, (30, 2))
    export(result(tmp_path, place, off), tmp_path / "t.points", to="qgis")
    rows = (tmp_path / "t.points").read_text().splitlines()[2:]
    found = np.array([[float(v) for v in row.split(",")] for row in rows])
    # QGIS holds pixels with y upwards, of an image with a geotransform as line numbers; then dX = x of its transform
    # minus x of the point and dY = -(y of its transform minus y of the point).
    sign = 1 if place is not None else -1
    source, by_model = ((xy + 0.5) * (1, sign) for xy in (MODEL(REFERENCE) + off, MODEL(REFERENCE)))
    np.testing.assert_allclose(found[:, 5], by_model[:, 0] - source[:, 0], rtol=1e-5)
    np.testing.assert_allclose(found[:, 6], -(by_model[:, 1] - source[:, 1]), rtol=1e-5)
    np.testing.assert_allclose(found[:, 7], np.hypot(*off.T), rtol=1e-5)


def test_pycolmap_reads_the_geometry(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    export(result(tmp_path), tmp_path / "t.db", to="colmap")
    with pycolmap.Database.open(str(tmp_path / "t.db")) as database:
        assert sorted(image.name for image in database.read_all_images()) == ["ref.tif", "sec.tif"]
        first, second = (np.asarray(database.read_keypoints(k))[:, :2] for k in (1, 2))
        pairs = np.asarray(database.read_matches(1, 2))
        geometry = database.read_two_view_geometry(1, 2)
    np.testing.assert_array_equal(pairs, np.column_stack([np.arange(30)] * 2))
    np.testing.assert_allclose(first - 0.5, REFERENCE, atol=1e-4)
    np.testing.assert_allclose(second - 0.5, MODEL(REFERENCE), atol=1e-4)
    mapped = np.column_stack([first, np.ones(30)]) @ np.asarray(geometry.H).T
    np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:] - 0.5, MODEL(REFERENCE), atol=0.01)


def test_colmap_itself_opens_the_database(tmp_path: Path) -> None:
    if shutil.which("colmap") is None:
        pytest.skip("COLMAP is not installed")
    export(result(tmp_path), tmp_path / "t.db", to="colmap")

    def run(*arguments: str) -> None:
        done = subprocess.run(["colmap", *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "SQL" not in done.stdout + done.stderr

    run("database_creator", "--database_path", str(tmp_path / "empty.db"))
    run("database_merger", "--database_path1", str(tmp_path / "t.db"), "--database_path2", str(tmp_path / "empty.db"),
        "--merged_database_path", str(tmp_path / "merged.db"))  # fmt: skip
    with sqlite3.connect(tmp_path / "merged.db") as database:
        assert database.execute("SELECT name FROM images ORDER BY image_id").fetchall() == [("ref.tif",), ("sec.tif",)]
        blob = database.execute("SELECT data FROM keypoints WHERE image_id = 1").fetchone()[0]
        matrix = database.execute("SELECT H FROM two_view_geometries").fetchone()[0]
    kept = np.frombuffer(blob, "<f4").reshape(30, -1)[:, :2]
    np.testing.assert_allclose(kept - 0.5, REFERENCE, atol=1e-4)
    mapped = np.column_stack([kept, np.ones(30)]) @ np.frombuffer(matrix, "<f8").reshape(3, 3).T
    np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:] - 0.5, MODEL(REFERENCE), atol=0.01)


@pytest.mark.parametrize("name", ["t.tif", "t.vrt"])
def test_gdaltransform_has_our_mapping(tmp_path: Path, name: str) -> None:
    if shutil.which("gdaltransform") is None:
        pytest.skip("GDAL's programs are not installed")
    away = Geolocation((10.0, 0.0, 502_000.0, 0.0, -10.0, 6e6), "EPSG:32632")
    export(result(tmp_path, away), tmp_path / name, to="gdal")
    inside = np.array([[10.0, 20.0], [70.5, 33.25], [40.0, 79.0]])
    ground = np.column_stack([5e5 + 10 * (inside[:, 0] + 0.5), 6e6 - 10 * (inside[:, 1] + 0.5)])
    lines = "\n".join(f"{x!r} {y!r}" for x, y in ground.tolist())
    done = subprocess.run(
        ["gdaltransform", "-i", "-order", "1", str(tmp_path / name)],
        input=lines, capture_output=True, text=True, check=True, cwd=tmp_path,
    )  # fmt: skip
    found = np.array([line.split()[:2] for line in done.stdout.splitlines()], float) - 0.5
    np.testing.assert_allclose(found, MODEL(inside), atol=0.01)
