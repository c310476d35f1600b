"""Trust where images agree without showing one scene under one model: nothing there is "ok", no right one is lost."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import featreg
from featreg.geometry import Affine, Translation
from featreg.io import as_image
from featreg.pipeline import identical
from featreg.pipeline import identical_kernels as kernels
from featreg.pipeline.agreement import Agreement
from featreg.pipeline.competing import agreement_gates, rival_gate
from featreg.pipeline.identical import identical_pixels, without_identical
from featreg.pipeline.steps import Draft
from featreg.pipeline.structure import structural_drift
from featreg.pipeline.trust import Limits
from featreg.types import Matches

F32 = NDArray[np.float32]
SIDE = 400


def test_a_label_is_found_among_more_values_than_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    # Nearly all of the 300 values meet somewhere by chance, the label of a few dots is the last of them but one.
    monkeypatch.setattr(identical, "LEAST", 2)
    a, b = rng.integers(1, 301, (2, 600, 600)).astype(np.float32)
    dots = rng.random(a.shape) < 0.002
    a[dots] = b[dots] = 299
    _, counts = np.unique(a[a == b], return_counts=True)
    assert np.count_nonzero(counts >= identical.LEAST) > identical.MOST_VALUES
    found = identical._beyond_chance(a == b, a, b)
    assert found[dots].all()
    assert np.count_nonzero(found & ~dots) < 20


def scene(seed: int, side: int = SIDE) -> F32:
    """Ground of patches and bright targets."""
    rng = np.random.default_rng(seed)
    ground = sum(
        weight * gaussian_filter(rng.normal(0, 1, (side, side)), sigma) * sigma
        for sigma, weight in ((2.0, 0.5), (6.0, 0.8), (20.0, 0.7))
    )
    return np.asarray(60 * np.exp(ground), np.float32)


def seen(ground: F32, seed: int, looks: int = 4) -> F32:
    rng = np.random.default_rng([seed, 9])
    return np.asarray(ground * np.sqrt(rng.gamma(looks, 1 / looks, ground.shape)), np.float32)


def number(text: str, reason: str) -> float:
    found = re.search(rf"{text} ([+-]?[\d.]+)", reason)
    assert found, reason
    return float(found.group(1))


def marked(kind: str) -> NDArray[np.bool_]:
    drawing = np.zeros((SIDE, SIDE), np.uint8)
    if kind in ("frame and label", "frame"):
        cv2.rectangle(drawing, (6, 6), (393, 393), 255, 2)
    if kind in ("frame and label", "label"):
        cv2.putText(drawing, "SAR 2026", (20, 370), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 255, 3)
    if kind == "legend":
        for i in range(8):
            cv2.putText(drawing, f"class {i}", (250, 40 + 22 * i), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 1)
            cv2.rectangle(drawing, (225, 28 + 22 * i), (242, 42 + 22 * i), 255, -1)
    if kind == "dead pixels":
        drawing[np.random.default_rng(4).random(drawing.shape) < 0.01] = 255
    return drawing > 0


@pytest.mark.parametrize("kind", ["frame and label", "frame", "label", "legend", "dead pixels"])
@pytest.mark.parametrize("method", ["sar-orb", "rift"])
def test_what_stands_on_both_of_two_unrelated_images_does_not_vote(kind: str, method: str) -> None:
    mark = marked(kind)
    a, b = (np.where(mark, np.float32(900), seen(scene(s), s)) for s in (1, 2))
    found = identical_pixels(as_image(a), as_image(b))
    assert found is not None
    assert (found == mark).mean() > 0.999
    result = featreg.match(a, b, method=method)
    assert result.status == "unreliable"
    still = np.hypot(*(result.matches.secondary_xy - result.matches.reference_xy).T) <= 2
    assert not result.stages["identical"][still].any()


@pytest.mark.parametrize("quality", [95, 70])
@pytest.mark.parametrize("kind", ["frame and label", "legend"])
def test_what_was_drawn_before_compression_with_losses_is_found(kind: str, quality: int) -> None:
    mark = marked(kind)
    images: list[NDArray[np.uint8]] = []
    for seed in (1, 2):
        drawn = np.where(mark, 230, np.clip(seen(scene(seed), seed) / 4, 0, 255)).astype(np.uint8)
        coded = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        images.append(np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.uint8))
    assert (images[0] != images[1])[mark].mean() > 0.3
    found = identical_pixels(*(as_image(image) for image in images))
    assert found is not None
    assert found[mark].mean() > 0.9
    assert found[cv2.dilate(mark.view(np.uint8), np.ones((9, 9), np.uint8)) == 0].mean() < 0.01
    assert featreg.match(*images, method="rift").status == "unreliable"


def test_lakes_and_bright_fields_that_overlap_are_no_drawing() -> None:
    rng = np.random.default_rng(2)
    for value in (0.0, 900.0):
        images = []
        for seed in (1, 2):
            area = gaussian_filter(rng.normal(0, 1, (SIDE, SIDE)), 25)
            images.append(np.where(area > np.quantile(area, 0.75), np.float32(value), seen(scene(seed), seed)))
        both = (images[0] == value) & (images[1] == value)
        assert both.sum() > 2000
        found = identical_pixels(*(as_image(image, nodata=-1) for image in images))
        assert found is None or (found & both).sum() < 0.5 * both.sum()


@pytest.mark.parametrize("method", ["rift-paper", "sift", "sar-dense"])
def test_tie_points_do_not_slide_along_a_frame(method: str) -> None:
    """Both of their ends lay on the drawing, at different places."""
    mark = marked("frame and label")
    result = featreg.match(*(np.where(mark, np.float32(900), seen(scene(s), s)) for s in (3, 4)), method=method)
    assert result.status == "unreliable"
    for xy in (result.matches.reference_xy, result.matches.secondary_xy):
        column, row = np.clip(np.rint(xy), 0, SIDE - 1).astype(int).T
        assert not mark[row, column].any()


def test_what_may_be_drawn_is_told_pixel_by_pixel() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.gamma(1, 1, (2, 40, 53)).astype(np.float32)
    second[:20] = first[:20]
    mask, bits = rng.random(first.shape) > 0.1, np.empty(first.shape, np.uint8)
    dark, grey, white, noise = (np.float32(value) for value in (0.2, 1.5, 3, 0.1))
    counts = np.empty(3, np.int64)
    kernels.drawable(first, second, mask, dark, grey, white, noise, bits, counts)
    less, more = np.minimum(first, second), np.maximum(first, second)
    expected = {
        kernels.DARK_BOTH: more <= dark,
        kernels.DARK_EITHER: less <= dark,
        kernels.DARK_FIRST: first <= dark,
        kernels.DARK_SECOND: second <= dark,
        kernels.WHITE_BOTH: less >= white,
        kernels.WHITE_EITHER: more >= white,
        kernels.GREY_BOTH: (less >= grey) & (more - less <= noise),
        kernels.GREY_EITHER: more >= grey,
    }
    for bit, where in expected.items():
        assert (mask & where).any()
        np.testing.assert_array_equal((bits & np.uint8(bit)) > 0, mask & where)
    both = (kernels.DARK_BOTH, kernels.WHITE_BOTH, kernels.GREY_BOTH)
    assert counts.tolist() == [(mask & expected[bit]).sum() for bit in both]


def test_equal_pixels_are_counted_and_the_highest_found() -> None:
    rng = np.random.default_rng(4)
    first, second = rng.integers(0, 9, (2, 40, 53)).astype(np.float32)
    mask, highest = rng.random(first.shape) > 0.1, np.empty(53, np.float32)
    mask[:, 7] = False
    second[3, 5] = 90.0
    for found in (mask, mask & (second < 90)):
        assert kernels.surveyed(first, second, found, highest) == ((first == second) & found).sum()
        np.testing.assert_array_equal(highest, (np.maximum(first, second) * found).max(axis=0))


def test_drawings_are_compared_in_the_squares_around_what_they_share() -> None:
    rng = np.random.default_rng(5)
    grey_both, grey = np.uint8(kernels.GREY_BOTH), np.uint8(kernels.GREY_EITHER)
    bits = np.zeros((60, 71), np.uint8)
    bits[rng.random(bits.shape) < 0.1] |= grey
    bits[:30][rng.random((30, 71)) < 0.4] |= grey_both | grey
    bits[40:, 20:50] |= grey_both | grey
    found, counts = np.ones(bits.shape, np.uint8), np.empty(2, np.int64)
    both, either = ((bits & bit) > 0 for bit in (grey_both, grey))
    shared, total = (
        cv2.boxFilter(which.astype(np.float32), -1, (15, 15), normalize=False, borderType=cv2.BORDER_CONSTANT)
        for which in (both, either)
    )
    assert shared.max() == 225
    places = kernels.GREY_BOTH, kernels.GREY_EITHER
    kernels.alike_around(bits.ravel(), 71, *places, 12, np.float32(0.9), 80, found.ravel(), counts)
    looked = both & (shared >= 12)
    alike = looked & (shared >= np.float32(0.9) * total)
    np.testing.assert_array_equal(found > 0, alike)
    outline = looked & (shared <= 80)
    assert counts.tolist() == [outline.sum(), (alike & outline).sum()]
    assert 0 < alike.sum() < looked.sum()


def test_only_the_drawing_and_its_rim_become_invalid() -> None:
    mark = marked("frame and label") | (np.random.default_rng(4).random((SIDE, SIDE)) < 0.002)
    a, b = (as_image(np.where(mark, np.float32(900), seen(scene(s), s))) for s in (3, 4))
    same = identical_pixels(a, b)
    assert same is not None
    for image in without_identical(a, b, same):
        assert not image.mask[mark].any()
        assert (image.pixels[image.mask] < 900).all()
        rim = cv2.dilate(mark.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
        assert image.mask[~rim].all()
        # Single dead pixels have no rim.
        assert np.count_nonzero(~image.mask) < 1.1 * np.count_nonzero(rim & ~mark) + np.count_nonzero(mark)
    everything = np.ones_like(same)
    assert without_identical(a, b, everything)[0] is a


def test_large_structures_that_overlap_themselves_are_no_agreement_of_the_surroundings() -> None:
    """A scene moved by less than its fields are wide, and a label that was not."""
    rng = np.random.default_rng(12)
    broad = gaussian_filter(rng.normal(0, 1, (440, 440)), 12)
    ground = np.asarray(60 * np.exp(0.8 * broad / broad.std()), np.float32)
    mark = marked("frame and label")
    for moved, marks in ((16, True), (0, False)):
        there = ground[moved : SIDE + moved, moved : SIDE + moved]
        images = [np.where(mark, np.float32(900), seen(g, s)) for g, s in ((ground[:SIDE, :SIDE], 1), (there, 2))]
        assert (identical_pixels(*(as_image(image) for image in images)) is not None) == marks


def test_a_fixed_pattern_on_unrelated_images_does_not_vote() -> None:
    gain = np.random.default_rng(3).normal(1, 0.5, (SIDE, SIDE)).clip(0.2, 3)
    a, b = ((seen(scene(s), s) * gain).astype(np.float32) for s in (1, 2))
    found = identical_pixels(as_image(a), as_image(b))
    assert found is not None
    assert found.all()
    assert featreg.match(a, b).status == "unreliable"


@pytest.mark.parametrize("method", ["sar-orb", "akaze"])
def test_a_logo_at_two_places_of_unrelated_images_is_not_the_scene(method: str) -> None:
    rng = np.random.default_rng(0)
    logo = np.zeros((110, 110), np.uint8)
    for _ in range(7):
        centre = [int(v) for v in rng.integers(15, 95, 2)]
        cv2.circle(logo, centre, int(rng.integers(4, 14)), int(rng.integers(90, 255)), int(rng.choice([-1, 2])))
    cv2.putText(logo, "LOGO", (8, 90), cv2.FONT_HERSHEY_SIMPLEX, 1.0, 255, 3)
    images = []
    for seed, (y, x) in ((1, (20, 30)), (2, (150, 200))):
        image = seen(scene(seed), seed)
        image[y : y + 110, x : x + 110] = logo
        images.append(image)
    result = featreg.match(*images, method=method)
    assert result.status == "unreliable"
    assert "scene" in result.reason


@pytest.mark.parametrize("method", ["sar-orb", "rift"])
def test_half_of_the_scene_moved_is_two_motions(method: str) -> None:
    ground = scene(5)
    moved = ground.copy()
    moved[:, 200:] = np.roll(ground, 8, 0)[:, 200:]
    result = featreg.match(seen(ground, 1), seen(moved, 2), method=method)
    assert result.status == "unreliable"
    words = next(part for part in result.reason.split("; ") if "two motions" in part)
    points = number("two motions,", words)
    assert 100 < points <= len(result.matches)
    # Either half may be the one that the words call moved.
    sign = 1 if "right part" in words else -1
    assert ("left part" in words) == (sign < 0)
    assert number("dx", words) == pytest.approx(0, abs=1)
    assert number("dy", words) == pytest.approx(sign * 8, abs=1)


def test_a_small_part_that_moved_leaves_the_model_and_is_told() -> None:
    ground = scene(5)
    moved = ground.copy()
    moved[250:330, 200:300] = np.roll(ground, 8, 0)[250:330, 200:300]
    result = featreg.match(seen(ground, 1), seen(moved, 2))
    assert result.status == "ok"
    assert result.gates["local"].value is not None
    assert result.model
    assert result.model(np.array([[150.0, 150.0]]))[0] == pytest.approx([150, 150], abs=0.3)
    assert result.gates["rival"].value == pytest.approx(0.05, abs=0.05)
    assert "agree on another model" in result.gates["rival"].meaning


@pytest.mark.parametrize("method", ["sar-orb", "sift"])
def test_two_scenes_in_one_exposure_are_rivals(method: str) -> None:
    ground = scene(6)
    both = 0.5 * ground + 0.5 * np.roll(ground, (24, 18), (0, 1))
    result = featreg.match(seen(ground, 1), seen(np.asarray(both, np.float32), 2), method=method)
    assert result.status == "unreliable"


@pytest.mark.parametrize(("period", "most"), [(25, 600), (40, 600), (40, 50)])
def test_a_scene_that_repeats_has_no_one_model(period: int, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Judged by the images themselves: matchers mostly find no consensus here in the first place."""
    tile = gaussian_filter(np.random.default_rng(7).uniform(20, 160, (period, period)), 2, mode="wrap")
    ground = np.tile(tile, (SIDE // period + 1,) * 2)[:SIDE, :SIDE].astype(np.float32)
    a, b = seen(ground, 1), seen(np.roll(ground, period, 0), 2)
    # Larger images than so many samples are looked at by coarser ones.
    monkeypatch.setattr("featreg.pipeline.agreement.MOST_WHOLE", most)
    agreement = Agreement.of(as_image(a), as_image(b), Translation(0, 0))
    assert agreement is not None
    model, other, shift, _ = agreement.whole
    assert other > 0.7 * model
    assert min(abs(abs(s) % period - p) for s in shift for p in (0, period)) < (5 if most == 600 else 9)
    assert featreg.match(a, b).status == "unreliable"


@pytest.mark.parametrize("method", ["rift", "rift-paper", "sar-orb"])
def test_one_ringing_spot_is_one_tie_point(method: str) -> None:
    spot = np.full((200, 200), 7, np.uint8)
    spot[100:103, 90:93] = 70
    result = featreg.match(spot, np.roll(spot, (3, 5), (0, 1)), method=method)
    if result.status == "ok":
        assert result.model
        assert result.model(np.array([[91.0, 101.0], [20, 20]])) == pytest.approx(
            np.array([[96, 104], [25, 23]]), abs=1
        )


@pytest.mark.parametrize("ships", [1, 2, 6])
@pytest.mark.parametrize("method", ["rift", "rift-paper"])
def test_ships_on_a_quiet_sea_are_few_tie_points(method: str, ships: int) -> None:
    """Samples of a few grey levels: the ringing around each ship is everywhere, and half a turn leaves it the same."""
    rng = np.random.default_rng(ships)
    images = []
    centres = rng.integers(30, 170, (ships, 2))
    for dx, dy in ((0, 0), (5, 3)):
        sea = np.rint(6 * np.sqrt(rng.gamma(30, 1 / 30, (200, 200)))).astype(np.uint8)
        for x, y in centres:
            cv2.rectangle(sea, (int(x) + dx, int(y) + dy), (int(x) + dx + 3, int(y) + dy + 2), 70, -1)
        images.append(sea)
    result = featreg.match(*images, method=method)
    if result.status == "ok":
        assert result.model
        here = np.array([[20.0, 20], [180, 20], [100, 180]])
        assert result.model(here) == pytest.approx(here + np.array([5, 3]), abs=1)


def test_where_the_refinement_found_nothing_less_may_speak_against_a_model() -> None:
    ground = scene(5)
    moved = ground.copy()
    moved[60:160, 60:160] = np.roll(ground, 8, 0)[60:160, 60:160]
    a, b = as_image(seen(ground, 1)), as_image(seen(moved, 2))
    rng = np.random.default_rng(0)
    here = rng.uniform(10, 390, (300, 2))
    matches = Matches(here, here, np.ones(300))
    every = np.ones(300, np.bool_)
    limits = Limits()
    for useful in (True, False):
        stages = {"fsc": every, "refine": every & useful}
        draft = Draft(matches, stages, every, every, every, Translation(0, 0))
        gates, _ = agreement_gates(draft, a, b, limits, refined=useful)
        share = 1.0 if useful else 0.5
        assert gates["local"].high == share * limits.local
        assert ("the refinement found nothing" in gates["local"].meaning) == (not useful)
        assert rival_gate(draft, (a.shape, b.shape), limits, 0)["rival"].high == share * limits.rival
        assert gates["local"].value is not None
        assert gates["local"].value > 0.05


@pytest.mark.parametrize("seed", [1, 2])
def test_relief_under_an_affine_model_is_named_with_its_cures(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bend = [gaussian_filter(rng.normal(0, 1, (SIDE, SIDE)), 40, mode="wrap") for _ in range(2)]
    dx, dy = (amplitude * f / np.abs(f).max() for amplitude, f in zip((10, 3), bend, strict=True))
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    ground = scene(8)
    at = [(grid + by).astype(np.float32) for grid, by in ((x, dx), (y, dy))]
    warped = cv2.remap(ground, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    result = featreg.match(seen(ground, 1, 8), seen(np.asarray(warped, np.float32), 2, 8))
    assert result.status == "unreliable"
    assert "local" in result.reason
    assert all(word in result.reason for word in ("relief", "residual-field", "rpc-bias", "blocks"))


@pytest.mark.parametrize(
    "case", ["itself", "crop", "shifted", "fresh speckle", "labelled", "labelled and shifted", "dead"]
)
def test_images_of_one_scene_stay_ok(case: str) -> None:
    ground = scene(9, 460)
    first = seen(ground, 1)
    here = first[:SIDE, :SIDE]
    there, shift = {
        "itself": (here, (0, 0)),
        "crop": (here[40:340, 60:380], (-60, -40)),
        "shifted": (first[17 : SIDE + 17, 23 : SIDE + 23], (-23, -17)),
        "fresh speckle": (seen(ground, 2)[:SIDE, :SIDE], (0, 0)),
        "labelled": (seen(ground, 2)[:SIDE, :SIDE], (0, 0)),
        "labelled and shifted": (seen(ground, 2)[37 : SIDE + 37, 43 : SIDE + 43], (-43, -37)),
        "dead": (seen(ground, 2)[17 : SIDE + 17, 23 : SIDE + 23], (-23, -17)),
    }[case]
    if "label" in case or case == "dead":
        mark = marked("legend") if "label" in case else np.random.default_rng(4).random((SIDE, SIDE)) < 0.004
        here, there = (np.where(mark, np.float32(900), image) for image in (here, there))
    result = featreg.match(here, np.ascontiguousarray(there))
    assert result.status == "ok", result.reason
    assert result.model
    assert result.model(np.array([[150.0, 150.0]]))[0] - [150, 150] == pytest.approx(shift, abs=0.3)


def test_windows_that_drift_together_tell_a_model_that_is_right_in_one_part_only() -> None:
    ground = scene(10)
    a, b = as_image(seen(ground, 1)), as_image(seen(ground, 2))
    # A stretch of 3 % about (80, 80), where it is right.
    stretched = Affine(np.array([[1.03, 0.0, -0.03 * 80], [0.0, 1.03, -0.03 * 80]]))
    right, wrong, other = (Agreement.of(a, b, model) for model in (Translation(0, 0), stretched, Translation(40, 30)))
    assert right
    assert wrong
    assert other
    here = wrong.windows.xy[wrong.windows.peaked]
    expected = np.sqrt(((stretched(here) - here) ** 2).sum(axis=1).mean()) / 1.03
    assert expected > 4
    assert wrong.windows.drift == pytest.approx(expected, rel=0.1)
    assert right.windows.drift == pytest.approx(0, abs=0.3)
    assert right.windows.log10_chance(6) < -20
    assert other.windows.log10_chance(6) > -2
    # The more a model can do, the more windows follow one by chance.
    assert right.windows.log10_chance(12) > right.windows.log10_chance(6)


def test_structure_tells_how_far_a_model_is_off_where_intensities_cannot_be_compared() -> None:
    ground = scene(10)
    smooth = gaussian_filter(ground, 2)
    # Bright is dark, as between sensors of another kind.
    a, b = as_image(seen(ground, 1)), as_image(np.float32(smooth.mean() ** 2) / (smooth + 0.1 * smooth.mean()))
    right, turned = Affine(np.eye(3)[:2]), Affine(np.array([[1.0, -0.03, 0.03 * 199.5], [0.03, 1.0, -0.03 * 199.5]]))
    there = structural_drift(a, b, right)
    away = structural_drift(a, b, turned)
    assert there is not None
    assert away is not None
    assert there[1] == pytest.approx(SIDE / 256, rel=0.01)
    assert there[0] < there[1]
    x, y = np.meshgrid(np.linspace(30, 370, 9), np.linspace(30, 370, 9))
    grid = np.column_stack([x.ravel(), y.ravel()])
    expected = np.sqrt(((turned(grid) - grid) ** 2).sum(axis=1).mean())
    assert away[0] == pytest.approx(expected, rel=0.25)
    assert structural_drift(a, b, Translation(390, 0)) is None

    rng = np.random.default_rng(0)
    here, every = rng.uniform(10, 390, (300, 2)), np.ones(300, np.bool_)
    for model, passed in ((right, True), (turned, False)):
        draft = Draft(Matches(here, model(here), np.ones(300)), {"fsc": every}, every, every, every, model)
        gate = agreement_gates(draft, a, b, Limits(structure_px=3.0))[0]["structure"]
        assert gate.passed is passed
        assert gate.high == pytest.approx(3.0 * there[1], rel=0.01)
    assert "structure" not in agreement_gates(draft, a, b, Limits())[0]
