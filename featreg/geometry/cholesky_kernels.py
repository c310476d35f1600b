"""Compiled: Cholesky's factor of a small symmetric matrix, and what follows from it."""

from __future__ import annotations

import math

from featreg.runtime.jit import compiled
from featreg.types import FloatArray


@compiled
def factor_in_place(a: FloatArray, least: float) -> bool:
    """Put Cholesky's factor of a symmetric matrix in its place, below the diagonal; False where it is not positive.

    It is not where a pivot is at most `least` of the diagonal that was there. What lies above the diagonal is not read.
    """
    n = a.shape[0]
    for j in range(n):
        d = a[j, j]
        for k in range(j):
            d -= a[j, k] * a[j, k]
        if not d > least * a[j, j]:
            return False
        root = math.sqrt(d)
        a[j, j] = root
        for i in range(j + 1, n):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            a[i, j] = s / root
    return True


@compiled
def solve_in_place(factor: FloatArray, b: FloatArray) -> None:
    """Put into `b` the solution x of a x = b, where `factor` is what `factor_in_place` made of a."""
    n = factor.shape[0]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= factor[i, k] * b[k]
        b[i] = s / factor[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= factor[k, i] * b[k]
        b[i] = s / factor[i, i]
