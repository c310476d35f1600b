"""The page of a comparison, and a browser that shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

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


def _registration(count: int, seed: int, **change: Any) -> Registration:
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


def _study_of(texture: Make, pairs: int = 3, count: int = 80) -> ReportStudy:
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
                made = _registration(
                    count, 7, status="unreliable", reason="9 points, 12 needed", model=FailedFit("none")
                )
                entries.append(ReportEntry(name, method, 0, made, scores=scores))
            else:
                entries.append(ReportEntry(name, method, 0, _registration(count, 10 * p + k), scores=scores))
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


@pytest.fixture(scope="session")
def report(sar_texture: Make, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, _study_of(sar_texture))
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


@pytest.fixture
def registration() -> Make:
    """``registration(count, seed, **change)``: a quarter of its tie points are false."""
    return _registration


@pytest.fixture
def study_of() -> Make:
    """``study_of(texture, pairs, count)``: three methods, one of which failed and one of which is not trusted."""
    return _study_of


@pytest.fixture
def truth() -> Affine:
    """The model of every pair."""
    return TRUTH


@pytest.fixture
def evil() -> str:
    """The name of the first pair."""
    return EVIL
