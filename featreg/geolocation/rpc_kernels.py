"""Rational polynomials of degree 3 in longitude, latitude and height, and their inverse by Newton's iteration.

The 20 terms stand in the order of RPC00B: 1, L, P, H, LP, LH, PH, L^2, P^2, H^2, PLH, L^3, LP^2, LH^2, L^2P, P^3, PH^2,
L^2H, P^2H, H^3, with L, P, H the normalised longitude, latitude and height. A row of `coefficients` (4, 20) is one
polynomial: numerator and denominator of the sample, then of the line.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from featreg.runtime.jit import compiled, inlined
from featreg.types import FloatArray

#: Points worked on at a time: their rows stay in the first-level cache.
CHUNK = 512


@inlined
def cubic(c: FloatArray, x: float, y: float, z: float) -> Any:
    flat = c[0] + z * (c[3] + z * (c[9] + z * c[19]))
    north = c[2] + z * (c[6] + z * c[16]) + y * (c[8] + z * c[18] + y * c[15])
    east = c[1] + z * (c[5] + z * c[13]) + y * (c[4] + z * c[10] + y * c[12])
    return flat + y * north + x * (east + x * (c[7] + z * c[17] + y * c[14] + x * c[11]))


@inlined
def slope_x(c: FloatArray, x: float, y: float, z: float) -> Any:
    east = c[1] + z * (c[5] + z * c[13]) + y * (c[4] + z * c[10] + y * c[12])
    return east + x * (2.0 * (c[7] + z * c[17] + y * c[14]) + 3.0 * x * c[11])


@inlined
def slope_y(c: FloatArray, x: float, y: float, z: float) -> Any:
    north = c[2] + z * (c[6] + z * c[16]) + y * (2.0 * (c[8] + z * c[18]) + 3.0 * y * c[15])
    return north + x * (c[4] + z * c[10] + 2.0 * y * c[12] + x * c[14])


@compiled
def project(
    a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray,
    x: FloatArray, y: FloatArray, z: FloatArray, sample: FloatArray, line: FloatArray,
) -> None:  # fmt: skip
    """Write the normalised sample a/b and line c/d of normalised ground points (all (N,))."""
    for i in range(x.shape[0]):
        sample[i] = cubic(a, x[i], y[i], z[i]) / cubic(b, x[i], y[i], z[i])
    for i in range(x.shape[0]):
        line[i] = cubic(c, x[i], y[i], z[i]) / cubic(d, x[i], y[i], z[i])


@compiled
def newton(
    a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray,
    sample: FloatArray, line: FloatArray, z: FloatArray, x: FloatArray, y: FloatArray, off: FloatArray, close: float,
) -> None:  # fmt: skip
    """One Newton step of `x`, `y` (N,) towards the ground points of `sample`, `line`; `off` gets the residual before.

    With s = a / b the equation a - s b = 0 has the derivative a' - s b', which needs no division. Points whose `off` is
    already at most `close` stay, so that a result does not depend on which points are worked on together.
    """
    for i in range(x.shape[0]):
        u, v, w, s, t = x[i], y[i], z[i], sample[i], line[i]
        bottom, below = cubic(b, u, v, w), cubic(d, u, v, w)
        f, g = cubic(a, u, v, w) - s * bottom, cubic(c, u, v, w) - t * below
        fx, fy = slope_x(a, u, v, w) - s * slope_x(b, u, v, w), slope_y(a, u, v, w) - s * slope_y(b, u, v, w)
        gx, gy = slope_x(c, u, v, w) - t * slope_x(d, u, v, w), slope_y(c, u, v, w) - t * slope_y(d, u, v, w)
        det = fx * gy - fy * gx
        done = off[i] <= close
        x[i] = u if done else u - (f * gy - g * fy) / det
        y[i] = v if done else v - (g * fx - f * gx) / det
        off[i] = off[i] if done else max(abs(f / bottom), abs(g / below))


@compiled
def locate(
    coefficients: FloatArray, sample: FloatArray, line: FloatArray, z: FloatArray,
    x: FloatArray, y: FloatArray, tolerance: float, most: int,
) -> None:  # fmt: skip
    """Write the normalised ground points of the normalised image points `sample`, `line`; NaN where none is found."""
    a, b, c, d = coefficients[0], coefficients[1], coefficients[2], coefficients[3]
    x[:] = 0.0
    y[:] = 0.0
    off = np.empty(CHUNK)
    for start in range(0, x.shape[0], CHUNK):
        stop = min(start + CHUNK, x.shape[0])
        o = off[: stop - start]
        o[:] = np.inf
        s, t, h = sample[start:stop], line[start:stop], z[start:stop]
        for _ in range(most):
            newton(a, b, c, d, s, t, h, x[start:stop], y[start:stop], o, tolerance)
            worst = 0.0
            for i in range(o.shape[0]):
                worst = max(worst, o[i])
            # Measured before the last step, which has squared it since.
            if worst <= tolerance:
                break
        for i in range(o.shape[0]):
            if not o[i] <= tolerance:
                x[start + i] = np.nan
                y[start + i] = np.nan
