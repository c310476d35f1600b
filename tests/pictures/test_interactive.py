"""What interactive Python shows: short texts, cards of HTML, figures, pandas, and failed fits that say why."""

from __future__ import annotations

import copy
import html.parser
import json
import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import InputError, NoModelError, ParameterError
from featreg.geometry import Rigid
from featreg.interfaces import FailedFit
from featreg.io import write_geotiff
from featreg.results.registration import Registration
from featreg.simulate import sar_pair
from featreg.study.protocol import Protocol
from featreg.study.table import Table
from featreg.types import Features, Geolocation, Image, Matches

TINY = sar_pair((160, 200), shift=(4.0, -3.0), seed=1)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("pair")
    place = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
    write_geotiff(folder / "<ref>.tif", TINY.reference, place)
    write_geotiff(folder / "sec.tif", TINY.secondary)
    return folder / "<ref>.tif", folder / "sec.tif"


@pytest.fixture(scope="module")
def result(files: tuple[Path, Path]) -> Registration:
    return featreg.match(*files)


@pytest.fixture(scope="module")
def refused() -> Registration:
    noise = np.random.default_rng(0).gamma(1, 1, (160, 200)).astype(np.float32)
    return featreg.match(TINY.reference, noise)


@pytest.fixture(scope="module")
def study() -> Any:
    pair = (TINY.reference, TINY.secondary, TINY.truth)
    protocol = Protocol(timing=False, warm_up=False)
    title = "two <methods>"
    return featreg.Experiment([pair], ["sift", "orb"], protocol=protocol, title=title).run(isolate=False)


def features() -> Features:
    xy = np.random.default_rng(0).uniform(0, 99, (2000, 2))
    return Features(xy, np.full(2000, 9.0), np.zeros(2000), np.arange(2000.0), np.zeros(2000, np.int64),
                    np.zeros((2000, 32), np.uint8), "hamming")  # fmt: skip


@pytest.fixture
def shown(result: Registration, refused: Registration, study: Any, files: tuple[Path, Path]) -> dict[str, Any]:
    return {
        "image": featreg.as_image(files[0]),
        "features": features(),
        "no features": Features.empty(),
        "matches": result.matches,
        "no matches": Matches.empty(),
        "result": result,
        "refused": refused,
        "table": study.table(),
        "empty table": Table([]),
        "study": study,
    }


