"""The length of gradients."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradients.lengths import lengths

SHAPE = (401, 403)


def test_it_is_the_root_of_the_squares_in_the_same_bits_wherever_the_arrays_lie() -> None:
    rng = np.random.default_rng(0)
    gx, gy = rng.normal(size=(2, *SHAPE)).astype(np.float32)
    found = {lengths(moved(gx, x), moved(gy, y)).tobytes() for x, y in product((0, 4, 16, 48), repeat=2)}
    assert len(found) == 1
    exact = np.hypot(gx.astype(np.float64), gy)
    np.testing.assert_allclose(np.frombuffer(found.pop(), np.float32).reshape(SHAPE), exact, rtol=2e-7)


def test_what_is_given_stays_as_it_is() -> None:
    gx, gy = np.array([[3.0, 0.0]], np.float32), np.array([[-4.0, 0.0]], np.float32)
    np.testing.assert_array_equal(lengths(gx, gy), [[5, 0]])
    np.testing.assert_array_equal([gx, gy], [[[3, 0]], [[-4, 0]]])


def moved(values: NDArray[np.float32], by: int) -> NDArray[np.float32]:
    """A copy that begins so many bytes behind where a line of the processor's cache does."""
    room = np.empty(values.nbytes + 128, np.uint8)
    start = -room.ctypes.data % 64 + by
    copy = room[start : start + values.nbytes].view(np.float32).reshape(values.shape)
    copy[:] = values
    return copy
