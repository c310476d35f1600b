"""Reading amplitudes in one pass gives what the steps for all cases give."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.io import as_image, images
from featreg.io.amplitude_kernels import amplitudes

SHAPE = (21, 37)


def samples(dtype: Any) -> Any:
    """Small numbers, a fifth of them 0, a fifth 7."""
    some = np.random.default_rng(4).integers(0, 200, SHAPE).astype(dtype)
    some[:, ::5], some[:, 1::5] = 0, 7
    return some


def outcome(source: Any, keywords: Any) -> list[Any]:
    try:
        image = as_image(source, **keywords)
    except InputError as error:
        return [str(error)]
    assert not image.pixels.flags.writeable
    assert not image.mask.flags.writeable
    return [image.pixels.tobytes(), image.mask.tobytes(), image.scale, image.source_dtype, image.nodata]


@pytest.mark.parametrize("dtype", [np.float32, np.uint8, np.uint16, ">f4", np.float64, np.int16])
@pytest.mark.parametrize(
    "nodata", [0, 7, 7.5, -1, 300, 1e30, np.float32(7), np.int64(0), np.nan, np.inf, 7 + 0j, 1e300]
)
def test_with_every_value_of_no_data(dtype: Any, nodata: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    source, given = samples(dtype), {"nodata": nodata}
    found = outcome(source, given)
    monkeypatch.setattr(images, "_amplitude_at_once", lambda *_: None)
    assert found == outcome(source, given)
    assert len(found) == 5


@pytest.mark.parametrize(
    ("changed", "keywords"),
    [
        (None, {"mask": np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE) % 3 > 0}),
        (None, {"mask": np.zeros(SHAPE, np.bool_)}),
        (None, {"scale": "amplitude"}),
        (None, {"scale": "intensity"}),
        (-3.0, {}), (-3.0, {"scale": "amplitude"}), (np.nan, {}), (np.inf, {}), (-0.0, {}),
    ],
)  # fmt: skip
def test_with_masks_scales_and_samples_that_are_no_amplitudes(
    changed: float | None, keywords: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    source, given = samples(np.float32), {"nodata": 7, **keywords}
    if changed is not None:
        source[3, 4:9] = changed
    found = outcome(source, given)
    monkeypatch.setattr(images, "_amplitude_at_once", lambda *_: None)
    assert found == outcome(source, given)


@pytest.mark.parametrize("value", [7, 9])
def test_one_value_everywhere_is_no_image(value: int, monkeypatch: pytest.MonkeyPatch) -> None:
    source = np.full(SHAPE, value, np.uint8)
    found = outcome(source, {"nodata": 7})
    monkeypatch.setattr(images, "_amplitude_at_once", lambda *_: None)
    assert found == outcome(source, {"nodata": 7})
    assert len(found) == 1


def test_the_loop_says_how_many_are_data() -> None:
    source = samples(np.float32)
    pixels, valid = np.empty(SHAPE, np.float32), np.empty(SHAPE, np.bool_)
    assert amplitudes(source, np.float32(7), pixels, valid) == (source != 7).sum()
    assert np.array_equal(valid, source != 7)
    assert np.array_equal(pixels, np.where(source != 7, source, 0))
    source[5, 5] = -1
    assert amplitudes(source, np.float32(7), pixels, valid) == -1
