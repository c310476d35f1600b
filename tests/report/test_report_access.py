"""The page of a comparison is for everybody: by keyboard, in both themes, on narrow screens, on paper."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.results.input_image import InputImage

Make = Callable[..., Any]
#: Opens the page.
Visits = Callable[..., Any]


def test_everything_is_reached_by_tab_and_has_a_name(visit: Visits) -> None:
    seen = visit()
    seen.viewer("Matches")
    page = seen.page
    page.evaluate("scrollTo(0, 0); document.activeElement.blur()")
    reached = set()
    for _ in range(120):
        page.keyboard.press("Tab")
        found = page.evaluate(
            "(() => { const e = document.activeElement; if (e === document.body) return ''; return e.tagName + ' ' + "
            "(e.getAttribute('aria-label') || e.labels?.[0]?.textContent || e.textContent || '').trim(); })()"
        )
        if not found:
            break
        assert found.split(" ", 1)[1], f"{found} has no name"
        reached.add(found.split(" ", 1)[1])
    for name in ("Skip to the content", "Theme: auto. Change it", "Next pair", "alpha", "Matches"):
        assert any(name in text for text in reached), f"{name} is not reached: {sorted(reached)}"
    assert any("tie points" in text for text in reached)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_both_themes_can_be_read(visit: Visits, scheme: str) -> None:
    page = visit(color_scheme=scheme).page
    button = page.get_by_role("button", name="Theme")

    def contrast() -> float:
        colours = page.evaluate(
            "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
        )
        light = []
        for text in colours:
            c = np.array([float(v) for v in re.findall(r"[\d.]+", text)[:3]]) / 255
            light.append(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])
        return float((light[0] + 0.05) / (light[1] + 0.05))

    dark = contrast() > 1
    assert dark == (scheme == "dark")
    for wanted in ("light", "dark", "auto"):
        button.click()
        assert wanted in button.inner_text()
        ratio = contrast()
        assert max(ratio, 1 / ratio) > 7
        assert (ratio > 1) == (dark if wanted == "auto" else wanted == "dark")


def test_a_narrow_window_scrolls_in_one_direction_only(visit: Visits) -> None:
    seen = visit()
    seen.page.set_viewport_size({"width": 390, "height": 800})
    seen.viewer("Matches")
    assert seen.page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("width", [1000, 1400, 1700])
def test_no_chart_is_cut_off(visit: Visits, width: int) -> None:
    page = visit().page
    page.set_viewport_size({"width": width, "height": 800})
    cut = "figures => figures.filter(f => f.scrollWidth > f.clientWidth + 1).map(f => f.textContent.slice(0, 30))"
    figures = page.locator("#charts figure")
    assert figures.count() >= 4
    assert figures.evaluate_all(cut) == []


def test_print_holds_every_pair_and_whole_tables(visit: Visits, tmp_path: Path) -> None:
    seen = visit()
    page = seen.page
    seen.viewer("Swipe")
    # A canvas that the browser cannot read out is said, and leaves the viewer and the button as they were.
    page.evaluate(
        "() => { const kind = HTMLCanvasElement.prototype, own = kind.toDataURL;"
        " kind.toDataURL = () => { kind.toDataURL = own; throw new Error('no memory'); }; }"
    )
    page.get_by_role("button", name="Print every pair").click()
    page.get_by_text("The pictures could not be taken: no memory").wait_for(timeout=60_000)
    assert page.get_by_role("button", name="Print every pair").is_enabled()
    assert page.get_by_role("radio", name="Swipe").is_checked()
    page.evaluate("void (window.print = () => { document.body.dataset.asked = 'yes'; })")
    page.get_by_role("button", name="Print every pair").click()
    page.wait_for_selector("body[data-asked]", timeout=60_000)
    figures = page.locator(".printed figure")
    assert figures.count() == 9
    assert "failed" in figures.nth(5).inner_text() or "died of signal 11" in page.locator(".printed").inner_html()
    # The viewer is where it was.
    assert page.get_by_role("radio", name="Swipe").is_checked()
    page.emulate_media(media="print")
    assert page.locator(".printed").is_visible()
    assert not page.locator(".viewer").is_visible()
    wide = page.evaluate(
        "[...document.querySelectorAll('.scroll')].filter((s) => getComputedStyle(s).overflowX !== 'visible').length"
    )
    assert wide == 0
    page.pdf(path=str(tmp_path / "page.pdf"))
    assert (tmp_path / "page.pdf").stat().st_size > 50_000


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_the_page_has_no_violation_that_axe_knows(
    visit: Visits, accessible: Callable[[Any], None], scheme: str, width: int
) -> None:
    seen = visit(color_scheme=scheme)
    seen.page.set_viewport_size({"width": width, "height": 900})
    for mode in ("Matches", "Residuals"):
        seen.viewer(mode)
        accessible(seen.page)


def test_the_page_of_one_result_has_no_violation_that_axe_knows(
    registration: Make, visit: Visits, accessible: Callable[[Any], None], sar_texture: Make, tmp_path: Path
) -> None:
    from featreg.report.from_registration import write_registration_report

    for name, seed in (("a", 1), ("b", 2)):
        np.save(tmp_path / f"{name}.npy", sar_texture(100, 120, seed))
    images: Any = {
        role: InputImage(str(tmp_path / f"{name}.npy"), (100, 120))
        for role, name in (("reference", "a"), ("secondary", "b"))
    }
    write_registration_report(tmp_path / "view.html", registration(60, 3, **images))
    seen = visit(path=tmp_path / "view.html")
    seen.viewer("Swipe")
    accessible(seen.page)
