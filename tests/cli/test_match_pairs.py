"""`featreg match` of a list of pairs: a result and a row each, what is finished stays, what is wrong costs one row."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from featreg.cli.match_pairs import COLUMNS
from featreg.errors import InputError
from featreg.results.registration import Registration
from featreg.study.image_pairs import pairs_in
from featreg.study.pair_list import read_pair_list

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
Run = Callable[..., tuple[int, str, str]]
Refused = Callable[..., None]


def rows_of(summary: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(summary.read_text().splitlines()))


def test_a_list_gives_a_result_and_a_row_for_each_pair(run: Run, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "pairs.csv").write_text(
        f"reference,secondary,output\n{folder}/ref.tif,{folder}/sec.tif,sub/first.json\n"
        f"{folder}/ref.tif,{folder}/other.tif,\nnone.tif,{folder}/sec.tif,\n"
    )
    code, out, err = run("match", str(tmp_path / "pairs.csv"), "-o", str(tmp_path / "out"), "--method", "sar-orb")
    assert (code, err) == (4, "")
    lines = out.splitlines()
    assert [line.split(": ")[0] for line in lines[:3]] == ["[1/3] ref_sec", "[2/3] ref_other", "[3/3] none_sec"]
    assert lines[3].startswith("1 ok, 1 unreliable, 1 failed; written: ")
    first, second, third = rows_of(tmp_path / "out" / "pairs.summary.csv")
    assert [row["status"] for row in (first, second, third)] == ["ok", "unreliable", "failed"]
    known = {"rotation_deg": 4.0, "scale": 1.01, "dx": 5.0, "dy": -3.0}
    assert all(abs(float(first[name]) - value) < 0.1 for name, value in known.items())
    assert third["reason"].startswith(f"{tmp_path}/none.tif: no such file")
    result = Registration.from_json(tmp_path / "out" / "sub" / "first.json")
    assert int(first["inliers"]) == int(result.inliers.sum())
    assert Registration.from_json(tmp_path / "out" / "ref_other.json").status == "unreliable"
    assert not (tmp_path / "out" / "none_sec.json").exists()


def test_what_is_finished_and_unchanged_is_not_matched_again(
    run: Run, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ref", "sec"):
        shutil.copy(folder / f"{name}.tif", tmp_path / f"a_{name}.tif")
    shutil.copy(folder / "ref.tif", tmp_path / "b_ref.tif")
    (tmp_path / "b_sec.tif").write_bytes(b"")
    command = ["match", str(tmp_path), "--method", "orb", "--no-refine"]
    code, out, _ = run(*command)
    assert (code, out.splitlines()[0].startswith("[1/2] a: ok, rotation +")) == (4, True)
    assert "[2/2] b: failed: " in out
    made = (tmp_path / "a.result.json").read_bytes()

    import featreg.matching

    matched: list[Any] = []
    real = featreg.matching.match

    def counted(reference: Any, secondary: Any, **options: Any) -> Any:
        matched.append(Path(reference).name)
        return real(reference, secondary, **options)

    monkeypatch.setattr(featreg.matching, "match", counted)
    shutil.copy(folder / "sec.tif", tmp_path / "b_sec.tif")
    code, out, _ = run(*command)
    assert (code, matched) == (0, ["b_ref.tif"])
    assert "2 ok, 0 unreliable, 0 failed (1 from before)" in out
    assert (tmp_path / "a.result.json").read_bytes() == made
    # Another option, another image, or a result that is gone.
    for change, again in (
        (lambda: command.append("--seed=1"), ["a_ref.tif", "b_ref.tif"]),
        (lambda: shutil.copy(folder / "ref.tif", tmp_path / "a_sec.tif"), ["a_ref.tif"]),
        (lambda: (tmp_path / "b.result.json").unlink(), ["b_ref.tif"]),
    ):
        matched.clear()
        change()
        run(*command)
        assert matched == again


def test_a_radius_around_the_initial_of_each_pair(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import featreg.matching

    assert run("match", f"{folder}/ref.tif", f"{folder}/sec.tif", "-o", str(tmp_path / "x.json"))[0] == 0
    (tmp_path / "p.csv").write_text(f"reference,secondary,initial\n{folder}/ref.tif,{folder}/sec.tif,x.json\n")
    radii: list[Any] = []
    real = featreg.matching.match

    def told(*images: Any, **options: Any) -> Any:
        radii.append(options["search_radius"])
        return real(*images, **options)

    monkeypatch.setattr(featreg.matching, "match", told)
    for options in ([], ["--search-radius", "9"]):
        assert run("match", str(tmp_path / "p.csv"), *options)[0] == 0
    assert radii == [20.0, 9.0]


def test_a_fault_in_one_pair_is_its_row(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import featreg.matching

    def fail(*_: Any, **__: Any) -> Any:
        raise RuntimeError("out of luck")

    (tmp_path / "pairs.csv").write_text(f"{folder}/ref.tif;{folder}/sec.tif\n# a remark\n")
    monkeypatch.setattr(featreg.matching, "match", fail)
    code, out, err = run("match", str(tmp_path / "pairs.csv"))
    assert (code, err) == (4, "")
    assert "[1/1] ref_sec: failed: internal error: RuntimeError: out of luck" in out


def test_pictures_of_a_list(run: Run, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(f"reference,secondary,name\n{folder}/ref.tif,{folder}/sec.tif,port 1\n")
    options = ["-o", str(tmp_path), "--plot", str(tmp_path / "pictures"), "--method", "orb"]
    assert run("match", str(tmp_path / "p.csv"), *options)[0] == 0
    assert (tmp_path / "pictures" / "port-1.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "port-1.json").is_file()


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("", [], ["lists no pair"]),
        ("reference,secndary\na.tif,b.tif\n", [], ["no column 'secondary'", "did you mean 'secndary'"]),
        ("a.tif\n", [], ["pair 1 has no secondary"]),
        ("a.tif,b.tif,x.json\nc.tif,d.tif,x.json\n", [], ["'x.json' to two pairs"]),
        ("a.tif,b.tif\n", ["--json", "-"], ["for one pair"]),
        ("a.tif,b.tif\n", ["-o", "ref.tif"], ["'ref.tif' is a file", "a folder is needed"]),
        ("a.tif,b.tif\n", ["--set", "fsc.treshold=2"], ["'fsc.treshold'", "'fsc.threshold'"]),
        ("a.tif,b.tif,pairs.summary.csv\n", [], ["is written already"]),
        ("secondary,reference,initial\na,b,x.json\na,b,\n", ["--search-radius", "9"], ["needs --initial RESULT.json"]),
        ("a.tif,b.tif,pairs.csv\n", [], ["pairs.csv' of pair a_b would replace an input"]),
        (
            "reference,secondary,mask_reference,output\na.tif,b.tif,m.png,m.png\n",
            [],
            ["m.png' of pair a_b would replace"],
        ),
        (
            "reference,secondary,name\na.png,b.tif,a\n",
            ["--plot", "HERE"],
            ["picture", "a.png' of pair a would replace"],
        ),
        ("reference,secondary\nport, old/a.tif,b.tif\n", [], ["pair 1 has 3 cells for 2 columns"]),
        ("name,master,slave\nport,a.tif,b.tif\n", [], ["'name, master, slave', names neither", "reference, secondary"]),
    ],
)
def test_a_list_that_cannot_be_used_is_one_line(
    run: Run, refused: Refused, tmp_path: Path, text: str, options: list[str], words: list[str]
) -> None:
    (tmp_path / "pairs.csv").write_text(text)
    options = [str(tmp_path) if option == "HERE" else option for option in options]
    refused(run("match", str(tmp_path / "pairs.csv"), *options), *words)
    assert [path.name for path in tmp_path.iterdir()] == ["pairs.csv"]


def test_results_beside_images_are_no_truths(tmp_path: Path) -> None:
    for name in ("a_1.tif", "a_2.tif", "a-1.tif", "a-2.tif", "b_1.tif", "b_2.tif", "b.json"):
        (tmp_path / name).touch()
    pairs = read_pair_list(tmp_path)
    assert [pair.name for pair in pairs] == ["1-a", "2-a", "b"]
    for pair in pairs:
        (tmp_path / pair.output).touch()
    assert [Path(pair["truth"]).name for pair in pairs_in(tmp_path) if "truth" in pair] == ["b.json"]


def test_an_image_goes_with_one_of_its_own_kind(tmp_path: Path) -> None:
    for name in ("a_1.tif", "a_1.png", "a_2.TIF", "a_2.png", "b_1.png", "b_2.tif"):
        (tmp_path / name).touch()
    found = [(Path(pair["reference"]).name, Path(pair["secondary"]).name) for pair in pairs_in(tmp_path)]
    assert found == [("a_1.png", "a_2.png"), ("a_1.tif", "a_2.TIF"), ("b_1.png", "b_2.tif")]


def test_rows_of_pairs_that_left_the_list_leave_the_summary(run: Run, tmp_path: Path) -> None:
    summary = tmp_path / "pairs.summary.csv"
    (tmp_path / "pairs.csv").write_text("a.tif,b.tif\n")
    row = dict.fromkeys(COLUMNS, "") | {"name": "gone", "status": "ok", "key": "0"}
    summary.write_text(",".join(COLUMNS) + "\n" + ",".join(row.values()) + "\n")
    assert run("match", str(tmp_path / "pairs.csv"))[0] == 4
    assert [row["name"] for row in rows_of(summary)] == ["a_b"]


def test_a_missing_folder_is_no_missing_second_image(run: Run, refused: Refused, tmp_path: Path) -> None:
    refused(run("match", str(tmp_path / "nowhere")), "nowhere: no such file or folder")


def test_names_with_commas_stand_in_quotes_also_after_a_space(tmp_path: Path) -> None:
    (tmp_path / "l.csv").write_bytes('\ufeffReference, SECONDARY ,\r\na.tif, "b, ü.tif",\r\n\r\n# c\r\n'.encode())
    (pair,) = read_pair_list(tmp_path / "l.csv")
    assert (pair.reference, pair.secondary) == (f"{tmp_path}/a.tif", f"{tmp_path}/b, ü.tif")


def test_a_first_line_of_words_is_a_pair_where_the_words_can_be_images(tmp_path: Path) -> None:
    (tmp_path / "l.csv").write_text("before,after\na.tif,b.tif\n")
    with pytest.raises(InputError, match="'before, after', names neither images nor columns"):
        read_pair_list(tmp_path / "l.csv")
    for text in ("before,after\nmarch,may\n", "before,after\n"):  # folders of products, whether they are there or not
        (tmp_path / "l.csv").write_text(text)
        assert read_pair_list(tmp_path / "l.csv")[0].reference == f"{tmp_path}/before"
    (tmp_path / "before").mkdir()
    (tmp_path / "l.csv").write_text("before,after\na.tif,b.tif\n")
    assert len(read_pair_list(tmp_path / "l.csv")) == 2


def test_paths_count_from_the_list_and_names_differ(tmp_path: Path) -> None:
    (tmp_path / "l.csv").write_text(
        "secondary,reference,mask_reference,date\nb.tif,./a.tif,m.png,2024\n/x/b.tif,a.tif,,\nf.h5:/d,a.tif,,\n"
    )
    (tmp_path / "f.h5").touch()
    pairs = read_pair_list(tmp_path / "l.csv")
    assert [pair.name for pair in pairs] == ["1-a_b", "2-a_b", "a_f"]
    assert pairs[0].reference == f"{tmp_path}/a.tif"
    assert pairs[0].mask_reference == f"{tmp_path}/m.png"
    assert (pairs[1].secondary, pairs[2].secondary) == ("/x/b.tif", f"{tmp_path}/f.h5:/d")
    (tmp_path / "l.csv").write_bytes(b"\xff\xfea,b\n")
    with pytest.raises(InputError, match="no text in UTF-8"):
        read_pair_list(tmp_path / "l.csv")
