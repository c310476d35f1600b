"""The images of a pair on the page, in a real browser: tie points, swipe, flicker, zoom."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from featreg.geometry import Affine
from featreg.report import ReportEntry, ReportPair, ReportStudy, write_report
from featreg.types import Image

Make = Callable[..., Any]
#: Opens the page.
Visits = Callable[..., Any]


def test_a_tie_point_is_read_by_mouse(visit: Visits) -> None:
    seen = visit()
    canvas = seen.viewer("Matches")
    box = canvas.bounding_box()
    half = (box["width"] - 8) / 2
    zoom = min(half / 120, box["height"] / 100)
    x, y = half / 2 + (4 - 59.5) * zoom, box["height"] / 2 + (4 - 49.5) * zoom
    seen.page.mouse.move(box["x"] + x, box["y"] + y)
    tip = seen.page.locator(".tip")
    assert tip.is_visible()
    text = tip.inner_text()
    assert "correct (0.50 px from the truth)" in text
    assert "4.00, 4.00" in text
    assert "0.50 px from the model" in text
    assert "0.75" in text
    assert "final tie point" in text
    seen.page.mouse.move(5, 5)
    assert tip.is_hidden()


def test_tie_points_are_read_by_keyboard(visit: Visits) -> None:
    seen = visit()
    canvas = seen.viewer("Matches")
    details = seen.page.locator("output.point")
    told = []
    canvas.focus()
    for _ in range(3):
        canvas.press("ArrowRight")
        told.append(details.inner_text())
    assert len(set(told)) == 3
    canvas.press("ArrowLeft")
    assert details.inner_text() == told[1]
    before = seen.picture()
    canvas.press("+")
    zoomed = seen.picture()
    canvas.press("0")
    assert zoomed != before
    assert seen.picture() == before


def test_kinds_and_sets_of_points_can_be_chosen(visit: Visits) -> None:
    seen = visit()
    canvas = seen.viewer("Matches")
    assert "80 tie points" in canvas.get_attribute("aria-label")
    seen.page.get_by_label("20 false").uncheck()
    seen.picture()
    assert "60 tie points" in canvas.get_attribute("aria-label")
    seen.page.get_by_role("combobox", name="Points", exact=True).select_option("final")
    assert seen.page.get_by_label("0 false").is_visible()
    assert seen.page.get_by_label("60 correct").is_visible()


def test_the_swipe_answers_slider_and_arrows(visit: Visits) -> None:
    seen = visit()
    canvas = seen.viewer("Swipe")
    slider = seen.page.get_by_label("Reference up to")
    middle = seen.picture()
    slider.focus()
    slider.press("Home")
    assert slider.get_attribute("aria-valuetext") == "0 %"
    aligned = seen.picture()
    slider.press("End")
    assert len({middle, aligned, seen.picture()}) == 3
    canvas.focus()
    canvas.press("ArrowLeft")
    assert seen.page.get_by_label("Reference up to").get_attribute("aria-valuetext") == "98 %"


def test_the_secondary_is_aligned_by_the_model(
    registration: Make, truth: Affine, visit: Visits, sar_texture: Make, tmp_path: Path
) -> None:
    """The secondary is the reference under the model: aligned, hardly a gray value differs."""
    from featreg.products.resample import resample

    texture = sar_texture(100, 120, 0, 30.0)
    reference = Image(texture, np.ones(texture.shape, np.bool_))
    secondary = resample(reference, truth.inverse, (130, 140))
    entry = ReportEntry("a", "m", 0, registration(80, 0))
    path = tmp_path / "aligned.html"
    write_report(path, ReportStudy("", [ReportPair("a", reference, secondary, truth)], [entry]))
    seen = visit(path=path)
    seen.viewer("Swipe")
    shown = []
    for key in ("Home", "End"):
        seen.page.get_by_label("Reference up to").press(key)
        png = base64.b64decode(seen.picture().split(b",")[1])
        decoded: Any = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)
        shown.append(decoded.astype(float))
    height, width = shown[0].shape
    a, b = (s[height // 4 : -height // 4, width // 3 : -width // 3] for s in shown)
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.95


def test_flicker_stops_and_switches(visit: Visits) -> None:
    seen = visit(reduced_motion="reduce")
    canvas = seen.viewer("Flicker")
    assert seen.page.get_by_role("button", name="Play").is_visible()
    first = seen.picture()
    canvas.focus()
    canvas.press("Space")
    second = seen.picture()
    assert first != second
    seen.page.get_by_role("button", name="Switch once").click()
    assert seen.picture() == first


def test_a_result_without_a_model_and_a_failed_one_say_so(visit: Visits) -> None:
    seen = visit("#pair=1&method=1&seed=0&view=matches")
    seen.page.wait_for_selector("[data-ready^='1/1/']")
    side = seen.page.locator(".side")
    assert "unreliable" in side.inner_text()
    assert "9 points, 12 needed" in side.inner_text()
    seen.viewer("Swipe", 1, 1)
    seen.page.get_by_role("radio", name="gamma").check()
    seen.page.wait_for_selector("[data-ready^='1/2/']")
    assert "died of signal 11" in side.inner_text()


def test_two_fingers_zoom_and_move(visit: Visits) -> None:
    seen = visit(has_touch=True)
    seen.viewer("Overlay")
    # The viewer has no global name; what its canvas shows tells.
    before = seen.picture()
    fingers = """(canvas, places) => {
      const box = canvas.getBoundingClientRect();
      canvas.setPointerCapture = () => {};
      for (const [type, id, x, y] of places)
        canvas.dispatchEvent(new PointerEvent(type, {pointerId: id, pointerType: "touch", bubbles: true,
          button: type === "pointermove" ? -1 : 0, clientX: box.left + x, clientY: box.top + y}));
    }"""
    canvas = seen.page.locator("canvas.stage")
    apart = [["pointerdown", 1, 100, 100], ["pointerdown", 2, 140, 100], ["pointermove", 2, 240, 100]]
    canvas.evaluate(fingers, apart)
    enlarged = seen.picture()
    assert enlarged != before
    canvas.evaluate(fingers, [["pointermove", 2, 140, 100], ["pointerup", 2, 140, 100], ["pointerup", 1, 100, 100]])
    assert seen.picture() == before
    # One finger alone drags.
    canvas.evaluate(fingers, [["pointerdown", 3, 50, 50], ["pointermove", 3, 60, 80], ["pointerup", 3, 60, 80]])
    assert seen.picture() != before


def test_the_text_of_a_tie_point_goes_with_its_pair(visit: Visits) -> None:
    seen = visit()
    seen.viewer("Matches").press("ArrowRight")
    said = seen.page.locator("output.point")
    assert "px from the truth" in said.inner_text()
    seen.page.get_by_role("button", name="Next pair").click()
    seen.page.wait_for_selector("[data-ready^='1/']")
    assert said.inner_text().startswith("Point at a tie point")


def test_the_wheel_says_how_it_zooms(visit: Visits) -> None:
    seen = visit()
    seen.viewer("Overlay").hover()
    seen.page.evaluate("document.activeElement.blur()")
    seen.page.mouse.wheel(0, 10)
    seen.page.get_by_text("click the picture first or hold Ctrl").wait_for(timeout=3000)
