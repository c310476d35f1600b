"""Which samples hold the value that stands for no data."""

from __future__ import annotations

from numbers import Number
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.types import BoolArray


def holds_nodata(samples: NDArray[Any], nodata: complex | None) -> BoolArray | None:
    """Return an (H, W) bool array of the samples that equal `nodata`, or None where none can.

    NaN is never data anyway. A complex sample is nodata where its real part is and its imaginary part is either 0 or
    nodata too: files write both.
    """
    if nodata is None:
        return None
    if not isinstance(nodata, Number) or isinstance(nodata, bool):
        raise ParameterError(f"nodata must be one number, got {nodata!r}")
    kind = samples.dtype.kind
    try:
        plain = complex(nodata)
    except OverflowError:
        raise ParameterError("nodata must be a number that float64 can hold, got a larger one") from None
    if np.isnan(plain) or (kind != "c" and plain.imag):
        return None
    if kind in "iu":
        if not float(nodata.real).is_integer():
            return None
        value = int(nodata.real)
        limits = np.iinfo(samples.dtype)
        return np.asarray(samples == samples.dtype.type(value)) if limits.min <= value <= limits.max else None
    # In the samples' own precision: a float32 file with nodata 0.1 does not hold the double 0.1.
    with np.errstate(over="ignore"):
        value = samples.dtype.type(plain if kind == "c" else plain.real)
    if kind == "c" and not plain.imag:
        return np.asarray((samples.real == value.real) & ((samples.imag == 0) | (samples.imag == value.real)))
    return np.asarray(samples == value)
