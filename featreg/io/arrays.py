"""Arrays of other libraries as plain numpy arrays, and which of their elements they hold for masked."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.types import BoolArray


def is_array(source: Any) -> bool:
    """Whether something is an array by its own account: numpy's, dask's, xarray's, pandas', a picture of Pillow."""
    return any(hasattr(source, name) for name in ("__array__", "__array_interface__"))


def count_of(source: Any) -> int:
    """How many elements an array has, without computing them; the size of a picture of Pillow is a pair."""
    return int(np.prod(getattr(source, "size", 0)))


def plain_array(source: Any) -> tuple[NDArray[Any], BoolArray | None]:
    """Return the elements of an array of any library, and the map of those that are not masked, None = all.

    Masks live in the arrays of numpy and in the blocks of dask, also inside a DataArray of xarray; pandas has missing
    values of its own.
    """
    if hasattr(source, "dims") and hasattr(source, "data"):
        source = source.data
    if hasattr(source, "compute"):
        source = source.compute()
    if hasattr(source, "to_numpy") and hasattr(source, "isna"):
        missing = np.asarray(source.isna())
        array = np.asarray(source)
        if array.dtype.kind == "O" and missing.any():
            # What is not known gets a value of the others' kind, which the mask covers.
            array = np.where(missing, array.flat[int(np.argmin(missing))], array)
        return _inferred(array), ~missing if missing.any() else None
    if isinstance(source, np.ma.MaskedArray):
        hidden = np.ma.getmaskarray(source)
        return np.asarray(source.data), ~hidden if hidden.any() else None
    return np.asarray(source), None


def _inferred(array: NDArray[Any]) -> NDArray[Any]:
    """Objects as numbers where all of them are; pandas gives its nullable columns as objects."""
    return np.array(array.tolist()) if array.dtype.kind == "O" and array.size else array
