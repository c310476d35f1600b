"""The page of a comparison as a file: whole, harmless, small, and the same for the same study."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.report import (
    ReportColumn,
    ReportEntry,
    ReportPair,
    ReportStudy,
    ReportSweep,
    ReportTable,
    write_report,
)
from featreg.report.content import content
from featreg.report.page import render
from featreg.types import Image
from made.reported import TRUTH, registration

EVIL = "</script><script>alert('pair')</script><!-- {{code}} &amp;"
Make = Any


@pytest.fixture
def images(sar_texture: Make) -> tuple[Image, Image]:
    return tuple(Image(t, np.ones(t.shape, np.bool_)) for t in (sar_texture(100, 120, k) for k in (0, 1)))  # type: ignore[return-value]


def study_of(images: tuple[Image, Image], names: tuple[str, ...] = ("bern", "ottawa"), count: int = 60) -> ReportStudy:
    pairs = [ReportPair(name, *images, TRUTH, "known model") for name in names]
    entries = []
    for name in names:
        entries += [
            ReportEntry(name, "good", 0, registration(count), scores={"ncm": 40}),
            ReportEntry(name, "lost", 0, registration(count, 1, status="unreliable", reason="9 points, 12 needed")),
            ReportEntry(name, "dead", 0, None, "timed out after 30 s"),
        ]
    columns = [ReportColumn("pair"), ReportColumn("method"), ReportColumn("status"), ReportColumn("ncm", "high")]
    rows = [{"pair": e.pair, "method": e.method, "status": e.status, "ncm": np.int64(7)} for e in entries]
    table = ReportTable(columns, rows, {"good": {"ncm": (40.0, 30.0, np.nan)}})
    return ReportStudy(
        "A study", pairs, entries, table, protocol={"filters": ["gms", "ransac"]}, machine={"cpu": "one"}
    )


class Page(HTMLParser):
    """The elements of a page with their attributes, and the text of its scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.elements:
            self.texts.setdefault(self.elements[-1][0], []).append(data)

    def attributes(self, tag: str) -> list[dict[str, str | None]]:
        return [found for name, found in self.elements if name == tag]


