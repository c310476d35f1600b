"""The arrays that the types hold: their kinds, their shape, that they are finite, that nobody writes to them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
A = TypeVar("A", bound=NDArray[Any])

#: Pixels of the largest map of `everywhere` that shares its memory.
MOST_SHARED = 1 << 25
_true: dict[str, BoolArray] = {}


def read_only(array: A) -> A:
    """Return `array` itself, locked against writing with all that it is a view of: for arrays that one made oneself."""
    array.setflags(write=False)
    part: Any = array.base
    while isinstance(part, np.ndarray):
        part.setflags(write=False)
        part = part.base
    return array


def kept(array: A) -> A:
    """Return `array` such that nobody writes to it later: itself where it is locked, else a locked copy.

    Whoever makes a large array for an object calls `read_only` on it first and so gives it away. A locked view of what
    can be written to is copied too, and so is what lies column by column, for which every kernel would be compiled.
    """
    if array.flags.fnc:
        return read_only(array.copy())
    part: Any = array
    while isinstance(part, np.ndarray):
        if part.flags.writeable:
            return read_only(array.copy())
        part = part.base
    return array


def everywhere(shape: tuple[int, int]) -> BoolArray:
    """Return a locked (H, W) map that is True everywhere; all but very large ones share their memory."""
    count = shape[0] * shape[1]
    if count > MOST_SHARED:
        return read_only(np.ones(shape, np.bool_))
    held = _true.get("held")
    if held is None or held.size < count:
        # Another thread may do the same: either is as good.
        _true["held"] = held = read_only(np.ones(count, np.bool_))
    return held[:count].reshape(shape)


def is_everywhere(mask: BoolArray) -> bool:
    """Whether a map is one that `everywhere` lets share its memory, without looking at it; False says nothing."""
    return mask.base is not None and mask.base is _true.get("held")


def points(values: ArrayLike, what: str) -> FloatArray:
    """Return `values` as a read-only (N, 2) float64 array of (x, y) points.

    Raises
    ------
    InputError
        The values do not form an (N, 2) array of finite numbers.
    """
    array = numbers(values, what)
    if array.size == 0:
        array = array.reshape(0, 2)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"{what} must be an (N, 2) array of (x, y), got shape {array.shape}")
    return read_only(finite(array, what))


def numbers(values: ArrayLike, what: str, dtype: Any = np.float64) -> NDArray[Any]:
    """Return an array of `values` that nobody else writes to; an `InputError` where they are no numbers of that kind.

    What is an array of that kind already, whole, with memory of its own and locked, is returned itself. Any other
    becomes one in which the last axis varies fastest, as kernels are prepared for: columns put side by side by ``.T``
    are not, nor is what `numpy.argwhere` finds.
    """
    if type(values) is np.ndarray and values.base is None and values.dtype == dtype:
        flags = values.flags
        if not flags.writeable and flags.c_contiguous:
            return values
    try:
        made = np.array(values, dtype=dtype, order="C")
        # Floats become integers by losing what they have behind the point.
        if made.dtype.kind in "iu" and not _whole(values, made):
            raise ValueError("some have fractions")
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what} must be an array of {np.dtype(dtype).name}: {error}") from None
    return made


def _whole(values: ArrayLike, made: NDArray[Any]) -> bool:
    """Whether values were whole numbers before they were `made` such."""
    given = values if isinstance(values, np.ndarray) else np.asarray(values)
    return given.dtype.kind != "f" or bool((given == made).all())


def finite(array: FloatArray, what: str) -> FloatArray:
    """Return `array` itself; an `InputError` where it holds a value that is not finite."""
    if not np.logical_and.reduce(np.isfinite(array), axis=None):
        raise InputError(f"{what} must be finite, got {int((~np.isfinite(array)).sum())} values that are not")
    return array


def middle(values: FloatArray) -> float:
    """The median of (N,) numbers, N >= 1; NaN where one is. A third of the time of numpy's for a thousand."""
    n = len(values)
    lower, upper = (n - 1) // 2, n // 2
    ordered = np.partition(values, (lower, upper, n - 1))
    return float(ordered[n - 1]) if ordered[n - 1] != ordered[n - 1] else 0.5 * float(ordered[lower] + ordered[upper])


def column(values: ArrayLike, rows: int, what: str, dtype: Any = np.float64) -> NDArray[Any]:
    """Return `values` as a read-only (rows,) array; one number stands for all rows."""
    array = numbers(values, what, dtype)
    if array.ndim == 0:
        array = np.full(rows, array, dtype=dtype)
    if array.shape != (rows,):
        raise InputError(f"{what} must have shape ({rows},), got {array.shape}")
    return read_only(array)


class ReadOnlyArrays:
    """Arrays come back from a pickle locked, as they were."""

    def _with_rows(self, rows: Any) -> Self:
        """The same with some rows of every array: what was checked when it was made needs no other check."""
        if np.ndim(rows) != 1 and not isinstance(rows, slice):
            raise InputError(f"rows must be (K,) indices or an (N,) bool mask, got shape {np.shape(rows)}")
        if isinstance(rows, tuple):
            # numpy takes one for an index along each axis.
            rows = list(rows)
        given: Any = rows
        if isinstance(rows, np.ndarray) and rows.dtype == np.bool_ and len(rows) == len(self):  # type: ignore[arg-type]  # all that have rows have a length
            # Found once, not anew in every column.
            given = np.flatnonzero(rows)
        taken = isinstance(given, np.ndarray) and given.dtype == np.int64
        return self._with_columns(
            {
                name: values.take(given, 0) if taken else values[given]
                for name, values in self.__dict__.items()
                if isinstance(values, np.ndarray)
            }
        )

    def _with_columns(self, columns: Mapping[str, Any]) -> Self:
        """The same with other columns, which were checked and are nobody else's to write to."""
        for values in columns.values():
            if isinstance(values, np.ndarray):
                read_only(values)
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__)
        new.__dict__.update(columns)
        return new

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for value in state.values():
            if isinstance(value, np.ndarray):
                read_only(value)
