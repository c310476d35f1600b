"""`featreg view`: the page of one result, with its images or without."""

from __future__ import annotations

import json
import re
import webbrowser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.cli.main import main
from featreg.errors import InputError
from featreg.io import write_geotiff
from featreg.report.from_registration import write_registration_report
from featreg.simulate import sar_pair

PAIR = sar_pair((160, 200), shift=(4.0, -3.0), seed=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("view")
    write_geotiff(made / "ref.tif", PAIR.reference)
    write_geotiff(made / "sec.tif", PAIR.secondary)
    featreg.match(made / "ref.tif", made / "sec.tif").to_json(made / "r.json")
    return made


def study_of(page: Path) -> Any:
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="study">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def test_the_page_shows_images_tie_points_gates_and_facts(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    assert main(["view", str(folder / "r.json"), "-o", str(folder / "r.html")]) == 0
    assert capsys.readouterr().out == f"written: {folder / 'r.html'}\n"
    assert opened == [(folder / "r.html").as_uri()]
    study = study_of(folder / "r.html")
    result = featreg.Registration.from_json(folder / "r.json")
    assert study["pairs"][0]["images"] is not None
    assert study["pairs"][0]["name"] == "ref.tif and sec.tif"
    entry = study["entries"][0]
    assert [gate["name"] for gate in entry["gates"]] == list(result.gates)
    assert entry["status"] == "ok"
    assert dict(study["protocol"])["model"] == ["Affine"]


def test_without_a_name_the_page_is_a_temporary_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(folder / "r.json"), "--no-browser"]) == 0
    page = Path(capsys.readouterr().out.removeprefix("written: ").strip())
    assert page.name == "r.html"
    assert study_of(page)["methods"] == ["sar-orb"]
    page.unlink()
    page.parent.rmdir()


def test_images_that_moved_are_named_and_arrays_are_not_kept(folder: Path, tmp_path: Path) -> None:
    result = featreg.match(PAIR.reference, PAIR.secondary)
    write_registration_report(tmp_path / "a.html", result)
    assert "--reference" in study_of(tmp_path / "a.html")["pairs"][0]["problem"]
    write_registration_report(tmp_path / "b.html", result, reference=folder / "ref.tif", secondary=PAIR.secondary)
    assert study_of(tmp_path / "b.html")["pairs"][0]["images"] is not None
    with pytest.raises(InputError, match="has the shape"):
        write_registration_report(tmp_path / "c.html", result, reference=PAIR.reference[:100])
    write_registration_report(tmp_path / "d.html", result, truth=PAIR.truth)
    assert study_of(tmp_path / "d.html")["pairs"][0]["truth"]


def test_an_untrusted_result_is_shown_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    noise = np.random.default_rng(0).gamma(1, 1, (160, 200)).astype(np.float32)
    featreg.match(PAIR.reference, noise).to_json(tmp_path / "r.json")
    assert main(["view", str(tmp_path / "r.json"), "-o", str(tmp_path / "r.html"), "--no-browser"]) == 3
    assert "warning: the registration is unreliable" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "r.json"), "-o", str(tmp_path / "r.json"), "--no-browser"]) == 2
