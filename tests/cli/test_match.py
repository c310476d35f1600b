"""`featreg match` of one pair: what it prints and writes, and what its options do."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from featreg.io import as_image
from featreg.results.registration import Registration
from featreg.types import Geolocation

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
SIDE = 256
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
TOP_KEYS = [
    "schema_version", "method", "status", "reason", "gates", "seed", "reference", "secondary", "model", "counts",
    "blocks", "timings", "provenance", "tie_points",
]  # fmt: skip

Run = Callable[..., tuple[int, str, str]]


def test_match_prints_a_summary_and_nothing_else(run: Run) -> None:
    code, out, err = run("match", "ref.tif", "sec.tif")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "ok"
    assert [line.split()[0] for line in lines[1:]] == ["method", "tried", "model", "tie", "residuals", "seconds"]
    found = re.search(r"rotation (\S+) deg .* scale (\S+), shift \((\S+), (\S+)\) px", out)
    assert found is not None
    np.testing.assert_allclose([float(v) for v in found.groups()], [4.0, 1.01, 5.0, -3.0], atol=0.1)
    assert re.search(r"\d+ final: \d+ putative, \d+ after gms, \d+ after fsc, \d+ after locate, \d+ after refine", out)


def test_match_writes_the_contracted_json_and_a_picture(run: Run, folder: Path, tmp_path: Path) -> None:
    target, picture = tmp_path / "out.json", tmp_path / "out.png"
    code, out, _ = run("match", "ref.tif", "sec.tif", "--json", str(target), "--plot", str(picture))
    assert code == 0
    assert f"{target}, {picture}" in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    data = json.loads(target.read_text(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert list(data) == TOP_KEYS
    image = data["reference"]
    assert list(image)[:3] == ["path", "width", "height"]
    assert (image["path"], image["width"], image["height"]) == ("ref.tif", SIDE, SIDE)
    assert (image["scale"], image["dtype"], image["valid_pixels"]) == ("amplitude", "float32", SIDE * SIDE)
    assert image["geolocation"]["transform"] == list(PLACE.transform or ())
    assert "inputs" not in data["provenance"]
    assert {"type", "matrix", "parameters", "rotation_deg", "scale"} <= set(data["model"])
    assert list(data["counts"]) == ["putative", "gms", "fsc", "locate", "refine", "inliers"]
    columns = data["tie_points"]["columns"]
    assert columns[:4] == ["reference_x", "reference_y", "secondary_x", "secondary_y"]
    assert all(len(row) == len(columns) for row in data["tie_points"]["rows"])
    assert sum(row[columns.index("inlier")] for row in data["tie_points"]["rows"]) == data["counts"]["inliers"]
    assert Registration.from_json(target).status == "ok"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.json", "out.png"]


def test_the_same_seed_gives_the_same_bytes(run: Run, tmp_path: Path) -> None:
    texts = []
    for name, extra in (("a.json", ()), ("b.json", ("--workers", "1"))):
        assert run("match", "ref.tif", "sec.tif", "--seed", "5", "--json", str(tmp_path / name), *extra)[0] == 0
        texts.append(re.sub(r'"timings": \{[^}]*\}', "", (tmp_path / name).read_text()))
    assert texts[0] == texts[1]
    assert '"seed": 5' in texts[0]


def test_options_reach_the_pipeline(run: Run, tmp_path: Path) -> None:
    target = tmp_path / "out.json"
    options = ["--method", "orb", "--model", "similarity", "--n-features", "700", "--no-refine", "--scale", "amplitude"]
    settings = ["--set", "detector.n_levels=6", "--set", "filters=gms,ransac", "--set", "ransac.threshold=2.5"]
    code, _, err = run("match", "ref.tif", "sec.tif", *options, *settings, "--json", str(target))
    assert (code, err) == (0, "")
    data = json.loads(target.read_text())
    assert data["model"]["type"] == "similarity"
    assert list(data["counts"]) == ["putative", "gms", "ransac", "inliers"]
    assert data["counts"]["putative"] <= 700
    parameters = data["provenance"]["parameters"]
    assert (parameters["detector"]["n_levels"], parameters["ransac"]["threshold"]) == (6, 2.5)


def test_a_choice_of_methods_says_what_it_tried(run: Run) -> None:
    code, out, _ = run("match", "ref.tif", "sec.tif")
    assert code == 0
    assert "  method      sar-orb, seed 0\n  tried       sar-orb ok\n" in out
    # A part belongs to one method.
    code, out, _ = run("match", "ref.tif", "sec.tif", "--set", "fsc.threshold=2")
    assert code == 0
    assert "tried" not in out


def test_masks_and_initial(run: Run, tmp_path: Path) -> None:
    target = tmp_path / "out.json"
    masks = ["--mask-reference", "mask.tif", "--mask-secondary", "mask.tif"]
    known = ["--initial", "result.json", "--search-radius", "4"]
    assert run("match", "ref.tif", "sec.tif", *masks, *known, "--json", str(target))[0] == 0
    data = json.loads(target.read_text())
    assert "initial" in data["counts"]
    rows = np.array([row[:4] for row in data["tie_points"]["rows"]])
    assert rows[:, [0, 2]].min() >= 59.5


def test_unrelated_images_give_code_3_and_all_files(run: Run, tmp_path: Path) -> None:
    target, picture = tmp_path / "out.json", tmp_path / "out.png"
    code, out, err = run("match", "ref.tif", "other.tif", "--json", str(target), "--plot", str(picture))
    assert (code, err) == (3, "")
    assert out.startswith("unreliable: ")
    assert json.loads(target.read_text())["status"] == "unreliable"
    assert picture.exists()


def test_warnings_of_the_library_are_lines_on_stderr(run: Run, tmp_path: Path) -> None:
    decibel = tmp_path / "db.npy"
    np.save(decibel, 20 * np.log10(np.maximum(as_image("ref.tif").pixels, 1e-3)))
    code, _, err = run("match", str(decibel), "sec.tif")
    assert code == 0
    assert err.startswith("warning: ")
    assert err.count("\n") == 1
    code, _, err = run("match", str(decibel), str(decibel), "--scale", "db")
    assert (code, err) == (0, "")


def test_json_on_standard_output_leaves_the_words_to_stderr(run: Run, tmp_path: Path) -> None:
    code, out, err = run("match", "ref.tif", "sec.tif", "--json", "-")
    assert code == 0
    data = json.loads(out)
    assert (list(data), data["status"]) == (TOP_KEYS, "ok")
    assert err.startswith("ok\n  method ")
    kept = tmp_path / "same.json"
    kept.write_text(out)
    assert len(Registration.from_json(kept).matches) == len(data["tie_points"]["rows"])
    code, out, err = run("match", "ref.tif", "other.tif", "--json", "-")
    assert (code, json.loads(out)["status"], err.startswith("unreliable: ")) == (3, "unreliable", True)


def test_the_file_beside_a_result_of_many_tie_points_is_announced(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("featreg.results.json_file.MAX_ROWS", 100)
    target = tmp_path / "out.json"
    code, out, _ = run("match", "ref.tif", "sec.tif", "-o", str(target))
    assert code == 0
    assert f"written     {target}, {tmp_path / 'out.tie_points.parquet'} (its tie points)\n" in out
    # A product needs the model only.
    (tmp_path / "out.tie_points.parquet").unlink()
    assert run("warp", str(target), "sec.tif", "-o", str(tmp_path / "aligned.tif"))[0] == 0
