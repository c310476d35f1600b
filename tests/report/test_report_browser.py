"""The page of a comparison in a real browser: quiet, usable by mouse and keyboard, and right in what it says."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from featreg.report import write_report

Make = Callable[..., Any]
#: Opens the page.
Visits = Callable[..., Any]


def test_every_view_of_every_result_is_quiet_and_shows_something(visit: Visits) -> None:
    seen = visit()
    pictures = set()
    modes = ("Matches", "Swipe", "Flicker", "Checkerboard", "Overlay", "Residuals")
    for mode in modes:
        seen.viewer(mode)
        if mode == "Flicker":
            seen.page.get_by_role("button", name="Stop").click()
        pictures.add(seen.picture())
    assert len(pictures) == len(modes)
    for pair in range(3):
        for method in range(3):
            seen.page.get_by_role("combobox", name="Pair", exact=True).select_option(str(pair))
            seen.page.get_by_role("radio", name=["alpha", "beta", "gamma"][method]).check()
            seen.page.wait_for_selector(f"[data-ready^='{pair}/{method}/']")


def test_names_do_no_harm(evil: str, visit: Visits) -> None:
    page = visit().page
    assert page.title() == "Three methods"
    assert page.locator("img").count() == 0
    assert page.get_by_role("link", name=evil).first.is_visible()


def test_the_table_sorts_by_mouse_and_keyboard_and_says_so(visit: Visits) -> None:
    page = visit().page
    table = page.get_by_role("table", name="Every run")
    head = table.get_by_role("columnheader", name="rmse")
    column = table.locator("tbody tr td:nth-child(5)")

    def numbers() -> list[float]:
        return [
            float(found[0]) if (found := re.findall(r"[\d.]+", text)) else np.nan for text in column.all_inner_texts()
        ]

    assert head.get_attribute("aria-sort") == "none"
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "ascending"
    up = numbers()
    assert up[:-1] == sorted(up[:-1])
    assert np.isnan(up[-1])
    head.get_by_role("button").press("Enter")
    assert head.get_attribute("aria-sort") == "descending"
    down = numbers()
    assert down[:-1] == sorted(down[:-1], reverse=True)
    assert np.isnan(down[-1])
    other = table.get_by_role("columnheader", name="ncm")
    other.get_by_role("button").press("Space")
    assert (head.get_attribute("aria-sort"), other.get_attribute("aria-sort")) == ("none", "descending")


def test_the_best_of_a_pair_is_marked_for_eyes_and_ears(visit: Visits) -> None:
    table = visit().page.get_by_role("table", name="Every run")
    best = table.locator("td.best").all_inner_texts()
    assert all("★" in text and "best" in text for text in best)
    # The failed and the missing one win nothing: of the second pair the unreliable one has the least error.
    second = table.locator("tbody tr").nth(4).locator("td")
    assert "★" in second.nth(4).inner_text()
    assert "★" not in second.nth(5).inner_text()


def test_intervals_differences_failures_and_protocol_are_told(visit: Visits) -> None:
    page = visit().page
    assert "22.0 [12, 31]" in page.get_by_role("table", name="Mean of each method").inner_text()
    page.get_by_text("Paired differences from alpha").click()
    told = page.get_by_role("table", name="Mean difference from alpha").inner_text()
    assert "+1 [0.5, 1.5] *" in told
    assert "+2 [-1, 5] *" not in told
    failures = page.get_by_role("region", name="Failures and refusals").inner_text()
    assert "died of signal 11" in failures
    assert "9 points, 12 needed" in failures
    assert "gms, ransac" in page.locator("#protocol").inner_text()


def test_a_run_opens_from_the_table_and_has_an_address(visit: Visits) -> None:
    page = visit().page
    page.get_by_role("table", name="Every run").get_by_role("link", name="pair 2").nth(1).click()
    page.wait_for_selector("[data-ready^='2/1/']")
    assert "pair=2&method=1" in page.url
    assert page.evaluate("document.activeElement.className") == "stage"


def test_a_sweep_shows_its_best_cell(visit: Visits) -> None:
    page = visit().page
    chart = page.get_by_role("img", name="ncm over bits and threshold")
    assert chart.locator(".incell").all_text_contents() == ["0", "1", "2", "3", "4", "5 ★"]


@pytest.mark.slow
def test_twenty_pairs_of_five_thousand_matches_open(
    study_of: Make, visit: Visits, sar_texture: Make, tmp_path: Path
) -> None:
    path = tmp_path / "large.html"
    write_report(path, study_of(sar_texture, pairs=20, count=5000))
    seen = visit(path=path)
    canvas = seen.viewer("Matches")
    assert "5000 tie points" in canvas.get_attribute("aria-label")
    seen.page.get_by_label("Previous pair").click()
    seen.page.wait_for_selector("[data-ready^='19/0/']")
    canvas.focus()
    canvas.press("ArrowRight")
    assert "px from the truth" in seen.page.locator("output.point").inner_text()


def test_tables_and_charts_can_be_taken_along(study_of: Make, visit: Visits, sar_texture: Make, tmp_path: Path) -> None:
    from xml.etree import ElementTree

    study = study_of(sar_texture)
    texts = {"table.csv": "pair,ncm\na,1\n", "table.tex": "\\begin{table}</script>\\end{table}\n"}
    write_report(tmp_path / "r.html", replace(study, table=replace(study.table, texts=texts)))
    page = visit(path=tmp_path / "r.html").page
    for label, name in (("CSV", "table.csv"), ("LaTeX", "table.tex")):
        with page.expect_download() as caught:
            page.get_by_role("link", name=label, exact=True).click()
        assert caught.value.suggested_filename == name
        assert caught.value.path().read_text(encoding="utf-8") == texts[name]
    links = page.get_by_role("link", name="Save as SVG")
    assert links.count() >= 3
    for k in range(links.count()):
        with page.expect_download() as caught:
            links.nth(k).click()
        assert caught.value.suggested_filename.endswith(".svg")
        root = ElementTree.parse(caught.value.path()).getroot()
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert len(list(root.iter())) > 10
        # Outside the page nothing refers to its style any more.
        assert not any("class" in part.attrib for part in root.iter())
        assert "var(" not in caught.value.path().read_text(encoding="utf-8")


def test_charts_and_views_are_saved_as_png(visit: Visits) -> None:
    seen = visit()
    page = seen.page
    seen.viewer("Overlay")
    for link in (
        page.get_by_role("link", name="as PNG", exact=True).first,
        page.get_by_role("link", name="view as PNG"),
    ):
        with page.expect_download() as caught:
            link.click()
        assert caught.value.suggested_filename.endswith(".png")
        picture = cv2.imread(str(caught.value.path()))
        assert picture is not None
        assert min(picture.shape[:2]) > 150
        assert picture.std() > 5


def test_a_sweep_begins_with_its_map_and_tells_its_combinations_apart(
    study_of: Make, visit: Visits, sar_texture: Make, tmp_path: Path
) -> None:
    study = study_of(sar_texture)
    names = {m: f"sar-orb fsc.threshold={k} gms.thresholding=20" for k, m in enumerate(("alpha", "beta", "gamma"))}
    table = study.table
    renamed = replace(
        study,
        entries=[replace(entry, method=names[entry.method]) for entry in study.entries],
        table=replace(
            table,
            rows=[{**row, "method": names[row["method"]]} for row in table.rows],
            intervals={names[m]: means for m, means in table.intervals.items()},
            differences={},
            baseline="",
        ),
    )
    write_report(tmp_path / "sweep.html", renamed)
    page = visit(path=tmp_path / "sweep.html").page
    assert page.locator("#charts h3").first.inner_text().startswith("Sweep")
    assert "best ncm: 5 at" in page.locator("#charts figure").first.inner_text()
    labels = page.locator("#charts .label").evaluate_all("all => all.map((one) => one.firstChild.textContent)")
    assert {"fsc.threshold=0", "fsc.threshold=1", "fsc.threshold=2"} <= set(labels)
