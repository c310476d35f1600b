"""The page of a comparison as a file: whole, harmless, small, and the same for the same study."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine, Homography
from featreg.interfaces import FailedFit
from featreg.report import (
    ReportColumn,
    ReportEntry,
    ReportPair,
    ReportStudy,
    ReportSweep,
    ReportTable,
    write_report,
)
from featreg.report import pictures as report_pictures
from featreg.report.content import content
from featreg.report.page import render
from featreg.report.pictures import picture
from featreg.report.tie_points import INLIER, JUDGED, SCORED, lattice, tie_points
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import FloatArray, Image, Matches

TRUTH = Affine(np.array([[1.0, -0.03, 5.0], [0.04, 1.01, -3.0]]))
EVIL = "</script><script>alert('pair')</script><!-- {{code}} &amp;"
Make = Any


def registration(count: int = 60, seed: int = 0, size: tuple[int, int] = (120, 100), **change: Any) -> Registration:
    """Every third match is false; the filter "gms" drops every second of those, "ransac" all of them."""
    rng = np.random.default_rng(seed)
    reference = rng.uniform(0, np.array(size) - 1, (count, 2))
    secondary = TRUTH(reference) + rng.normal(0, 0.2, (count, 2))
    row = np.arange(count)
    false = row % 3 == 2
    secondary[false] += 30
    stages = {"gms": ~(row % 6 == 5), "ransac": ~false}
    matches = Matches(reference, secondary, rng.random(count))
    image = InputImage("array", size[::-1])
    made = Registration(matches, stages, ~false, TRUTH, "ok", timings={"detect": 0.1, "match": 0.2}, reference=image)
    return replace(made, **change)


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


KINDS = (("rx", "<u2"), ("ry", "<u2"), ("sx", "<u2"), ("sy", "<u2"), ("dx", "<f2"), ("dy", "<f2"), ("error", "<f2"),
         ("score", "<f4"), ("lost", "u1"), ("flags", "u1"))  # fmt: skip


def unpacked(points: Any) -> dict[str, NDArray[Any]]:
    raw, at = zlib.decompress(base64.b64decode(points.packed)), 0
    found: dict[str, NDArray[Any]] = {}
    for name, kind in KINDS:
        dtype = np.dtype(kind)
        planes = np.frombuffer(raw, np.uint8, points.shown * dtype.itemsize, at).reshape(dtype.itemsize, -1)
        found[name] = np.ascontiguousarray(planes.T).view(dtype).ravel()
        at += planes.size
    assert at == len(raw)
    found["ry"] = np.cumsum(found["ry"], dtype=np.uint16)
    for k, side in enumerate("rs"):
        for axis, letter in enumerate("xy"):
            found[side + letter] = points.origins[k][axis] + points.steps[k] * found[side + letter].astype(float)
    return found


@pytest.mark.parametrize("size", [(120, 100), (30_000, 20_000)])
def test_tie_points_come_back_as_they_were(size: tuple[int, int]) -> None:
    made = registration(400, size=size)
    errors = made.model.residuals(made.matches.reference_xy, made.matches.secondary_xy) if made.model else np.zeros(0)
    errors[:10] = np.nan
    points = tie_points(ReportEntry("a", "m", 0, made), errors, 1.5, 5000)
    got = unpacked(points)
    order = np.argsort(made.matches.reference_xy[:, 1], kind="stable")
    for side, wanted, step in zip(
        "rs", (made.matches.reference_xy, made.matches.secondary_xy), points.steps, strict=True
    ):
        assert step <= max(1 / 64, max(size) * 1.2 / 65535)
        read = np.stack([got[side + "x"], got[side + "y"]], axis=1)
        np.testing.assert_allclose(read, wanted[order], atol=0.51 * step)
    np.testing.assert_allclose(got["error"], errors[order], rtol=3e-3)
    np.testing.assert_allclose(got["score"], made.matches.score[order], rtol=1e-3)
    lost = np.where(~made.stages["gms"], 1, np.where(~made.stages["ransac"], 2, 0))
    np.testing.assert_array_equal(got["lost"], lost[order])
    known = np.isfinite(errors)
    assert points.counts == {
        "scored": int((made.stages["gms"] & known).sum()),
        "correct": int((made.stages["gms"] & known & (errors <= 1.5)).sum()),
        "final": int(made.inliers.sum()),
    }
    np.testing.assert_array_equal(got["flags"] & JUDGED > 0, known[order])


def test_of_too_many_tie_points_the_scored_ones_stay() -> None:
    made = registration(300)
    made = replace(made, inliers=~made.stages["gms"])
    scored = int(made.stages["gms"].sum())
    points = tie_points(ReportEntry("a", "m", 0, made), None, 1.5, scored + 20)
    flags = unpacked(points)["flags"]
    assert (points.shown, points.total) == (scored + 20, 300)
    assert int((flags & SCORED > 0).sum()) == points.counts["scored"] == scored
    assert int((flags & INLIER > 0).sum()) == 20


def test_results_without_points_or_model_are_packed_too() -> None:
    empty = Registration(
        Matches.empty(), {"gms": np.zeros(0, np.bool_)}, np.zeros(0, np.bool_), FailedFit("none"), "ok"
    )
    assert tie_points(ReportEntry("a", "m", 0, empty), np.zeros(0), 1.5, 10).counts["scored"] == 0
    made = registration(5, model=FailedFit("too few"))
    assert np.isnan(unpacked(tie_points(ReportEntry("a", "m", 0, made), None, 1.5, 10))["dx"]).all()


def between(nodes: tuple[int, int, list[float | None]], size: tuple[int, int], xy: FloatArray) -> FloatArray:
    """Bilinear interpolation as the page does it."""
    columns, rows, values = nodes
    table = np.array([np.nan if v is None else v for v in values]).reshape(rows, columns, 2)
    uv = xy / (np.array(size) - 1) * (columns - 1, rows - 1)
    k = np.minimum(uv.astype(int), (columns - 2, rows - 2))
    a, b = (uv - k).T[:, :, None]
    i, j = k.T
    return np.asarray(
        (1 - b) * ((1 - a) * table[j, i] + a * table[j, i + 1])
        + b * ((1 - a) * table[j + 1, i] + a * table[j + 1, i + 1])
    )


def test_a_map_is_kept_as_a_lattice() -> None:
    size = (640, 480)
    xy = np.random.default_rng(0).uniform(0, np.array(size) - 1, (200, 2))
    np.testing.assert_allclose(between(lattice(TRUTH, size, affine=True), size, xy), TRUTH(xy), atol=1e-3)
    bent = Homography(np.array([[1.01, 0.02, 3], [-0.01, 0.99, -2], [1e-5, -2e-5, 1]]))
    np.testing.assert_allclose(between(lattice(bent, size, affine=False), size, xy), bent(xy), atol=0.02)
    half_known = lattice(lambda p: np.where(p[:, :1] < 300, p, np.nan), size, affine=False)
    assert any(v is None for v in half_known[2])
    assert json.dumps(half_known, allow_nan=False)


def test_curves_are_the_mean_over_pairs_and_a_failure_counts_as_nothing(images: tuple[Image, Image]) -> None:
    made = study_of(images)
    exact = registration(30, stages={}, inliers=np.ones(30, np.bool_))
    moved = TRUTH(exact.matches.reference_xy) + np.array([2.5, 0])
    exact = replace(exact, matches=replace(exact.matches, secondary_xy=moved))
    entries = [ReportEntry("bern", "m", 0, exact), ReportEntry("ottawa", "m", 0, None, "died")]
    assert content(replace(made, entries=entries))[0]["curves"] == {"m": [0, 0, *[0.5] * 8]}
    assert content(replace(made, entries=entries, curves={"m": [1.0]}))[0]["curves"] == {"m": [1.0]}


def test_a_picture_is_reduced_until_it_fits(sar_texture: Make) -> None:
    texture = sar_texture(700, 900, 0)
    image = Image(texture, np.ones(texture.shape, np.bool_))
    whole, small = picture(image, 10**9), picture(image, 20_000)
    assert whole.size == small.size == (900, 700)
    assert len(small.webp) <= 20_000 < len(whole.webp)


def test_a_large_scene_is_read_by_overview(sar_texture: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "scene.npy", sar_texture(601, 803, 0))
    monkeypatch.setattr(report_pictures, "LARGE", 1000)
    made = picture(str(tmp_path / "scene.npy"), 10**6)
    assert made.size == (803, 601)
    assert made.extent == (802, 600)


@pytest.mark.slow
def test_twenty_pairs_by_four_methods_stay_below_15_mb(sar_texture: Make) -> None:
    textures = [sar_texture(560, 600, seed) for seed in (0, 1)]
    reference, secondary = (Image(t, np.ones(t.shape, np.bool_)) for t in textures)
    results = [registration(5000, seed, (600, 560)) for seed in range(4)]
    names = [f"pair {k}" for k in range(20)]
    entries = [ReportEntry(n, f"method {k}", 0, made) for n in names for k, made in enumerate(results)]
    study = ReportStudy("big", [ReportPair(n, reference, secondary, TRUTH) for n in names], entries)
    assert len(render(study).encode()) < 15e6
