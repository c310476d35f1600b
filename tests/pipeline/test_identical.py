"""Counting the values that two images share."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.pipeline.identical import _counted, _counts_of


@pytest.mark.parametrize("gain", [1.0, 0.37])
def test_values_are_counted_as_numpy_counts_them(gain: float) -> None:
    samples = (np.random.default_rng(5).integers(0, 60, 900) * np.float32(gain)).astype(np.float32)
    for found, wanted in zip(_counted(samples), np.unique(samples, return_counts=True), strict=True):
        np.testing.assert_array_equal(found, wanted)
    asked = np.append(samples[:7], np.array([-1, 1e6, 0.5 * gain], np.float32))
    np.testing.assert_array_equal(_counts_of(asked, samples), [np.count_nonzero(samples == one) for one in asked])
    assert len(_counted(samples[:0])[0]) == 0
