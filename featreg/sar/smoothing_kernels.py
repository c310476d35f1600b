"""Compiled loops of symmetric filters along a row and across rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, inlined

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


@inlined
def mirrored(place: int, length: int) -> int:
    """Where a place lies that is mirrored about the ends of an axis, as often as it takes: 2 1 0 1 2 ..."""
    period = max(2 * (length - 1), 1)
    place = place % period
    return min(place, period - place) if length > 1 else 0


@compiled
def _three(before: F32, middle: F32, after: F32, w0: np.float32, w1: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] = w0 * middle[i] + w1 * (before[i] + after[i])


@compiled
def _five(
    a: F32, b: F32, middle: F32, c: F32, d: F32, w0: np.float32, w1: np.float32, w2: np.float32, out: F32
) -> None:
    for i in range(out.shape[0]):
        out[i] = w0 * middle[i] + w1 * (b[i] + c[i]) + w2 * (a[i] + d[i])


@compiled
def _two_more(before: F32, after: F32, weight: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] += weight * (before[i] + after[i])


@compiled
def _four_more(a: F32, b: F32, c: F32, d: F32, inner: np.float32, outer: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] += inner * (b[i] + c[i]) + outer * (a[i] + d[i])


@compiled
def smoothed_along(row: F32, taps: F32, out: F32) -> None:
    """Smooth a row, which is as much longer than `out` on both sides as there are taps beside the middle one."""
    m, n = taps.shape[0] - 1, out.shape[0]
    if m == 1:
        _three(row[:n], row[1 : 1 + n], row[2 : 2 + n], taps[0], taps[1], out)
        return
    _five(
        row[m - 2 : m - 2 + n], row[m - 1 : m - 1 + n], row[m : m + n], row[m + 1 : m + 1 + n], row[m + 2 : m + 2 + n],
        taps[0], taps[1], taps[2], out,
    )  # fmt: skip
    for k in range(3, m, 2):
        a, b, c, d = m - k - 1, m - k, m + k, m + k + 1
        _four_more(row[a : a + n], row[b : b + n], row[c : c + n], row[d : d + n], taps[k], taps[k + 1], out)
    if m % 2:
        _two_more(row[:n], row[2 * m : 2 * m + n], taps[m], out)


@compiled
def smoothed_across(rows: F32, at: I64, taps: F32, out: F32) -> None:
    """Smooth across rows (n, W), of which those `at` (2 * reach + 1,) lie around the wanted one, in order."""
    m = taps.shape[0] - 1
    if m == 1:
        _three(rows[at[0]], rows[at[1]], rows[at[2]], taps[0], taps[1], out)
        return
    _five(
        rows[at[m - 2]], rows[at[m - 1]], rows[at[m]], rows[at[m + 1]], rows[at[m + 2]], taps[0], taps[1], taps[2], out
    )
    for k in range(3, m, 2):
        a, b, c, d = rows[at[m - k - 1]], rows[at[m - k]], rows[at[m + k]], rows[at[m + k + 1]]
        _four_more(a, b, c, d, taps[k], taps[k + 1], out)
    if m % 2:
        _two_more(rows[at[0]], rows[at[2 * m]], taps[m], out)
