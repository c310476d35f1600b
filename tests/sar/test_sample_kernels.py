"""Counts of whole images in one pass, beside numpy's maps."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.sar.sample_kernels import count_between


@pytest.mark.parametrize("size", [0, 5, 200_001])
def test_samples_between_two_levels_are_counted(size: int) -> None:
    samples = np.random.default_rng(0).integers(0, 40, size).astype(np.float32)
    found = count_between(samples, np.float32(0), np.float32(20))
    assert found == np.count_nonzero((samples > 0) & (samples < 20))
