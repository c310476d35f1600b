"""The marking page in a real browser, served by the real command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest

from featreg.exports.formats import read_tie_points

RUN = "from featreg.cli.main import main; raise SystemExit(main())"
SHIFT = np.array([6.0, -4.0])
PLACES = np.array([[40.0, 40.0], [160.0, 50.0], [50.0, 150.0], [150.0, 140.0]])


class Session:
    """A running `featreg mark`."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.file = folder / "points.csv"
        command = [sys.executable, "-c", RUN, "mark", str(folder / "a.npy"), str(folder / "b.npy")]
        self.process = subprocess.Popen(
            [*command, "-o", str(self.file), "--no-browser", *options],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line.startswith("mark points at http://127.0.0.1:"), line or self.process.communicate()[1]
        self.address = line.split()[-1]

    def stop(self) -> tuple[int, str]:
        self.process.send_signal(signal.SIGINT)
        out, _ = self.process.communicate(timeout=30)
        return self.process.returncode, out


@pytest.fixture
def session(sar_texture: Callable[..., Any], tmp_path: Path) -> Iterator[Session]:
    pytest.importorskip("uvicorn", reason="the marking page needs: pip install featreg[web]")
    texture = sar_texture(220, 240, 3)
    np.save(tmp_path / "a.npy", texture[10:210, 10:210])
    # The secondary starts 6 px further left and 4 px further down.
    np.save(tmp_path / "b.npy", texture[14:214, 4:204])
    made = Session(tmp_path)
    yield made
    if made.process.poll() is None:
        made.process.kill()
        made.process.communicate()


@pytest.fixture
def page(chromium: Any, session: Session) -> Iterator[Any]:
    context = chromium.new_context(viewport={"width": 1200, "height": 900})
    page = context.new_page()
    complaints: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(session.address)
    page.wait_for_selector("[data-ready]")
    yield page
    context.close()
    assert complaints == []
    assert [url for url in asked if not url.startswith((session.address, "data:"))] == []


def click(page: Any, side: int, xy: np.ndarray[Any, Any]) -> None:
    """Click a place of a 200 x 200 image that is shown whole."""
    canvas = page.locator(f"#view-{side}")
    box = canvas.bounding_box()
    zoom = min(box["width"], box["height"]) / 200
    page.mouse.click(*(np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]) + (xy - 99.5) * zoom))


def settled(page: Any, side: int) -> str:
    """What a view shows once its tiles have come and are drawn."""
    page.wait_for_load_state("networkidle")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return str(page.locator(f"#view-{side}").evaluate("c => c.toDataURL()"))


def mark(page: Any, number: int) -> None:
    click(page, 0, PLACES[number])
    page.get_by_text("Now the same place in the secondary").wait_for()
    click(page, 1, PLACES[number] + SHIFT)
    page.locator("#points tr").nth(number).wait_for()


def test_four_points_are_marked_undone_moved_and_deleted(page: Any, session: Session) -> None:
    for number in range(4):
        mark(page, number)
        assert len(read_tie_points(session.file)) == number + 1
    found = read_tie_points(session.file)
    np.testing.assert_allclose(found.reference_xy, PLACES, atol=0.5)
    np.testing.assert_allclose(found.secondary_xy, PLACES + SHIFT, atol=0.5)
    assert "affine, RMS" in page.locator("#fit").inner_text()
    residuals = page.locator("#points tr td:nth-child(4)").all_inner_texts()
    assert len(residuals) == 4
    assert all(float(text) < 0.5 for text in residuals)
    assert all(float(text) < 2 for text in page.locator("#points tr td:nth-child(5)").all_inner_texts())

    page.get_by_role("button", name="Undo").click()
    page.locator("#points tr").nth(3).wait_for(state="detached")
    assert len(read_tie_points(session.file)) == 3
    page.keyboard.press("Control+y")
    page.locator("#points tr").nth(3).wait_for()
    np.testing.assert_allclose(read_tie_points(session.file).reference_xy, found.reference_xy)
    page.get_by_role("button", name="Delete point 2").click()
    page.locator("#points tr").nth(3).wait_for(state="detached")
    np.testing.assert_allclose(read_tie_points(session.file).reference_xy, found.reference_xy[[0, 2, 3]])
    code, out = session.stop()
    assert code == 0
    assert "3 points in" in out


def test_the_second_point_is_predicted(page: Any, session: Session) -> None:
    for number in range(3):
        mark(page, number)
    click(page, 0, PLACES[3])
    page.get_by_text("it is expected at the dashed cross").wait_for()
    page.keyboard.press("Escape")
    assert page.get_by_role("button", name="Cancel point").is_disabled()
    assert len(read_tie_points(session.file)) == 3


def test_points_are_marked_by_keyboard_alone(page: Any, session: Session) -> None:
    page.get_by_label("Move together").uncheck()
    first, second = page.locator("#view-0"), page.locator("#view-1")
    first.focus()
    first.press("+")
    first.press("Enter")
    page.get_by_text("Now the same place in the secondary").wait_for()
    second.focus()
    # What the page expects there is no measurement, so that the cross must have been moved.
    second.press("Enter")
    page.get_by_text("what is expected there is no measurement").wait_for()
    assert page.locator("#points tr").count() == 0
    second.press("ArrowRight")
    second.press("Enter")
    page.locator("#points tr").first.wait_for()
    found = read_tie_points(session.file)
    np.testing.assert_allclose(found.reference_xy, [[99.5, 99.5]], atol=1e-6)
    assert found.secondary_xy[0, 0] > 100
    assert found.secondary_xy[0, 1] == pytest.approx(99.5)


def test_others_are_refused_by_the_running_server(session: Session) -> None:
    host = session.address.split("/")[2]
    for url, headers in (
        (f"http://{host}/", {}),
        (f"http://{host}/wrong-token/", {}),
        (session.address, {"Host": "evil.example"}),
        (session.address + "state", {"Origin": "http://evil.example"}),
    ):
        with pytest.raises(HTTPError) as refused:
            urlopen(Request(url, headers=headers), timeout=20)
        assert refused.value.code == 403
        refused.value.close()
    with urlopen(session.address, timeout=20) as answer:
        assert answer.status == 200


def test_the_page_has_no_violation_that_axe_knows(page: Any, accessible: Callable[[Any], None]) -> None:
    for side, places in enumerate(PLACES[:2]):
        page.locator(f"#view-{side}").click(position={"x": float(places[0]), "y": float(places[1])})
    accessible(page)


def test_two_fingers_zoom_and_make_no_mark(page: Any) -> None:
    """A pinch on the reference: both views are enlarged, and no point is begun."""
    canvas = page.locator("#view-0")
    before = [settled(page, side) for side in (0, 1)]
    canvas.evaluate(
        """(canvas) => {
          canvas.setPointerCapture = () => {};
          const box = canvas.getBoundingClientRect();
          for (const [type, id, x] of [["pointerdown", 1, 100], ["pointerdown", 2, 140], ["pointermove", 2, 240],
                                       ["pointerup", 2, 240], ["pointerup", 1, 100]])
            canvas.dispatchEvent(new PointerEvent(type, {pointerId: id, pointerType: "touch", bubbles: true,
              clientX: box.left + x, clientY: box.top + 100}));
        }"""
    )
    for side in (0, 1):
        changed = "([side, before]) => document.getElementById(`view-${side}`).toDataURL() !== before"
        page.wait_for_function(changed, arg=[side, before[side]])
    assert page.locator("#cancel").is_disabled()
    assert page.locator("#points tr").count() == 0
