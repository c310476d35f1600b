"""SAR-OFAST: edge pyramid, shares of the levels, sub-pixel positions, masks, and parameters that are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import InputError, ParameterError
from featreg.io import as_image
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.sar.pyramid import SMALLEST, clear, pyramid, to_base
from featreg.simulate import sar_pair
from featreg.types import Features, Image

Texture = Callable[..., NDArray[np.float32]]


def detect(picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", "sar-ofast", **parameters).detect_features(picture)


def true_clearance(mask: NDArray[np.bool_], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exact distance of each point to the centre of the nearest invalid pixel."""
    y, x = np.nonzero(~mask)
    return np.asarray(np.hypot(xy[:, None, 0] - x, xy[:, None, 1] - y).min(axis=1))


# Pyramid


def test_levels_shrink_by_the_factor_until_they_are_too_small(sar_texture: Texture) -> None:
    chain = pyramid(as_image(sar_texture(100, 140)), 20, 1.25)
    shapes = [level.shape for level in chain]
    assert shapes[:3] == [(100, 140), (80, 112), (64, 90)]
    assert min(shapes[-1]) >= SMALLEST
    assert min(shapes[-1]) / 1.25 < SMALLEST


def test_levels_lie_on_each_other(sar_texture: Texture) -> None:
    """A ramp keeps its values at the mapped places, so no level is shifted by half a pixel."""
    y, x = np.mgrid[:150, :170].astype(np.float32)
    for ramp in (x + 1, y + 1):
        base = as_image(ramp)
        for level in pyramid(base, 8, 1.2):
            rows, columns = np.mgrid[5 : level.shape[0] - 5, 5 : level.shape[1] - 5]
            at = to_base(np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64), level, base)
            wanted = (at[:, 0] if ramp is not None and ramp[0, 1] != ramp[0, 0] else at[:, 1]) + 1
            np.testing.assert_allclose(level.amplitude[5:-5, 5:-5].ravel(), wanted, atol=0.02)


def test_a_level_averages_valid_pixels_only(sar_texture: Texture) -> None:
    amplitude = sar_texture(120, 120) + 1
    mask = np.ones(amplitude.shape, np.bool_)
    mask[40:60, 30:70] = False
    for level in pyramid(as_image(amplitude, mask=mask), 6, 1.2):
        valid = level.amplitude[level.mask]
        assert valid.min() >= amplitude[mask].min() * 0.999
        assert not level.amplitude[~level.mask].any()
        assert 0 < (~level.mask).mean() < 0.25


@pytest.mark.parametrize("radius", [1.0, 5.0, 12.5])
@pytest.mark.parametrize("masked", [False, True])
def test_clear_is_where_a_disc_touches_nothing_invalid(masked: bool, radius: float) -> None:
    mask = np.ones((60, 70), np.bool_)
    if masked:
        mask[20:24, 30:40] = False
    y, x = np.mgrid[:60, :70]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    distance = true_clearance(np.pad(mask, 1), points + 1).reshape(mask.shape)
    found = clear(Image(mask.astype(np.float32), mask), radius)
    assert not found[distance < radius].any()
    assert found[distance > radius * np.sqrt(2) + 1].all()


# Detector


@pytest.mark.parametrize("n_features", [1, 2, 7, 100, 100000])
def test_the_budget_is_kept_and_the_best_come_first(sar_texture: Texture, n_features: int) -> None:
    found = detect(as_image(sar_texture()), n_features=n_features)
    assert 0 < len(found) <= n_features
    assert (np.diff(found.score) <= 0).all()


def test_scores_are_above_the_threshold(sar_texture: Texture) -> None:
    picture = as_image(sar_texture())
    low, high = detect(picture, threshold=10), detect(picture, threshold=60)
    assert low.score.min() > 10
    assert high.score.min() > 60
    assert 0 < len(high) < len(low)


def test_points_of_a_level_are_as_many_times_larger_as_the_level_is_smaller(sar_texture: Texture) -> None:
    found = detect(as_image(sar_texture(300, 300)), factor=1.2, levels=5)
    assert set(found.level) == set(range(5))
    for level in range(5):
        scale = found.scale[found.level == level]
        np.testing.assert_allclose(scale, scale[0])
        assert scale[0] == pytest.approx(20.0 * 1.2**level, rel=0.01)