def test_the_page_needs_nothing_from_outside(images: tuple[Image, Image], tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", study_of(images))
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    for tag, attributes in page.elements:
        loads = {"src", "srcset", "style", "action", "data"} & set(attributes)
        assert not loads, f"<{tag}> has {loads}"
        assert not [name for name in attributes if name.startswith("on")]
        assert tag != "link"
        assert (attributes.get("href") or "#").startswith("#")
    assert set(re.findall(r"https?://[^\s\"'`)]+", text)) == {"http://www.w3.org/2000/svg"}
    assert list(tmp_path.iterdir()) == [tmp_path / "report.html"]


def test_the_policy_admits_this_code_and_style_only(images: tuple[Image, Image]) -> None:
    text = render(study_of(images))
    (policy,) = (m["content"] for m in Page(text).attributes("meta") if m.get("http-equiv"))
    assert policy is not None
    said = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    assert said["default-src"] == "'none'"
    assert said["img-src"] == "data:"
    for rule, pattern in (
        ("script-src", r'<script type="module">(.*?)</script>'),
        ("style-src", r"<style>(.*?)</style>"),
    ):
        (held,) = re.findall(pattern, text, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(held.encode()).digest()).decode()
        assert said[rule] == f"'sha256-{digest}'"


def test_names_are_text_whatever_they_hold(images: tuple[Image, Image]) -> None:
    plain = Page(render(study_of(images)))
    made = replace(study_of(images, (EVIL, "b")), title=EVIL, protocol={EVIL: EVIL}, machine={})
    made = replace(made, entries=[replace(e, method=EVIL) if e.method == "good" else e for e in made.entries])
    text = render(made)
    page = Page(text)
    assert [tag for tag, _ in page.elements] == [tag for tag, _ in plain.elements]
    (data,) = re.findall(r'id="study">(.*?)</script>', text, re.DOTALL)
    assert json.loads(data)["title"] == EVIL
    assert json.loads(data)["pairs"][0]["name"] == EVIL
    assert "".join(page.texts["h1"]).strip() == EVIL


def test_equal_studies_give_equal_bytes(images: tuple[Image, Image]) -> None:
    assert render(study_of(images)) == render(study_of(images))
    assert render(study_of(images)) != render(study_of(images, count=61))


@pytest.mark.parametrize(
    ("name", "message"), [("report.pdf", "ends in .html"), ("missing/report.html", "does not exist")]
)
def test_a_wrong_target_is_refused_before_any_work(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        write_report(tmp_path / name, ReportStudy("", [ReportPair("a", None, None)], []))


def test_an_empty_study_makes_a_page() -> None:
    assert "</html>" in render(ReportStudy("nothing", [], []))


def test_a_failed_writing_leaves_the_old_page(images: tuple[Image, Image], tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old")
    wrong = study_of(images)
    with pytest.raises(InputError, match="no stage 'fsc'"):
        write_report(path, replace(wrong, entries=[replace(wrong.entries[0], stage="fsc")]))
    assert path.read_text() == "old"


def test_an_image_that_cannot_be_read_is_told_on_the_page(images: tuple[Image, Image]) -> None:
    pairs = [ReportPair("gone", "nowhere.tif", images[1], TRUTH)]
    made, blobs = content(ReportStudy("", pairs, [ReportEntry("gone", "m", 0, registration())]))
    assert "nowhere.tif" in made["pairs"][0]["problem"]
    assert made["pairs"][0]["images"] is None
    assert set(blobs) == {"p0"}


def test_a_study_that_contradicts_itself_is_refused(images: tuple[Image, Image]) -> None:
    pair = ReportPair("a", *images)
    with pytest.raises(InputError, match="'a' stands twice"):
        ReportStudy("", [pair, pair], [])
    with pytest.raises(InputError, match="'b', which is none of its pairs"):
        ReportStudy("", [pair], [ReportEntry("b", "m", 0, None, "died")])
    with pytest.raises(InputError, match="either a registration or a failure"):
        ReportEntry("a", "m")
    with pytest.raises(InputError, match=r"shape \(60,\), got \(3,\)"):
        ReportEntry("a", "m", 0, registration(), correct=np.ones(3, np.bool_))
    with pytest.raises(InputError, match=r"shape \(2,\), got \(3,\)"):
        ReportSweep({"p": [1, 2]}, {"ncm": np.zeros(3)})
    with pytest.raises(ParameterError, match="at least one parameter"):
        ReportSweep({}, {})


def test_curves_are_the_mean_over_pairs_and_a_failure_counts_as_nothing(images: tuple[Image, Image]) -> None:
    made = study_of(images)
    exact = registration(30, stages={}, inliers=np.ones(30, np.bool_))
    moved = TRUTH(exact.matches.reference_xy) + np.array([2.5, 0])
    exact = replace(exact, matches=replace(exact.matches, secondary_xy=moved))
    entries = [ReportEntry("bern", "m", 0, exact), ReportEntry("ottawa", "m", 0, None, "died")]
    assert content(replace(made, entries=entries))[0]["curves"] == {"m": [0, 0, *[0.5] * 8]}
    assert content(replace(made, entries=entries, curves={"m": [1.0]}))[0]["curves"] == {"m": [1.0]}


@pytest.mark.slow
def test_twenty_pairs_by_four_methods_stay_below_15_mb(sar_texture: Make) -> None:
    textures = [sar_texture(560, 600, seed) for seed in (0, 1)]
    reference, secondary = (Image(t, np.ones(t.shape, np.bool_)) for t in textures)
    results = [registration(5000, seed, (600, 560)) for seed in range(4)]
    names = [f"pair {k}" for k in range(20)]
    entries = [ReportEntry(n, f"method {k}", 0, made) for n in names for k, made in enumerate(results)]
    study = ReportStudy("big", [ReportPair(n, reference, secondary, TRUTH) for n in names], entries)
    assert len(render(study).encode()) < 15e6