class _Checked(html.parser.HTMLParser):
    """Whether every element that begins ends, and which there are."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.seen.add(tag)
        if tag not in ("img", "rect", "circle", "path"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("rect", "circle", "path"):
            assert self.open.pop() == tag


def test_texts_are_short_and_cards_are_whole_small_and_without_script(shown: dict[str, Any]) -> None:
    for name, thing in shown.items():
        assert len(repr(thing)) < 500, name
        assert "array(" not in repr(thing), name
        card = thing._repr_html_()
        assert len(card.encode()) < 500_000, name
        checked = _Checked(card)
        assert checked.open == [], name
        assert "script" not in checked.seen
        assert "prefers-color-scheme:dark" in card
    assert "&lt;ref&gt;.tif" in shown["image"]._repr_html_()
    assert "two &lt;methods&gt;" in shown["study"]._repr_html_()


def test_texts_say_what_one_asks_first(shown: dict[str, Any], result: Registration) -> None:
    assert repr(shown["features"]) == "Features(2000 points, descriptors of 32 bytes of packed bits)"
    assert "200 x 160 px, amplitude, georeferenced" in repr(shown["image"])
    assert repr(result).startswith(f"Registration(ok, sar-orb, {result.inliers.sum()} tie points, Affine, rotation ")
    assert "unreliable" in repr(shown["refused"])
    assert shown["refused"].reason[:60] in repr(shown["refused"])
    assert repr(shown["table"]) == "Table(2 rows: 1 pairs by 2 methods)"
    lines = result.summary().splitlines()
    assert lines[0] == "ok"
    assert any(line.split() == ["scale", f"{_scale(result):.5f}"] for line in lines)
    assert shown["refused"].summary().startswith("unreliable: ")


def _scale(result: Registration) -> float:
    matrix = result.model.matrix
    assert matrix is not None
    return float(np.sqrt(abs(np.linalg.det(matrix[:2, :2]))))


def test_a_card_shows_the_verdict_every_gate_and_the_images(result: Registration, refused: Registration) -> None:
    card = result._repr_html_()
    assert all(f"<td>{name}</td>" in card for name in result.gates)
    assert card.count("data:image/webp;base64,") == 1  # the overlay of both files
    assert '<span class="badge unreliable">' in refused._repr_html_()
    assert "data:image/webp" not in refused._repr_html_()  # arrays are not kept


def test_figures_are_of_matplotlib_and_notebooks_show_them(shown: dict[str, Any], tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    drawn = [shown["image"].show(), shown["matches"].plot(), shown["no matches"].plot(), shown["result"].plot(),
             shown["refused"].plot(), shown["refused"].plot(TINY.reference, TINY.reference), shown["study"].plot(),
             shown["table"].plot(["ncm"]), shown["result"].plot(truth=TINY.truth)]  # fmt: skip
    for figure in drawn:
        assert isinstance(figure, Figure)
        assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
    drawn[0].savefig(tmp_path / "image.svg")


def test_a_figure_is_the_picture_that_the_command_writes(
    result: Registration, files: tuple[Path, Path], tmp_path: Path
) -> None:
    import cv2

    from featreg.pictures.drawing import draw_registration

    reference, secondary = (featreg.as_image(file) for file in files)
    draw_registration(reference, secondary, result, tmp_path / "a.png")
    (tmp_path / "b.png").write_bytes(result.plot()._repr_png_())
    a, b = (cv2.imread(str(tmp_path / name)) for name in ("a.png", "b.png"))
    assert a is not None
    assert b is not None
    np.testing.assert_array_equal(a, b)


def test_a_picture_says_how_many_of_its_tie_points_it_shows(result: Registration) -> None:
    def texts(figure: Any) -> str:
        return " ".join(text.get_text() for text in figure.axes[0].texts)

    every = int(result.inliers.sum())
    assert every > 400
    assert re.search(r"\d+ of these \d+ drawn", texts(result.plot()))
    few = result.matches.take(np.arange(20))
    assert "drawn" not in texts(few.plot())


def test_images_of_another_size_and_unknown_metrics_are_refused(result: Registration, study: Any) -> None:
    with pytest.raises(InputError, match="has the shape"):
        result.plot(TINY.reference[:100], TINY.secondary)
    with pytest.raises(ParameterError, match="no metric 'ncn', did you mean 'ncm'"):
        study.plot(["ncn"])


def test_frames_of_pandas_hold_every_row(result: Registration, study: Any) -> None:
    frame = result.to_dataframe()
    assert len(frame) == len(result.matches)
    assert frame["inlier"].sum() == result.inliers.sum()
    np.testing.assert_array_equal(frame[["secondary_x", "secondary_y"]], result.matches.secondary_xy)
    points = result.matches.to_dataframe()
    np.testing.assert_array_equal(points["cov_yy"], result.matches.covariance[:, 1, 1])  # type: ignore[index]
    assert list(features().to_dataframe()) == ["x", "y", "scale", "angle", "score", "level"]
    assert study.to_dataframe().equals(study.table().to_dataframe())


def test_a_failed_fit_says_why_on_any_use(refused: Registration) -> None:
    none = refused.model
    assert isinstance(none, FailedFit)
    uses: list[Any] = [
        lambda: none.rotation_deg,
        lambda: none.matrix,
        lambda: none(np.zeros((1, 2))),
        lambda: none.inverse,
    ]
    for use in uses:
        with pytest.raises(NoModelError, match="no tie point is left") as caught:
            use()
        assert isinstance(caught.value, InputError)
    assert not hasattr(none, "matrix")
    assert getattr(none, "scale", None) is None
    assert copy.deepcopy(none) == pickle.loads(pickle.dumps(none)) == none
    assert not none
    assert np.asarray(none).dtype == object  # no protocol is pretended


def test_rigid_results_and_pure_tie_points_are_shown_too() -> None:
    xy = np.random.default_rng(0).uniform(0, 300, (80, 2))
    made = featreg.fit(np.hstack([xy, xy + np.array([3, -2])]), model="rigid")
    assert isinstance(made.model, Rigid)
    assert "tie points" in made.summary()
    assert made._repr_html_().count("<svg") == 1
    assert made.plot()._repr_png_()[:4] == b"\x89PNG"


def test_what_draws_is_imported_when_something_is_shown() -> None:
    code = (
        "import sys, featreg; from featreg.types import Matches; m = Matches.empty(); repr(m)\n"
        "assert not [n for n in sys.modules if n.startswith(('matplotlib', 'pandas', 'featreg.pictures'))]\n"
        "m._repr_html_(); assert 'featreg.pictures.interactive' in sys.modules; assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_another_room_registers_its_own_types() -> None:
    from featreg.pictures.cards import card
    from featreg.pictures.interactive import html_of
    from featreg.runtime.showing import Shown

    class Stack(Shown):
        pass

    with pytest.raises(ParameterError, match="how a Stack is shown"):
        Stack()._repr_html_()
    html_of.register(Stack, lambda stack: card("Stack", [("dates", "12")], status="ok"))
    assert "<dt>dates</dt><dd>12</dd>" in Stack()._repr_html_()


def test_progress_is_a_bar_in_a_terminal_a_widget_in_a_notebook_and_silence_in_a_pipe(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from featreg.runtime import progress

    bar = featreg.progress_bar("matching")
    for k in (1, 2, 3):
        bar(k, 3)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for k in (1, 2, 3):
        bar(k, 3)
    said = capsys.readouterr().err
    assert "matching" in said
    assert "3/3" in said
    pytest.importorskip("tqdm")
    monkeypatch.setattr(progress, "in_notebook", lambda: True)
    for k in (1, 3):
        bar(k, 3)
    assert "3/3" in capsys.readouterr().err


def test_a_large_file_is_not_read_to_show_its_result(result: Registration, monkeypatch: pytest.MonkeyPatch) -> None:
    from featreg.pictures import interactive

    monkeypatch.setattr(interactive, "MOST_PIXELS", 100)
    assert "data:image/webp" not in result._repr_html_()
    assert "<svg" in result._repr_html_()


def test_a_masked_image_says_how_much_of_it_is_data() -> None:
    mask = np.ones((40, 50), bool)
    mask[:10] = False
    image = Image(np.ones((40, 50), np.float32), mask)
    assert repr(image) == "Image('array', 50 x 40 px, amplitude, 75 % valid)"
    assert json.dumps(image._repr_html_())
