"""Labels, frames and patterns that two scenes have in common at one place are no data for their blocks."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.io import as_image
from featreg.io.excerpt import together
from featreg.io.raster_source import ImageSource, Window
from featreg.pipeline.identical import identical_pixels
from featreg.scene.drawn import moving, without_drawn
from featreg.simulate import sar_pair
from featreg.types import Matches

SIDE = 560
WHITE = np.float32(40)


def labelled(image: NDArray[Any]) -> NDArray[np.float32]:
    """The image with numbers all over it, in one grey value."""
    drawn, rng = np.zeros(image.shape, np.uint8), np.random.default_rng(3)
    for number in range(24):
        x, y = (int(n) for n in rng.integers(10, SIDE - 70, 2))
        cv2.putText(drawn, str(100 + 7 * number), (x, y + 30), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 255, 2)
    return np.where(drawn > 0, WHITE, np.minimum(image, WHITE)).astype(np.float32)


@pytest.fixture(scope="module")
def places() -> list[NDArray[np.float32]]:
    return [sar_pair((SIDE, SIDE), looks=4, seed=seed).reference for seed in (1, 501)]


def sources(*images: NDArray[np.float32]) -> list[ImageSource]:
    return [ImageSource(as_image(image)) for image in images]


def test_windows_lose_what_is_drawn_at_their_own_place_in_the_scene(places: list[NDArray[np.float32]]) -> None:
    first, second = sources(*map(labelled, places))
    here, there = Window(100, 60, 300, 300), Window(140, 30, 320, 310)
    seen, seen_there = first.read(here), second.read(there)
    reference, secondary, share = without_drawn(first, second, here, there, seen, seen_there)
    for before, after in ((seen, reference), (seen_there, secondary)):
        white = before.pixels == WHITE
        assert white.any()
        # Speckle reaches the same white here and there.
        assert after.mask[white].mean() < 1e-3
        assert after.mask.mean() > 0.8
    assert share is not None
    assert share == pytest.approx((seen.pixels == WHITE).mean(), rel=0.3)


def test_what_is_drawn_on_one_of_two_windows_alone_is_told_of(places: list[NDArray[np.float32]]) -> None:
    first, second = sources(*(np.where(np.arange(SIDE) < 200, image, labelled(image)) for image in places))
    here, there = Window(0, 0, 200, 560), Window(100, 0, 300, 560)
    seen, seen_there = first.read(here), second.read(there)
    reference, secondary, share = without_drawn(first, second, here, there, seen, seen_there)
    assert reference is seen
    assert share is not None
    assert share == pytest.approx((seen_there.pixels == WHITE).mean(), rel=0.3)
    assert secondary.mask.mean() < 1 - share / 2


def test_what_is_drawn_beside_both_windows_is_not_told_of(places: list[NDArray[np.float32]]) -> None:
    here, there = Window(0, 0, 300, 300), Window(60, 60, 300, 300)
    around = together(here, there)
    assert around is not None
    drawn, corner = np.zeros((SIDE, SIDE), np.uint8), np.s_[:60, 300:360]
    cv2.putText(drawn, "12", (306, 44), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 255, 2)
    first, second = sources(*(np.where(drawn > 0, WHITE, np.minimum(image, WHITE)) for image in places))
    same = identical_pixels(first.read(around), second.read(around))
    assert same is not None
    assert same[corner].any()
    seen, seen_there = first.read(here), second.read(there)
    reference, secondary, share = without_drawn(first, second, here, there, seen, seen_there)
    assert (reference, secondary, share) == (seen, seen_there, None)


def test_scenes_of_one_place_or_of_two_sizes_are_left_as_they_are(places: list[NDArray[np.float32]]) -> None:
    here = Window(100, 60, 300, 300)
    for first, second in (sources(*map(labelled, places[:1] * 2)), sources(labelled(places[0]), places[1][:-9])):
        seen, seen_there = first.read(here), second.read(here)
        reference, secondary, share = without_drawn(first, second, here, here, seen, seen_there)
        assert (reference, secondary, share) == (seen, seen_there, None)


def test_tie_points_that_stand_still_in_the_scenes_are_told() -> None:
    here, there = Window(100, 60, 50, 50), Window(90, 70, 50, 50)
    xy = np.array([[20.0, 20.0], [20.0, 20.0]])
    found = moving(Matches(xy, np.array([[30.0, 10.0], [20.0, 20.0]]), np.ones(2)), here, there)
    assert found.tolist() == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["sar-orb", "sar-dense"])
def test_labels_on_two_places_are_no_scene(places: list[NDArray[np.float32]], method: str) -> None:
    how: Any = {"method": method, "block": 280, "workers": 1, "initial": np.eye(3), "search_radius": 30.0}
    other = featreg.match(*map(labelled, places), **how)
    assert other.status == "unreliable"
    pair = sar_pair((SIDE, SIDE), looks=4, rotation_deg=0.2, scale=1.0, shift=(16.0, -11.0), change=0.0, seed=1)
    same = featreg.match(labelled(pair.reference), labelled(pair.secondary), **how)
    assert same.status == "ok", same.reason
    assert featreg.evaluate(same, pair.truth).grid_rmse < 0.3
