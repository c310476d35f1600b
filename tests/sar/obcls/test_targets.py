"""Order and median filters against scipy's, regions and centres of mass, targets of an image."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.obcls.targets import covered, median_filter, order_filter, regions, targets
from featreg.types import Image


@pytest.mark.parametrize("order", [1, 9, 17, 25])
def test_the_order_filter_is_a_rank_filter(order: int) -> None:
    binary = np.random.default_rng(0).random((40, 50)) > 0.5
    expected = ndimage.rank_filter(binary, order - 1, size=5, mode="constant")
    np.testing.assert_array_equal(order_filter(binary, order), expected)


@pytest.mark.parametrize("side", [1, 3, 7])
def test_the_median_filter_is_a_median_filter(side: int) -> None:
    binary = np.random.default_rng(1).random((40, 50)) > 0.5
    np.testing.assert_array_equal(median_filter(binary, side), ndimage.median_filter(binary, side, mode="constant"))


def test_regions_touch_at_corners_and_come_with_centres_of_mass() -> None:
    binary = np.zeros((30, 40), np.bool_)
    binary[2:5, 3:9] = True
    binary[20, 20] = binary[21, 21] = binary[22, 20] = True
    binary[10, 35] = True
    found = regions(binary)
    np.testing.assert_array_equal(found.area, [18, 3, 1])
    np.testing.assert_allclose(found.xy, np.array([[5.5, 3.0], [61 / 3, 21.0], [35, 10]]))
    assert len(regions(binary, min_area=3)) == 2


def test_no_detection_is_no_target() -> None:
    found = regions(np.zeros((20, 20), np.bool_))
    assert found.xy.shape == (0, 2)
    assert found.area.shape == (0,)


def scene(gain: float = 1.0) -> Image:
    rng = np.random.default_rng(2)
    power = rng.exponential(size=(160, 170))
    for x, y in ((40, 50), (100, 30), (120, 120)):
        power[y - 4 : y + 5, x - 6 : x + 7] *= 100
    return as_image(gain * np.sqrt(power))


@pytest.mark.parametrize("gain", [1.0, 1e-20, 1e12])
def test_targets_are_found_whatever_the_gain(gain: float) -> None:
    found = targets(scene(gain), pfa=1e-3)
    assert len(found) == 3
    there = found.xy[np.argsort(found.xy[:, 0])]
    np.testing.assert_allclose(there, [[40, 50], [100, 30], [120, 120]], atol=0.6)


def test_speckle_alone_has_no_extended_targets() -> None:
    noise = as_image(np.sqrt(np.random.default_rng(5).exponential(size=(300, 300))))
    assert len(targets(noise)) == 0


def test_complex_and_amplitude_have_the_same_targets() -> None:
    amplitude = scene().pixels
    phase = np.exp(1j * np.random.default_rng(3).uniform(0, 6, amplitude.shape))
    np.testing.assert_allclose(targets(as_image(amplitude * phase)).xy, targets(as_image(amplitude)).xy)


def test_padding_is_no_clutter_and_makes_no_targets() -> None:
    """Zeros among the training cells lower the clutter estimate beside them."""
    rng = np.random.default_rng(6)
    noise = [ndimage.gaussian_filter(rng.normal(size=(300, 300)), 1.5) for _ in range(2)]
    amplitude = np.hypot(*noise)
    y, x = np.mgrid[:300, :300]
    amplitude[x + y < 200] = 0
    image = as_image(amplitude)
    assert len(targets(image, pfa=5e-2, zeros_are_data=True)) > len(targets(image, pfa=5e-2))
    assert not covered(image)[:50, :50].any()
    assert covered(image)[200:, 200:].all()


def test_single_zeros_are_data() -> None:
    amplitude = np.ones((40, 40))
    amplitude[::4, ::4] = 0
    assert covered(as_image(amplitude)).all()


@pytest.mark.parametrize("wrong", [{"order": 0}, {"order": 26}, {"median": 4}, {"min_area": 0}, {"pfa": 2.0}])
def test_impossible_parameters_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        targets(scene(), **wrong)  # type: ignore[arg-type]


def test_a_tiny_image_does_not_break() -> None:
    assert len(targets(as_image(np.random.default_rng(0).random((16, 16))))) <= 1
