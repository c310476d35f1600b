"""Counting the values that two images share."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from featreg.io import as_image
from featreg.pipeline import identical
from featreg.pipeline.identical import CROP, PATTERN, _beyond_chance, _counted, _counts_of, _detail
from featreg.pipeline.identical_kernels import fine_detail


@pytest.mark.parametrize("gain", [1.0, 0.37])
def test_values_are_counted_as_numpy_counts_them(gain: float) -> None:
    samples = (np.random.default_rng(5).integers(0, 60, 900) * np.float32(gain)).astype(np.float32)
    for found, wanted in zip(_counted(samples), np.unique(samples, return_counts=True), strict=True):
        np.testing.assert_array_equal(found, wanted)
    asked = np.append(samples[:7], np.array([-1, 1e6, 0.5 * gain], np.float32))
    np.testing.assert_array_equal(_counts_of(asked, samples), [np.count_nonzero(samples == one) for one in asked])
    assert len(_counted(samples[:0])[0]) == 0


@pytest.mark.parametrize("column", [1, 128])
def test_lines_along_columns_are_met_wherever_they_lie(column: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every nth pixel, asked how often a value is met by chance, shall not be all of a line's pixels."""
    monkeypatch.setattr(identical, "MOST_COUNTED", 1 << 9)
    rng = np.random.default_rng(6)
    first, second = rng.gamma(1.0, 1.0, (2, 256, 256)).astype(np.float32)
    first[:, column] = second[:, column] = 0.7
    first[0, 0] = 9.0
    found = _beyond_chance(first == second, first, second)
    np.testing.assert_array_equal(np.flatnonzero(found.all(axis=0)), [column])


def test_a_pattern_is_seen_around_a_middle_that_shows_nothing() -> None:
    rng = np.random.default_rng(8)
    gains = rng.gamma(9.0, 1.0, (200, 200))
    images = (gains * rng.gamma(9.0, 1.0, (2, 200, 200))).astype(np.float32)
    unlike = rng.gamma(9.0, 1.0, (2, 200, 200)).astype(np.float32)
    for pair in (images, unlike):
        # A quarter of what is looked at, calm water that was quantised to 0.
        pair[:, 100 - CROP // 4 : 100 + CROP // 4, 100 - CROP // 4 : 100 + CROP // 4] = 0
    # Its shore is one of both, and left out.
    shore = cv2.morphologyEx((images[0] == 0).view(np.uint8), cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8)) > 0
    first, second = (_detail(as_image(pair[0]), as_image(pair[1]), shore) for pair in (images, unlike))
    assert first > 2 * PATTERN
    assert abs(second) < PATTERN / 2


def test_fine_detail_is_what_lies_beside_the_mean_of_nine() -> None:
    rng = np.random.default_rng(9)
    first, second = rng.gamma(4.0, 1.0, (2, 40, 51)).astype(np.float32)
    second += first
    first[:8, :9] = second[:8, :9] = 0
    mask = rng.random(first.shape) > 0.2
    floors = np.array([0.05, 0.07], np.float32)
    found = fine_detail(first, second, mask, floors, 0.5)
    logs = [np.log(np.maximum(view, floor)) for view, floor in zip((first, second), floors, strict=True)]
    black = ((first <= floors[0]) & (second <= floors[1])).view(np.uint8)
    use = mask & (cv2.dilate(black, np.ones((3, 3), np.uint8)) == 0)
    fine = [(view - cv2.blur(view, (3, 3)))[use].astype(np.float64) for view in logs]
    assert found == pytest.approx(np.corrcoef(*fine)[0, 1], abs=1e-5)
    assert np.isnan(fine_detail(first, second, mask & (rng.random(mask.shape) > 0.6), floors, 0.5))
    assert np.isnan(fine_detail(np.ones_like(first), second, mask, floors, 0.5))


def test_the_shore_of_what_is_black_in_both_is_no_pattern() -> None:
    """A lake quantised to 0 has the same shore on both dates: detail that is no fixed pattern."""
    rng = np.random.default_rng(10)
    lake = cv2.GaussianBlur(rng.normal(size=(200, 200)), (0, 0), 4) > 0.03
    pair = (rng.gamma(4.0, 1.0, (2, 200, 200)) * ~lake).astype(np.float32)
    assert 0.3 < lake.mean() < 0.5
    assert abs(_detail(as_image(pair[0], nodata=-1), as_image(pair[1], nodata=-1))) < PATTERN / 2
