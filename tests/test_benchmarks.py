"""The parts of the benchmarks that decide what is called right: truths, errors, counts, and the page of figures."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from featreg.geometry import Affine
from featreg.interfaces import FailedFit
from featreg.io import as_image

HERE = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(autouse=True)
def benchmarks(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Benchmarks are scripts: their folder is on the path for as long as a test runs."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(str(HERE))
    yield
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(HERE)):
            del sys.modules[name]


def landscape(side: int, seed: int) -> Any:
    """(side, side) 8-bit, nowhere black."""
    field = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(side, side)), (0, 0), 3)
    return (60 + 180 * (field - field.min()) / np.ptp(field)).astype(np.uint8)


@pytest.mark.parametrize("turn", [3.0, 21.4, 45.0, 68.2, 86.0])
def test_the_outline_tells_the_turn_of_a_square(turn: float) -> None:
    from outline import outline_of, turned_about_centres

    image = landscape(400, 1)
    matrix = turned_about_centres((400, 400), 256, turn)
    turned: Any = cv2.warpAffine(image, matrix, (256, 256))
    found = outline_of(turned)
    assert found.clear
    assert abs(found.turn_deg - turn) < 0.5
    centre = cv2.transform(np.array([[[199.5, 199.5]]]), matrix)[0, 0]
    np.testing.assert_allclose(centre, [127.5, 127.5])
    # Counter-clockwise as seen: what lies to the right goes up.
    right = cv2.transform(np.array([[[299.5, 199.5]]]), matrix)[0, 0] - centre
    assert np.degrees(np.arctan2(-right[1], right[0])) == pytest.approx(turn)


def test_corners_of_another_form_are_no_truth() -> None:
    from outline import outline_of

    image = landscape(256, 2)
    image[:, :60] = 0
    assert not outline_of(image).clear
    upright = outline_of(landscape(256, 3))
    assert upright.clear
    assert min(upright.turn_deg, 90 - upright.turn_deg) < 0.5


def test_the_error_is_that_of_the_model_where_both_images_show_the_ground() -> None:
    from pair_protocol import KnownPair, grid_error

    truth = np.array([[1.0, 0.0, 50.0], [0.0, 1.0, 0.0]])
    pair = KnownPair("a", "a", np.zeros((100, 100)), np.zeros((100, 100)), truth)
    assert grid_error(Affine(truth), pair) == pytest.approx(0.0)
    assert grid_error(Affine(truth + np.array([[0, 0, 3.0], [0, 0, 4.0]])), pair) == pytest.approx(5.0)
    # Wrong by the stretch in x alone, over that half of the reference whose truth lies inside.
    stretched = Affine(truth + np.array([[0.1, 0, 0], [0, 0, 0]]))
    x = np.linspace(0.03, 0.97, 15) * 99
    assert grid_error(stretched, pair) == pytest.approx(np.sqrt(np.mean((0.1 * x[x <= 49]) ** 2)))
    assert np.isnan(grid_error(FailedFit("none"), pair))


def test_refusals_and_failures_are_not_within_and_only_trusted_errors_are_wrong() -> None:
    from pair_protocol import COLUMNS, Answer, row

    said = [("ok", 0.5), ("ok", 2.0), ("ok", 7.0), ("unreliable", 0.2), ("failed", float("nan"))]
    own = [Answer(f"p{i}", f"p{i}", "m", status, error, 2.0, "") for i, (status, error) in enumerate(said)]
    orb = [Answer(f"p{i}", f"p{i}", "orb", "ok", 0.1, 0.5, "") for i in range(5)]
    line = dict(zip(COLUMNS, row("m", own, [*own, *orb], 5.0), strict=True))
    assert (line["pairs"], line["trusted"], line["wrong"]) == (5, 3, 1)
    assert [float(str(line[f"within {t} px"]).split()[0]) for t in (1, 3, 5, 10)] == [0.2, 0.4, 0.4, 0.6]
    assert (line["grid px"], line["CPU s"], line["x orb"]) == (1.25, 2.0, 4.0)
    low, high = map(float, re.findall(r"[\d.]+", str(line["within 10 px"]))[1:])
    assert 0 <= low < 0.6 < high <= 1


def test_a_misspelt_method_ends_the_run_before_it_begins() -> None:
    from pair_protocol import methods_of

    assert methods_of("sar-orb,orb") == (["sar-orb", "orb"], [])
    with pytest.raises(SystemExit, match="--methods: unknown method 'sar-orbs'"):
        methods_of("orb,sar-orbs")


def test_no_round_is_refused() -> None:
    from measuring import round_count

    assert round_count("3") == 3
    with pytest.raises(argparse.ArgumentTypeError, match="at least 1 round is needed, got 0"):
        round_count("0")


def test_pairs_of_a_set_are_spread_and_their_warps_are_their_own() -> None:
    from pair_protocol import spread
    from sar_sar import known_pairs

    assert spread(list(range(10)), 4) == [0, 3, 6, 9]
    scenes = [(name, name, landscape(120, k), landscape(120, k)) for k, name in enumerate("ab")]
    both, one = list(known_pairs(scenes, 5, 180, 0.1, 10)), list(known_pairs(scenes[:1], 5, 180, 0.1, 10))
    np.testing.assert_array_equal(both[0].truth, one[0].truth)
    assert not np.array_equal(both[0].truth, both[1].truth)
    assert both[0].secondary_mask is not None
    assert (both[0].secondary[~both[0].secondary_mask] < 255).all()


def test_the_page_holds_its_pictures_and_needs_nothing_from_elsewhere(tmp_path: Path) -> None:
    from figures.page import Figure, axes, show, write_page

    drawn, places = axes(1, 2, (4, 2))
    show(places[0, 0], np.eye(16), "an <image>")
    figure = Figure.of("Figure 1", "A & B", "what is drawn", "how it compares", drawn)
    assert figure.png.startswith(b"\x89PNG")
    write_page(tmp_path / "page.html", [("A paper", "about it", [figure, figure])], "seed 0")
    text = (tmp_path / "page.html").read_text()
    assert text.count("data:image/png;base64,") == 2
    assert "Figure 1: A &amp; B" in text
    assert not re.search(r'(src|href)="http', text)


def test_orders_in_captions_are_those_of_the_run() -> None:
    from figures.page import ranked

    assert ranked({"a": 2.0, "b": 1610.2, "c": 3.14159}, " px") == "b 1610 px, c 3 px, a 2 px"
    assert ranked({"a": 11.785, "b": 11.816}, digits=2) == "b 11.82, a 11.79"


@pytest.mark.parametrize(("what", "same"), [("two 1-degree apertures of Gotcha", True), ("a simulated lot", False)])
def test_a_simulated_couple_is_not_called_that_of_the_paper(what: str, same: bool) -> None:
    from figures.targets import couple
    from rotation import Couple

    image = as_image(landscape(40, 1) + np.float32(1))
    drawn = couple(Couple("a", 0.0, image, image), what)
    assert ("The same parking lot as in the paper" in drawn.beside) == same
    assert "40 x 40 px" in drawn.shown


def test_three_corners_tell_the_error_of_each() -> None:
    from labels import errors

    rng = np.random.default_rng(0)
    sigma = np.array([1.9, 0.5, 1.2])
    off = sigma[:, None, None] * rng.normal(size=(3, 20_000, 2)) / np.sqrt(2)
    squares = [((off[i] - off[j]) ** 2).sum(axis=1).mean() for i, j in ((0, 1), (0, 2), (1, 2))]
    np.testing.assert_allclose(errors(np.array(squares)), sigma, rtol=0.05)


def test_information_is_highest_where_two_images_lie() -> None:
    from labels import Information, square_apart
    from outline import turned_about_centres
    from pair_protocol import KnownPair

    image = landscape(200, 4)
    truth = turned_about_centres((200, 200), 128, 12.0)
    # Grey values of another kind: neither their order nor their differences are kept.
    other = np.abs(cv2.warpAffine(image, truth, (128, 128)).astype(np.int64) - 120).astype(np.uint8)
    seen = cv2.warpAffine(np.ones_like(image), truth, (128, 128)) > 0
    pair = KnownPair("pair", "pair", image, other, truth, seen)
    start = truth + np.array([[0.005, 0.01, 0.5], [-0.01, 0.005, -1.0]])
    assert square_apart(Affine(start), Affine(truth), pair) > 1.0
    found = Information(pair).highest(start)[1]
    assert square_apart(Affine(found), Affine(truth), pair) < 0.2


def test_a_simulated_cluster_is_bound_by_what_is_slowest() -> None:
    from cluster import Costs, simulate

    one, ten = (simulate(Costs((0.05,), start=2.0, end=0.001), 1000, workers) for workers in (1, 10))
    assert one.wall_s == pytest.approx(2 + 50 + 1)
    assert ten.wall_s == pytest.approx(2 + 5 + 1)
    assert ten.workers == pytest.approx(5 / 8)
    # 1000 blocks at 1 ms of the scheduler each, half of it on the way out, hide all else.
    served = simulate(Costs((0.01,), scheduler_block=0.001), 1000, 500)
    assert 0.99 < served.wall_s < 1.3
    assert served.scheduler > 0.8
    read = simulate(Costs((0.01,), read=1e7, store=1e9), 1000, 50)
    assert 10 <= read.wall_s < 11.5


def test_a_simulated_worker_that_dies_loses_its_bundle_only() -> None:
    from cluster import Costs, simulate

    calm, bad = (simulate(Costs((0.05,), deaths=rate, replaced=5.0), 4000, 4, seed=1) for rate in (0.0, 60.0))
    assert calm.again == 0
    assert 0 < bad.again <= 16 * 20
    assert calm.wall_s < bad.wall_s < 2 * calm.wall_s


def test_a_wide_pair_shows_one_texture_under_its_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import json

    import rasterio
    import wide_pair

    monkeypatch.setattr(wide_pair, "texture", lambda: landscape(200, 3).astype(np.float32))
    monkeypatch.setattr(wide_pair, "PAINTED", 128)
    monkeypatch.setattr(wide_pair, "LOOKS", 1e8)
    place = wide_pair.wide_pair(tmp_path, (300, 420))
    images = []
    for name in ("reference", "secondary"):
        with rasterio.open(place / f"{name}.tif") as file:
            images.append(file.read(1).astype(np.float32))
    truth = np.array(json.loads((place / "truth.json").read_text())["matrix"])
    back = cv2.warpAffine(images[1], truth, (420, 300), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    inner = (slice(30, -30), slice(30, -30))
    assert np.abs(back[inner] / images[0][inner] - 1).mean() < 0.01
    assert np.abs(images[1][inner] / images[0][inner] - 1).mean() > 0.05
    assert wide_pair.wide_pair(tmp_path, (300, 420)) == place


def test_both_windows_of_a_hard_pair_show_one_scene_under_its_truth() -> None:
    from hard_pairs import cut

    whole = landscape(600, 5).astype(np.float32)
    one, other, truth = cut(np.random.default_rng(3), whole, (200, 160), (1e6, 1e6), common=(0.4, 0.5))
    there = cv2.warpAffine(one, truth, (160, 200), flags=cv2.INTER_LINEAR, borderValue=-1000.0)
    both = cv2.erode((there > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert 0.3 < both.mean() < 0.6
    np.testing.assert_allclose(there[both], other[both], atol=5)
    assert np.ptp(other[both]) > 50
