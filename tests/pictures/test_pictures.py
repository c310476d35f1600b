"""Pictures of a registration: what is drawn, in which colour and size, and that a file is whole or absent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geometry import Affine
from featreg.interfaces import FailedFit
from featreg.pictures.drawing import (
    BAD,
    GOOD,
    checkerboard,
    display,
    draw_checkerboard,
    draw_matches,
    draw_overlay,
    draw_registration,
    overlay,
)
from featreg.pictures.panels import INVALID, PANEL
from featreg.pictures.spread import spread_out
from featreg.results.registration import Registration
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Image, Matches
from made.images import image_of


def read(path: Path) -> Any:
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture[..., ::-1].astype(int)


def pixels_near(picture: Any, colour: tuple[int, int, int]) -> int:
    return int((np.abs(picture - colour).max(axis=-1) < 30).sum())


@pytest.fixture(scope="module")
def pair() -> SimulatedPair:
    return sar_pair((240, 300), shift=(4.0, -3.0), seed=1)


@pytest.fixture(scope="module")
def images(pair: SimulatedPair) -> tuple[Image, Image]:
    return image_of(pair.reference), image_of(pair.secondary)


def registration_of(pair: SimulatedPair, wrong: int = 30, **changes: Any) -> Registration:
    """60 good tie points and `wrong` bad ones, of which the filter keeps 3."""
    rng = np.random.default_rng(0)
    reference = rng.uniform(20, [279, 219], (60 + wrong, 2))
    secondary = reference @ pair.truth[:, :2].T + pair.truth[:, 2]
    secondary[60:] = rng.uniform(20, [279, 219], (wrong, 2))
    kept = np.arange(60 + wrong) < 63
    values: dict[str, Any] = {
        "matches": Matches(reference, secondary, rng.random(60 + wrong)),
        "stages": {"gms": kept},
        "inliers": np.arange(60 + wrong) < 60,
        "model": Affine(pair.truth),
        "status": "ok",
        "provenance": {"method": "sar-orb"},
    }
    return Registration(**(values | changes))


def test_display_stretches_and_marks_what_is_invalid() -> None:
    ramp = np.exp(np.linspace(0, 3, 2000)).reshape(40, 50)
    mask = np.ones((40, 50), bool)
    mask[:5] = False
    view = display(image_of(ramp, mask))
    assert view.shape == (40, 50)
    assert view.dtype == np.uint8
    assert (view[:5] == INVALID).all()
    assert view[5:].min() == 0
    assert view[5:].max() == 255
    assert (np.diff(view[5:].ravel().astype(int)) >= 0).all()


def test_display_does_not_depend_on_the_gain(images: tuple[Image, Image]) -> None:
    pixels = images[0].pixels.real.astype(np.float32)
    np.testing.assert_allclose(display(image_of(300 * pixels)), display(images[0]), atol=1)


@pytest.mark.parametrize("value", [0.0, 7.0])
def test_display_of_a_constant_image_is_constant(value: float) -> None:
    assert np.ptp(display(image_of(np.full((20, 20), value)))) == 0


def test_display_of_complex_samples_shows_the_amplitude() -> None:
    phase = np.random.default_rng(0).uniform(0, 6, (20, 20))
    amplitude = np.arange(1, 401, dtype=np.float32).reshape(20, 20)
    samples = Image((amplitude * np.exp(1j * phase)).astype(np.complex64), np.ones((20, 20), bool))
    np.testing.assert_allclose(display(samples), display(image_of(amplitude)), atol=1)


def test_overlay_of_equal_images_is_gray(images: tuple[Image, Image]) -> None:
    picture = overlay(images[0], images[0])
    np.testing.assert_array_equal(picture[..., 0], picture[..., 1])
    np.testing.assert_array_equal(picture[..., 0], picture[..., 2])
    assert picture.std() > 20


def test_overlay_of_shifted_images_has_coloured_fringes(images: tuple[Image, Image]) -> None:
    pixels = images[0].amplitude
    picture = overlay(images[0], np.roll(pixels, 5, axis=1)).astype(int)
    colour = np.abs(picture[..., 0] - picture[..., 1])
    assert (colour > 60).mean() > 0.05
    np.testing.assert_array_equal(picture[..., 0], picture[..., 2])


def test_overlay_is_gray_where_one_image_has_no_data(images: tuple[Image, Image]) -> None:
    aligned = images[1].amplitude.copy()
    aligned[:, :100] = np.nan
    picture = overlay(images[0], aligned)
    enlarged = picture.shape[1] // 300
    outside = picture[:, : 100 * enlarged]
    assert (np.ptp(outside.astype(int), axis=-1) == 0).all()
    assert outside.max() <= 115


def test_checkerboard_alternates() -> None:
    low, high = np.full((80, 160), 1.0), np.full((80, 160), 5.0)
    for image in (low, high):
        image[:3, ::3], image[:3, 1::3] = 0.5, 10  # the same extremes in both, so that they are stretched alike
    board = checkerboard(image_of(low), image_of(high), tiles=8)
    enlarged = board.shape[0] // 80
    side = 20 * enlarged
    centres = board[side // 2 :: side, side // 2 :: side]
    rows, columns = np.indices(centres.shape)
    assert centres.shape == (4, 8)
    assert len(np.unique(centres[(rows + columns) % 2 == 0])) == 1
    assert (centres[(rows + columns) % 2 == 0] + 80 < centres[(rows + columns) % 2 == 1]).all()


def test_panels_are_reduced_and_at_most_doubled() -> None:
    rng = np.random.default_rng(0)
    large = image_of(rng.random((700, 1800)) + 1)
    small = image_of(rng.random((50, 60)) + 1)
    assert checkerboard(large, large).shape == (350, PANEL)
    assert overlay(small, small).shape == (100, 120, 3)


def test_aligned_image_of_another_shape_is_refused(images: tuple[Image, Image]) -> None:
    with pytest.raises(InputError, match="shape"):
        checkerboard(images[0], np.ones((10, 10)))


def test_single_pictures_are_written(tmp_path: Path, images: tuple[Image, Image]) -> None:
    draw_checkerboard(images[0], images[1], tmp_path / "board.png", tiles=6)
    draw_overlay(images[0], images[1].amplitude, tmp_path / "overlay.png")
    for name in ("board.png", "overlay.png"):
        assert read(tmp_path / name).shape[0] > 480
    assert sorted(p.name for p in tmp_path.iterdir()) == ["board.png", "overlay.png"]


def test_matches_show_accepted_and_rejected(tmp_path: Path, pair: SimulatedPair, images: tuple[Image, Image]) -> None:
    draw_matches(*images, registration_of(pair), tmp_path / "both.png")
    draw_matches(*images, registration_of(pair, wrong=0), tmp_path / "good.png")
    both, good = read(tmp_path / "both.png"), read(tmp_path / "good.png")
    assert both.shape[1] >= 2 * 600
    assert pixels_near(both, GOOD) > 500
    assert pixels_near(both, BAD) > 200
    assert pixels_near(good, GOOD) > 500
    assert pixels_near(good, BAD) == 0


def test_with_truth_only_what_the_last_filter_kept_is_drawn(
    tmp_path: Path, pair: SimulatedPair, images: tuple[Image, Image]
) -> None:
    result = registration_of(pair)
    draw_matches(*images, result, tmp_path / "plain.png")
    draw_matches(*images, result, tmp_path / "truth.png", truth=pair.truth)
    draw_matches(*images, result, tmp_path / "model.png", truth=Affine(pair.truth))
    plain, known = read(tmp_path / "plain.png"), read(tmp_path / "truth.png")
    assert 30 < pixels_near(known, BAD) < pixels_near(plain, BAD) / 3
    np.testing.assert_array_equal(known, read(tmp_path / "model.png"))


def test_a_point_is_drawn_at_its_place(tmp_path: Path) -> None:
    flat = image_of(np.ones((500, 500)))
    one = Registration(
        Matches(np.array([[100.0, 200.0]]), np.array([[300.0, 400.0]]), np.ones(1)),
        {},
        np.ones(1, bool),
        FailedFit("one point"),
        "unreliable",
        "one point",
    )
    draw_matches(flat, flat, one, tmp_path / "one.png")
    picture = read(tmp_path / "one.png")
    # the panels are 500 wide, 12 apart, at the foot of the sheet; below them are two margins of 6
    top = picture.shape[0] - 12 - 500
    for x, y in ((12 + 100, top + 200), (12 + 512 + 300, top + 400)):
        np.testing.assert_allclose(picture[y, x], GOOD, atol=6)


def test_a_refined_match_is_not_called_rejected(
    tmp_path: Path, pair: SimulatedPair, images: tuple[Image, Image]
) -> None:
    rough = registration_of(pair, wrong=0)
    finer = Matches(rough.matches.reference_xy, rough.matches.secondary_xy, rough.matches.score, origin=np.arange(60))
    new = np.arange(120) >= 60
    refined = registration_of(
        pair, matches=rough.matches.appended(finer), stages={"gms": ~new, "refine": new}, inliers=new
    )
    draw_matches(*images, refined, tmp_path / "refined.png")
    assert pixels_near(read(tmp_path / "refined.png"), BAD) == 0


def test_registration_picture_has_all_panels(tmp_path: Path, pair: SimulatedPair, images: tuple[Image, Image]) -> None:
    draw_registration(*images, registration_of(pair), tmp_path / "all.png", truth=pair.truth)
    draw_matches(*images, registration_of(pair), tmp_path / "matches.png")
    picture = read(tmp_path / "all.png")
    assert picture.shape[0] > read(tmp_path / "matches.png").shape[0] + 450
    assert picture.shape[1] == 2 * 600 + 3 * 12


def test_unreliable_registration_without_a_model_is_drawn(
    tmp_path: Path, pair: SimulatedPair, images: tuple[Image, Image]
) -> None:
    failed: dict[str, Any] = {
        "model": FailedFit("too few points"),
        "status": "unreliable",
        "inliers": np.zeros(90, bool),
    }
    short = registration_of(pair, reason="too few", **failed)
    long = registration_of(pair, reason="a long $reason, " * 30, **failed)
    draw_registration(*images, short, tmp_path / "short.png")
    draw_registration(*images, long, tmp_path / "long.png")
    a, b = read(tmp_path / "short.png"), read(tmp_path / "long.png")
    assert a.shape[0] < 700
    assert b.shape[0] > a.shape[0]
    assert b.shape[1] == a.shape[1]


def test_no_matches_at_all_is_drawn(tmp_path: Path, images: tuple[Image, Image]) -> None:
    empty = Registration(Matches.empty(), {}, np.zeros(0, bool), FailedFit("no points"), "unreliable", "no points")
    draw_registration(*images, empty, tmp_path / "empty.png")
    assert (tmp_path / "empty.png").exists()


def test_images_of_different_and_tiny_size(tmp_path: Path, pair: SimulatedPair) -> None:
    small, large = image_of(np.ones((30, 20)) + np.eye(30, 20)), image_of(pair.secondary)
    draw_matches(small, large, registration_of(pair), tmp_path / "odd.png")
    assert read(tmp_path / "odd.png").shape[1] >= 760


def test_same_result_same_file(tmp_path: Path, pair: SimulatedPair, images: tuple[Image, Image]) -> None:
    for name in ("a.png", "b.png"):
        draw_matches(*images, registration_of(pair), tmp_path / name, max_lines=20)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_chosen_points_cover_the_area_best_first() -> None:
    rng = np.random.default_rng(0)
    crowd = rng.uniform(0, 10, (5000, 2))
    rest = rng.uniform(0, 1000, (300, 2))
    xy, score = np.concatenate([crowd, rest]), rng.random(5300)
    rows = spread_out(xy, score, 100)
    assert len(rows) == 100
    assert len(np.unique(rows)) == 100
    assert (rows < 5000).sum() < 10
    sixteenths = np.bincount((xy[rows] // 250).astype(int) @ [4, 1], minlength=16)
    assert sixteenths.min() >= 2
    np.testing.assert_array_equal(spread_out(xy[:5], score[:5], 10), np.arange(5))
    same_cell = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_array_equal(spread_out(same_cell, np.array([0.1, 0.9, 0.5]), 1), [1])


@pytest.mark.parametrize(("name", "says"), [("missing/a.png", "does not exist"), ("a.jpg", r"\.png")])
def test_impossible_files_are_refused(
    tmp_path: Path, pair: SimulatedPair, images: tuple[Image, Image], name: str, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        draw_registration(*images, registration_of(pair), tmp_path / name)
    with pytest.raises(InputError, match=says):
        draw_overlay(*images, tmp_path / name)
    assert list(tmp_path.iterdir()) == []
