"""Isolated invalid samples are filled for features, wide holes stay, and absurd samples do not count."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.sar.absurd import absurd_samples, fill_hint
from featreg.sar.bridging import GAP, _has_narrow, bridged, on_samples
from featreg.types import Image, Matches

SHAPE = (120, 150)


def speckle(seed: int = 0) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    return np.sqrt(rng.gamma(4.0, 0.25, SHAPE)).astype(np.float32)


def image_of(hole: Any, samples: NDArray[Any] | None = None) -> Image:
    samples = speckle() if samples is None else samples.copy()
    samples[hole] = np.nan
    return featreg.as_image(samples)


def test_an_image_without_invalid_samples_is_itself() -> None:
    image = featreg.as_image(speckle())
    assert bridged(image) is image


def test_wide_holes_leave_the_image_itself() -> None:
    x, y = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    wedge, slanted, rim = x + y < 70, y > 110 + 0.1 * x, (x < 5) | (y < 3)
    lake = np.hypot(x - 75, y - 60) < 25
    for hole in (wedge, slanted, rim, lake, wedge | slanted | lake):
        image = image_of(hole)
        assert bridged(image) is image


@pytest.mark.parametrize("share", [0.001, 0.05, 0.3])
def test_scattered_samples_are_filled_from_those_around(share: float) -> None:
    hole = np.random.default_rng(1).random(SHAPE) < share
    hole[60, 70] = True
    image = image_of(hole)
    seen = bridged(image)
    assert seen.filled is not None
    inner = np.s_[GAP:-GAP, GAP:-GAP]  # what is joined to the border stays a hole
    assert seen.mask[inner].all()
    assert (seen.filled[inner] == hole[inner]).all()
    np.testing.assert_array_equal(seen.pixels[~hole], image.pixels[~hole])
    assert seen.pixels[hole & seen.filled].mean() == pytest.approx(image.pixels[~hole].mean(), rel=0.05)
    assert (image.mask == ~hole).all()  # what products see stays as it is


def test_a_stripe_is_filled_and_a_wider_one_is_not() -> None:
    for width, filled in ((GAP, True), (GAP + 1, False)):
        seen = bridged(image_of(np.s_[50 : 50 + width]))
        assert seen.mask[:, GAP:-GAP].all() == filled  # its ends are open to the border


def test_what_lies_around_a_gap_decides_what_fills_it() -> None:
    samples = np.where(np.arange(SHAPE[1]) < 75, 1.0, 9.0) * np.ones(SHAPE)
    seen = bridged(image_of((slice(50, 52), slice(20, 130)), samples))
    np.testing.assert_allclose(seen.pixels[50:52, 22:68], 1.0, rtol=1e-5)
    np.testing.assert_allclose(seen.pixels[50:52, 82:128], 9.0, rtol=1e-5)


def test_complex_samples_keep_the_level_of_their_amplitude() -> None:
    rng = np.random.default_rng(2)
    samples = (rng.normal(size=SHAPE) + 1j * rng.normal(size=SHAPE)).astype(np.complex64)
    hole = rng.random(SHAPE) < 0.05
    seen = bridged(image_of(hole, samples))
    assert seen.filled is not None
    assert np.isfinite(seen.pixels).all()
    assert seen.amplitude[seen.filled].mean() == pytest.approx(np.abs(samples).mean(), rel=0.1)


def test_no_tie_point_lies_on_a_filled_sample() -> None:
    image = image_of((slice(60, 61), slice(70, 71)))
    seen = bridged(image)
    xy = np.array([[70.3, 59.8], [71.6, 60.0], [20.0, 20.0]])
    both = Matches(xy, xy, np.ones(3))
    np.testing.assert_array_equal(on_samples(both, seen, featreg.as_image(speckle())).reference_xy, xy[1:])
    np.testing.assert_array_equal(on_samples(both, featreg.as_image(speckle()), seen).reference_xy, xy[1:])


@pytest.fixture(params=["small", "large"])
def looked_at(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """As small images are, and as large ones."""
    monkeypatch.setattr("featreg.sar.absurd.LARGE", {"small": 1 << 20, "large": 0}[request.param])


@pytest.mark.usefixtures("looked_at")
def test_single_absurd_samples_do_not_count_but_stay_in_the_image() -> None:
    samples = speckle()
    samples[40, 50] = 1e8
    image = featreg.as_image(samples)
    seen = bridged(image)
    assert seen.mask.all()
    assert seen.amplitude.max() < 10
    assert image.mask.all()
    assert image.amplitude[40, 50] == np.float32(1e8)


@pytest.mark.usefixtures("looked_at")
@pytest.mark.parametrize("value", [1e20, 3.4e38])
def test_an_absurd_fill_is_a_hole(value: float) -> None:
    samples = speckle()
    samples[:, :40] = value
    seen = bridged(featreg.as_image(samples))
    assert not seen.mask[:, :40].any()
    assert seen.mask[:, 40:].all()


@pytest.mark.usefixtures("looked_at")
def test_scenes_of_any_range_hold_no_absurd_sample() -> None:
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(*(np.arange(n) - n // 2 for n in SHAPE[::-1]))
    # A point response with its side lobes, 100 dB above a dark sea; ships on a constant sea; mostly black; wide tails.
    point = (1e5 * np.abs(np.sinc(x / 1.7) * np.sinc(y / 1.7)) + rng.rayleigh(1, SHAPE)).astype(np.float32)
    ships = np.ones(SHAPE, np.float32)
    ships[50:53, 50:53] = 1e5
    black = np.where(rng.random(SHAPE) < 0.01, 1e4, 0).astype(np.float32)
    tails = rng.lognormal(0, 3, SHAPE).astype(np.float32)
    dust = np.where(x < -20, 1e-12 * rng.random(SHAPE), rng.rayleigh(1, SHAPE)).astype(np.float32)
    for samples in (speckle(), point, ships, black, tails, dust):
        assert absurd_samples(featreg.as_image(samples)) is None


@pytest.mark.usefixtures("looked_at")
def test_what_looks_like_a_fill_is_named() -> None:
    samples = speckle()
    assert fill_hint(featreg.as_image(samples), "reference") == ""
    samples[:, :40] = 9999
    assert "hold 9999" in fill_hint(featreg.as_image(samples), "reference")
    power = samples**2
    power[:, :40] = 9999
    assert "hold 9999" in fill_hint(featreg.as_image(power, scale="intensity"), "reference")


def test_narrow_gaps_are_those_that_an_opening_takes_away() -> None:
    rng = np.random.default_rng(3)
    told = []
    for i in range(60):
        height, width = rng.integers(1, 200, 2).tolist()
        invalid = np.zeros((height, width), np.uint8)
        for _ in range(rng.integers(0, 4)):
            x, y = rng.integers(-20, width), rng.integers(-20, height)
            invalid[max(y, 0) : max(y + rng.integers(1, 60), 0), max(x, 0) : max(x + rng.integers(1, 60), 0)] = 1
        if i % 3 == 0:
            turn = cv2.getRotationMatrix2D((width / 2, height / 2), float(rng.uniform(-40, 40)), 1)
            invalid = 1 - cv2.warpAffine(np.ones((height, width), np.uint8), turn, (width, height))
        around = cv2.copyMakeBorder(invalid, 32, 32, 32, 32, cv2.BORDER_CONSTANT, value=1)
        opened = cv2.morphologyEx(around, cv2.MORPH_OPEN, np.ones((17, 17), np.uint8))
        told.append(_has_narrow(invalid > 0))
        assert told[-1] == bool((opened != around).any())
    assert 10 < sum(told) < 50
