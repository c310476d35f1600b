"""What stands on both of two images, frames, labels, fixed patterns, does not vote."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import featreg
from featreg.io import as_image
from featreg.pipeline import identical
from featreg.pipeline import identical_kernels as kernels
from featreg.pipeline.identical import identical_pixels, without_identical
from made.patchy_ground import SIDE, marked, patchy_ground, seen


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


@pytest.mark.parametrize("kind", ["frame and label", "frame", "label", "legend", "dead pixels"])
@pytest.mark.parametrize("method", ["sar-orb", "rift"])
def test_what_stands_on_both_of_two_unrelated_images_does_not_vote(kind: str, method: str) -> None:
    mark = marked(kind)
    a, b = (np.where(mark, np.float32(900), seen(patchy_ground(s), s)) for s in (1, 2))
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
        drawn = np.where(mark, 230, np.clip(seen(patchy_ground(seed), seed) / 4, 0, 255)).astype(np.uint8)
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
            images.append(np.where(area > np.quantile(area, 0.75), np.float32(value), seen(patchy_ground(seed), seed)))
        both = (images[0] == value) & (images[1] == value)
        assert both.sum() > 2000
        found = identical_pixels(*(as_image(image, nodata=-1) for image in images))
        assert found is None or (found & both).sum() < 0.5 * both.sum()


@pytest.mark.parametrize("method", ["rift-paper", "sift", "sar-dense"])
def test_tie_points_do_not_slide_along_a_frame(method: str) -> None:
    """Both of their ends lay on the drawing, at different places."""
    mark = marked("frame and label")
    result = featreg.match(*(np.where(mark, np.float32(900), seen(patchy_ground(s), s)) for s in (3, 4)), method=method)
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
    a, b = (as_image(np.where(mark, np.float32(900), seen(patchy_ground(s), s))) for s in (3, 4))
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
    a, b = ((seen(patchy_ground(s), s) * gain).astype(np.float32) for s in (1, 2))
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
        image = seen(patchy_ground(seed), seed)
        image[y : y + 110, x : x + 110] = logo
        images.append(image)
    result = featreg.match(*images, method=method)
    assert result.status == "unreliable"
    assert "scene" in result.reason
