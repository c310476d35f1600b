"""What samples are: stated scales, decibels, negative ones, and a scale against the kind of the samples."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.io import as_image

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
GRAY = np.random.default_rng(0).integers(1, 250, (40, 60), dtype=np.uint8)


def test_stated_scales() -> None:
    amplitude = GRAY.astype(np.float64)
    for samples, scale in ((amplitude**2, "intensity"), (20 * np.log10(amplitude), "db"), (amplitude, "amplitude")):
        image = as_image(samples, scale=scale)
        np.testing.assert_allclose(image.pixels, amplitude, rtol=1e-5)
        assert image.scale == scale
    # numpy takes the root of 8 bits in half precision; it must not come through here
    np.testing.assert_allclose(as_image(GRAY, scale="intensity").pixels, np.sqrt(amplitude), rtol=1e-6)


def test_decibels_that_cannot_be_are_refused() -> None:
    linear = np.random.default_rng(3).gamma(4, 50, (40, 40)).astype(np.float32)
    with pytest.raises(InputError, match=r"scale 'db' cannot be: \d+ % of the samples lie outside -90 to 60 dB"):
        as_image(linear, scale="db")
    low = np.random.default_rng(3).normal(-12, 4, (40, 40)).astype(np.float32)
    low[:5] = -9999.0  # an undeclared fill is no reason
    assert as_image(low, scale="db").scale == "db"


def test_decibels_are_recognised_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    backscatter = np.random.default_rng(2).normal(-12, 6, (50, 50)).astype(np.float32)
    backscatter[0, 0] = -np.inf
    with caplog.at_level(logging.WARNING):
        image = as_image(backscatter)
    assert "decibels" in caplog.text
    assert image.scale == "db"
    assert not image.mask[0, 0]
    np.testing.assert_allclose(image.pixels[1:], 10 ** (backscatter[1:] / 20), rtol=1e-5)
    caplog.clear()
    assert as_image(np.round(backscatter[1:]).astype(np.int16)).scale == "db"
    as_image(backscatter, scale="db")
    assert caplog.text.count("decibels") == 1


def test_nodata_goes_before_the_scale() -> None:
    backscatter = np.random.default_rng(3).normal(-12, 6, (50, 50)).astype(np.float32)
    backscatter[:9] = -9999
    image = as_image(backscatter, nodata=-9999)
    assert image.scale == "db"
    np.testing.assert_array_equal(image.mask[:, 0], np.arange(50) >= 9)


@pytest.mark.parametrize("dtype", ["int16", "float32"])
def test_negative_samples_without_a_scale_are_an_error(dtype: str) -> None:
    samples = GRAY.astype(dtype) * 10
    samples[2, 3] = samples[4, 5] = -7
    with pytest.raises(InputError, match=r"2 samples are negative.*scale="):
        as_image(samples)


def test_negative_samples_of_a_stated_amplitude_are_masked(caplog: pytest.LogCaptureFixture) -> None:
    samples = GRAY.astype(np.float32)
    samples[2, 3] = -0.5
    with caplog.at_level(logging.WARNING):
        image = as_image(samples, scale="amplitude")
    assert np.argwhere(~image.mask).tolist() == [[2, 3]]
    assert "1 negative samples" in caplog.text


def test_scale_against_kind() -> None:
    with pytest.raises(InputError, match="complex samples"):
        as_image(GRAY + 1j, scale="db")
    with pytest.raises(InputError, match="real uint8 samples"):
        as_image(GRAY, scale="complex")
    with pytest.raises(ParameterError, match="did you mean 'intensity'"):
        as_image(GRAY, scale="intensty")