def test_each_level_uses_its_own_edge_map(sar_texture: Texture) -> None:
    """2.3.2: what is found on level n of an image is what is found on the first level of that level's image."""
    picture = as_image(sar_texture(200, 220))
    plenty = {"n_features": 10**6, "subpixel": "none"}
    found = detect(picture, levels=3, **plenty)
    level = pyramid(picture, 3, 1.2)[2]
    alone = detect(Image(np.array(level.amplitude), np.array(level.mask)), levels=1, **plenty)
    on_level = found.take(found.level == 2)
    np.testing.assert_allclose(
        sorted(map(tuple, np.round(on_level.xy, 6))), sorted(map(tuple, np.round(to_base(alone.xy, level, picture), 6)))
    )


@pytest.mark.parametrize("subpixel", ["centroid", "corner", "none"])
def test_sub_pixel_positions_stay_near_their_pixel(sar_texture: Texture, subpixel: str) -> None:
    picture = as_image(sar_texture())
    plenty: dict[str, Any] = {"levels": 1, "n_features": 10**6}
    whole, moved = detect(picture, subpixel="none", **plenty), detect(picture, subpixel=subpixel, **plenty)
    shift = np.hypot(*(moved.xy - whole.xy).T)
    assert shift.max() <= 2.0 + 1e-9
    assert (shift.max() > 0.1) == (subpixel != "none")
    assert moved.subpixel is not None
    np.testing.assert_array_equal(shift[~moved.subpixel], 0)


def test_points_follow_a_scene_that_moves_by_a_fraction_of_a_pixel(sar_texture: Texture) -> None:
    from scipy.ndimage import fourier_shift, gaussian_filter

    shift = np.array([0.4, -0.3])
    smooth = gaussian_filter(sar_texture(240, 240).astype(np.float64), 1.2, mode="wrap")
    moved = np.maximum(np.fft.ifft2(fourier_shift(np.fft.fft2(smooth), shift[::-1])).real, 0)
    error = {}
    for subpixel in ("centroid", "corner", "none"):
        a, b = (detect(as_image(v), levels=1, subpixel=subpixel).xy for v in (smooth, moved))
        apart = np.hypot(*(a[:, None] + shift - b[None]).transpose(2, 0, 1))
        partner = apart.argmin(axis=1)
        near = apart[np.arange(len(a)), partner] < 1.5
        assert near.mean() > 0.6
        found = (b[partner] - a)[near]
        error[subpixel] = float(np.hypot(*(found - shift).T).mean())
        np.testing.assert_allclose(found.mean(axis=0), shift, atol=0.1)
    assert error["centroid"] < 0.8 * error["none"]


def test_no_support_touches_nodata_or_leaves_the_image(sar_texture: Texture) -> None:
    amplitude = sar_texture(260, 260)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[100:130, 120:150] = False
    mask[:, :30] = False
    found = detect(as_image(amplitude, mask=mask))
    assert len(found) > 50
    assert (true_clearance(np.pad(mask, 1), found.xy + 1) >= found.scale).all()


def test_what_lies_under_the_mask_has_no_influence(sar_texture: Texture) -> None:
    amplitude = sar_texture()
    mask = np.ones(amplitude.shape, np.bool_)
    mask[80:110, 90:120] = False
    other = np.where(mask, amplitude, 50)
    first, second = (detect(as_image(a, mask=mask)) for a in (amplitude, other))
    np.testing.assert_array_equal(first.xy, second.xy)
    np.testing.assert_array_equal(first.angle, second.angle)


