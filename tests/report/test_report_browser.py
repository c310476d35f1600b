"""The page of a comparison in a real browser: quiet, usable by mouse and keyboard, and right in what it says."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from featreg.geometry import Affine
from featreg.interfaces import FailedFit
from featreg.report import ReportColumn, ReportEntry, ReportPair, ReportStudy, ReportSweep, ReportTable, write_report
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Image, Matches

TRUTH = Affine(np.array([[1.0, -0.03, 5.0], [0.04, 1.01, -3.0]]))
EVIL = "<script>document.title='owned'</script><img src=x onerror=alert(1)>"
Make = Callable[..., Any]


def registration(count: int, seed: int, **change: Any) -> Registration:
    rng = np.random.default_rng(seed)
    reference = rng.uniform(10, 90, (count, 2))
    secondary = TRUTH(reference) + rng.normal(0, 0.2, (count, 2))
    false = np.arange(count) % 4 == 3
    secondary[false, 0] += 40
    # One point stands alone in the upper left corner, where a mouse finds it.
    reference[0] = 4, 4
    secondary[0] = TRUTH(reference[:1])[0] + (0.3, 0.4)
    made = Registration(
        Matches(reference, secondary, np.full(count, 0.75)),
        {"gms": np.ones(count, np.bool_), "ransac": ~false},
        ~false,
        TRUTH,
        "ok",
        timings={"detect": 0.2, "match": 0.1},
        reference=InputImage("array", (100, 120)),
    )
    return replace(made, **change)


def study_of(texture: Make, pairs: int = 3, count: int = 80) -> ReportStudy:
    first, second = (Image(t, np.ones(t.shape, np.bool_)) for t in (texture(100, 120, seed) for seed in (0, 1)))
    names = [EVIL, *(f"pair {k}" for k in range(1, pairs))]
    methods = ("alpha", "beta", "gamma")
    entries, rows = [], []
    for p, name in enumerate(names):
        for k, method in enumerate(methods):
            scores: dict[str, float | None] = {
                "ncm": 10.0 * (p + 1) + k,
                "rmse": 1.5 - 0.25 * k,
                "time_s": 0.1 * (k + 1),
            }
            if (p, k) == (1, 2):
                scores = {"ncm": 0.0, "rmse": None, "time_s": None}
                entries.append(ReportEntry(name, method, 0, None, "died of signal 11", scores=scores))
            elif (p, k) == (1, 1):
                made = registration(
                    count, 7, status="unreliable", reason="9 points, 12 needed", model=FailedFit("none")
                )
                entries.append(ReportEntry(name, method, 0, made, scores=scores))
            else:
                entries.append(ReportEntry(name, method, 0, registration(count, 10 * p + k), scores=scores))
            rows.append({"pair": name, "method": method, "status": entries[-1].status, **scores})
    columns = [
        ReportColumn("pair"),
        ReportColumn("method"),
        ReportColumn("status"),
        ReportColumn("ncm", "high", digits=0),
        ReportColumn("rmse", "low", "px"),
        ReportColumn("time_s", "low", "s"),
    ]
    means = {m: {"ncm": (20.0 + k, 12.0, 31.0), "rmse": (1.5 - 0.25 * k, None, None)} for k, m in enumerate(methods)}
    differences = {"beta": {"ncm": (1.0, 0.5, 1.5)}, "gamma": {"ncm": (2.0, -1.0, 5.0)}}
    sweep = ReportSweep(
        {"threshold": [1, 2, 3], "bits": [128, 256]}, {"ncm": np.arange(6.0).reshape(3, 2)}, {"ncm": "high"}
    )
    return ReportStudy(
        "Three methods",
        [ReportPair(name, first, second, TRUTH, "known model") for name in names],
        entries,
        ReportTable(columns, rows, means, differences, "alpha"),
        protocol={"filters": "gms, ransac"},
        machine={"cpu": "one"},
        sweep=sweep,
    )


@pytest.fixture(scope="module")
def report(sar_texture: Make, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, study_of(sar_texture))
    return path


class Visit:
    """A page on show, with everything it complained about and asked for."""

    def __init__(self, browser: Any, path: Path, at: str = "", **options: Any) -> None:
        self.context = browser.new_context(viewport={"width": 1280, "height": 900}, **options)
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri() + at)

    def viewer(self, mode: str, pair: int = 0, method: int = 0) -> Any:
        self.page.locator("#pairs").scroll_into_view_if_needed()
        self.page.wait_for_selector("[data-ready]")
        self.page.get_by_role("radio", name=mode).check()
        self.page.wait_for_selector(f"[data-ready^='{pair}/{method}/']")
        return self.page.locator("canvas.stage")

    def picture(self) -> bytes:
        """What the canvas shows, after it has been drawn."""
        self.page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        return bytes(self.page.locator("canvas.stage").evaluate("c => c.toDataURL()"), "ascii")


@pytest.fixture
def visit(chromium: Any, report: Path) -> Iterator[Callable[..., Visit]]:
    """Opens the page; at the end nothing may have been said on the console, nor anything been asked of a network."""
    made: list[Visit] = []

    def open_page(at: str = "", path: Path = report, **options: Any) -> Visit:
        made.append(Visit(chromium, path, at, **options))
        return made[-1]

    yield open_page
    for each in made:
        each.context.close()
    for each in made:
        assert each.complaints == []
        assert [url for url in each.requests if not url.startswith(("data:", "blob:"))] == each.requests[:1]


def test_every_view_of_every_result_is_quiet_and_shows_something(visit: Callable[..., Visit]) -> None:
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


def test_names_do_no_harm(visit: Callable[..., Visit]) -> None:
    page = visit().page
    assert page.title() == "Three methods"
    assert page.locator("img").count() == 0
    assert page.get_by_role("link", name=EVIL).first.is_visible()


def test_the_table_sorts_by_mouse_and_keyboard_and_says_so(visit: Callable[..., Visit]) -> None:
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


def test_the_best_of_a_pair_is_marked_for_eyes_and_ears(visit: Callable[..., Visit]) -> None:
    table = visit().page.get_by_role("table", name="Every run")
    best = table.locator("td.best").all_inner_texts()
    assert all("★" in text and "best" in text for text in best)
    # The failed and the missing one win nothing: of the second pair the unreliable one has the least error.
    second = table.locator("tbody tr").nth(4).locator("td")
    assert "★" in second.nth(4).inner_text()
    assert "★" not in second.nth(5).inner_text()


def test_intervals_differences_failures_and_protocol_are_told(visit: Callable[..., Visit]) -> None:
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


def test_a_tie_point_is_read_by_mouse(visit: Callable[..., Visit]) -> None:
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


def test_tie_points_are_read_by_keyboard(visit: Callable[..., Visit]) -> None:
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


def test_kinds_and_sets_of_points_can_be_chosen(visit: Callable[..., Visit]) -> None:
    seen = visit()
    canvas = seen.viewer("Matches")
    assert "80 tie points" in canvas.get_attribute("aria-label")
    seen.page.get_by_label("20 false").uncheck()
    seen.picture()
    assert "60 tie points" in canvas.get_attribute("aria-label")
    seen.page.get_by_role("combobox", name="Points", exact=True).select_option("final")
    assert seen.page.get_by_label("0 false").is_visible()
    assert seen.page.get_by_label("60 correct").is_visible()


def test_the_swipe_answers_slider_and_arrows(visit: Callable[..., Visit]) -> None:
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


def test_the_secondary_is_aligned_by_the_model(visit: Callable[..., Visit], sar_texture: Make, tmp_path: Path) -> None:
    """The secondary is the reference under the model: aligned, hardly a gray value differs."""
    from featreg.products.resample import resample

    texture = sar_texture(100, 120, 0, 30.0)
    reference = Image(texture, np.ones(texture.shape, np.bool_))
    secondary = resample(reference, TRUTH.inverse, (130, 140))
    entry = ReportEntry("a", "m", 0, registration(80, 0))
    path = tmp_path / "aligned.html"
    write_report(path, ReportStudy("", [ReportPair("a", reference, secondary, TRUTH)], [entry]))
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


def test_flicker_stops_and_switches(visit: Callable[..., Visit]) -> None:
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


def test_a_result_without_a_model_and_a_failed_one_say_so(visit: Callable[..., Visit]) -> None:
    seen = visit("#pair=1&method=1&seed=0&view=matches")
    seen.page.wait_for_selector("[data-ready^='1/1/']")
    side = seen.page.locator(".side")
    assert "unreliable" in side.inner_text()
    assert "9 points, 12 needed" in side.inner_text()
    seen.viewer("Swipe", 1, 1)
    seen.page.get_by_role("radio", name="gamma").check()
    seen.page.wait_for_selector("[data-ready^='1/2/']")
    assert "died of signal 11" in side.inner_text()


def test_a_run_opens_from_the_table_and_has_an_address(visit: Callable[..., Visit]) -> None:
    page = visit().page
    page.get_by_role("table", name="Every run").get_by_role("link", name="pair 2").nth(1).click()
    page.wait_for_selector("[data-ready^='2/1/']")
    assert "pair=2&method=1" in page.url
    assert page.evaluate("document.activeElement.className") == "stage"


def test_everything_is_reached_by_tab_and_has_a_name(visit: Callable[..., Visit]) -> None:
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
def test_both_themes_can_be_read(visit: Callable[..., Visit], scheme: str) -> None:
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


def test_a_narrow_window_scrolls_in_one_direction_only(visit: Callable[..., Visit]) -> None:
    seen = visit()
    seen.page.set_viewport_size({"width": 390, "height": 800})
    seen.viewer("Matches")
    assert seen.page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("width", [1000, 1400, 1700])
def test_no_chart_is_cut_off(visit: Callable[..., Visit], width: int) -> None:
    page = visit().page
    page.set_viewport_size({"width": width, "height": 800})
    cut = "figures => figures.filter(f => f.scrollWidth > f.clientWidth + 1).map(f => f.textContent.slice(0, 30))"
    figures = page.locator("#charts figure")
    assert figures.count() >= 4
    assert figures.evaluate_all(cut) == []


def test_a_sweep_shows_its_best_cell(visit: Callable[..., Visit]) -> None:
    page = visit().page
    chart = page.get_by_role("img", name="ncm over bits and threshold")
    assert chart.locator(".incell").all_text_contents() == ["0", "1", "2", "3", "4", "5 ★"]


@pytest.mark.slow
def test_twenty_pairs_of_five_thousand_matches_open(
    visit: Callable[..., Visit], sar_texture: Make, tmp_path: Path
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


def test_tables_and_charts_can_be_taken_along(visit: Callable[..., Visit], sar_texture: Make, tmp_path: Path) -> None:
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


def test_charts_and_views_are_saved_as_png(visit: Callable[..., Visit]) -> None:
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


def test_two_fingers_zoom_and_move(visit: Callable[..., Visit]) -> None:
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


def test_the_text_of_a_tie_point_goes_with_its_pair(visit: Callable[..., Visit]) -> None:
    seen = visit()
    seen.viewer("Matches").press("ArrowRight")
    said = seen.page.locator("output.point")
    assert "px from the truth" in said.inner_text()
    seen.page.get_by_role("button", name="Next pair").click()
    seen.page.wait_for_selector("[data-ready^='1/']")
    assert said.inner_text().startswith("Point at a tie point")


def test_the_wheel_says_how_it_zooms(visit: Callable[..., Visit]) -> None:
    seen = visit()
    seen.viewer("Overlay").hover()
    seen.page.evaluate("document.activeElement.blur()")
    seen.page.mouse.wheel(0, 10)
    seen.page.get_by_text("click the picture first or hold Ctrl").wait_for(timeout=3000)


def test_print_holds_every_pair_and_whole_tables(visit: Callable[..., Visit], tmp_path: Path) -> None:
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
    visit: Callable[..., Visit], accessible: Callable[[Any], None], scheme: str, width: int
) -> None:
    seen = visit(color_scheme=scheme)
    seen.page.set_viewport_size({"width": width, "height": 900})
    for mode in ("Matches", "Residuals"):
        seen.viewer(mode)
        accessible(seen.page)


def test_the_page_of_one_result_has_no_violation_that_axe_knows(
    visit: Callable[..., Visit], accessible: Callable[[Any], None], sar_texture: Make, tmp_path: Path
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


def test_a_sweep_begins_with_its_map_and_tells_its_combinations_apart(
    visit: Callable[..., Visit], sar_texture: Make, tmp_path: Path
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
