"""The length of gradients."""

from __future__ import annotations

import numpy as np

from featreg.sar.gradients.lengths import lengths


def test_it_is_the_root_of_the_squares_in_the_same_bits_wherever_the_arrays_lie() -> None:
    gx, gy = np.random.default_rng(0).normal(size=(2, 64, 64)).astype(np.float32)
    found, between = [], []
    for size in range(16):
        # What lies between them moves what is made next to other places.
        between.append(np.empty(16 * size + 8, np.uint8))
        found.append(lengths(gx, gy))
    assert len({one.tobytes() for one in found}) == 1
    np.testing.assert_allclose(found[0], np.hypot(gx.astype(np.float64), gy), rtol=2e-7)


def test_what_is_given_stays_as_it_is() -> None:
    gx, gy = np.array([[3.0, 0.0]], np.float32), np.array([[-4.0, 0.0]], np.float32)
    np.testing.assert_array_equal(lengths(gx, gy), [[5, 0]])
    np.testing.assert_array_equal([gx, gy], [[[3, 0]], [[-4, 0]]])