@pytest.mark.parametrize(
    "parameters",
    [
        {"n_features": 0},
        {"levels": 0},
        {"factor": 1.0},
        {"factor": float("nan")},
        {"quota_decay": 0.5},
        {"edge": "sobel"},
        {"subpixel": "parabola"},
        {"alpha": 0.0},
        {"alpha": float("nan")},
        {"floor": -1.0},
        {"threshold": -1},
        {"threshold": 255},
        {"support": -1.0},
        {"sigma": 0.0},
        {"sigma": float("nan")},
    ],
    ids=str,
)
def test_impossible_parameters_are_refused_when_the_detector_is_made(parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create("detector", "sar-ofast", **parameters)


@pytest.mark.parametrize("centroid", ["amplitude", "edges"])
def test_directions_of_some_keypoints_are_those_of_all(sar_texture: Texture, centroid: str) -> None:
    picture = as_image(sar_texture(200, 220))
    detector = registry.create("detector", "sar-ofast", n_features=300, levels=3, centroid=centroid)
    found, places = detector.detect_features(picture), detector.detect_places(as_image(sar_texture(200, 220)))
    np.testing.assert_array_equal(places.xy, found.xy)
    rows = np.arange(0, len(found), 7)
    assert len(np.unique(found.angle)) > 200
    np.testing.assert_array_equal(detector.oriented(picture, places.take(rows)).angle, found.angle[rows])


def test_keypoints_of_levels_that_an_image_does_not_have_are_refused(sar_texture: Texture) -> None:
    picture = as_image(sar_texture(100, 110))
    detector = registry.create("detector", "sar-ofast", n_features=50)
    found = detector.detect_places(picture)
    with pytest.raises(InputError, match=r"level 40 .* end with 6"):
        detector.oriented(picture, found.having(level=40))


# Levels that are not searched


@pytest.mark.parametrize(("n_features", "wanted"), [(1000, 0), (186, 0), (180, 1), (108, 2), (50, 2)])
def test_finer_levels_are_not_searched_where_keypoints_are_few_beside_the_pixels(
    sar_texture: Texture, n_features: int, wanted: int
) -> None:
    """165 x 170 pixels are 28 050, of which a level of 1.3 keeps 1 / 1.69: 90 for each of 184 keypoints."""
    found = detect(as_image(sar_texture(165, 170)), n_features=n_features, levels=3, factor=1.3, skip=2)
    assert set(found.level) == {wanted, wanted + 1, wanted + 2}
    for level in set(found.level):
        assert found.scale[found.level == level][0] == pytest.approx(20 * 1.3**level, rel=0.01)


def test_levels_that_are_searched_are_those_of_the_whole_pyramid(sar_texture: Texture) -> None:
    picture = as_image(sar_texture(200, 220))
    plenty = {"n_features": 10**6, "factor": 1.3}
    everything = detect(picture, levels=4, **plenty)
    some = detect(picture, n_features=150, levels=2, factor=1.3, skip=2)
    assert set(some.level) == {2, 3}
    assert set(map(tuple, some.xy)) <= set(map(tuple, everything.take(everything.level >= 2).xy))


def test_no_level_is_skipped_for_which_there_is_no_coarser_one(sar_texture: Texture) -> None:
    found = detect(as_image(sar_texture(90, 90)), n_features=10, levels=5, factor=1.25, skip=3)
    assert found.level.min() == 0


@pytest.mark.parametrize(("height", "wanted"), [(75, 0), (80, 0), (100, 1), (129, 2)])
def test_no_level_is_skipped_for_one_without_room_for_a_corner(sar_texture: Texture, height: int, wanted: int) -> None:
    """The last of three levels of 1.3 is to be higher than 44 pixels: those of 22 on either side hold no corner."""
    found = detect(as_image(sar_texture(height, 400)), n_features=20, levels=3, factor=1.3, skip=2)
    assert found.level.min() == wanted
    assert found.level.max() == wanted + 2 if wanted else found.level.max() <= 2


def test_pixels_without_data_do_not_count(sar_texture: Texture) -> None:
    amplitude = sar_texture(165, 170)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[:60] = False
    parameters = {"n_features": 170, "levels": 3, "factor": 1.3, "skip": 2}
    assert detect(as_image(amplitude), **parameters).level.min() == 1
    assert detect(as_image(amplitude, mask=mask), **parameters).level.min() == 0


def test_the_smaller_image_of_a_pair_decides_for_both(sar_texture: Texture) -> None:
    large, small = as_image(sar_texture(260, 260)), as_image(sar_texture(150, 150))
    detector = registry.create("detector", "sar-ofast", n_features=120, levels=2, factor=1.3, skip=2)
    for pair in ((large, small), (small, large)):
        chosen = detector.for_pair(*pair)
        assert [chosen.detect_features(one).level.min() for one in pair] == [1, 1]
    assert detector.detect_features(large).level.min() == 2


def test_coarser_levels_find_more_of_few_corners_again() -> None:
    """Correct within 3 px of the truth among the nearest descriptors of two images with speckle of their own."""
    pair = sar_pair((360, 360), rotation_deg=5.0, shift=(4.0, -3.0), looks=1.0, seed=3)
    images = as_image(pair.reference), as_image(pair.secondary)
    correct = []
    for skip in (0, 2):
        detector = registry.create("detector", "sar-ofast", n_features=450, levels=3, factor=1.3, skip=skip)
        matcher = FeatureMatcher(
            detector,
            registry.create("descriptor", "brief", levels=5, factor=1.3),
            registry.create("nearest", "brute-force"),
        )
        matches = matcher.match(*images)
        away = np.hypot(*(matches.reference_xy @ pair.truth[:, :2].T + pair.truth[:, 2] - matches.secondary_xy).T)
        correct.append(int((away < 3).sum()))
    assert correct[1] > 1.2 * correct[0] > 20
