"""A named array of a file of gridded data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.io.cf_places import text_of


@dataclass(frozen=True, eq=False)
class Variable:
    """A named array of a file.

    Parameters
    ----------
    name : its full path
    shape, dtype : of the array; a compound of two numbers counts as complex
    attributes : by name
    read : called with a slice for each axis
    dimensions : full paths of the coordinate variables of its axes, "" where there is none
    fill : the value that stands where nothing was written, if the file knows one
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    attributes: Mapping[str, Any]
    read: Callable[[tuple[Any, ...]], NDArray[Any]]
    dimensions: Sequence[str] = field(default=())
    fill: float | None = None

    @cached_property
    def parts(self) -> tuple[str, str] | None:
        """The names of real and imaginary part where samples are kept as a pair of numbers."""
        names = [name.lower() for name in self.dtype.names or ()]
        if names in (["r", "i"], ["real", "imag"], ["re", "im"]):
            return self.dtype.names[0], self.dtype.names[1]  # type: ignore[index]  # there are names where `names` is not empty
        return None

    @property
    def unsigned(self) -> bool:
        """Whether signed numbers stand for unsigned ones, which netCDF's classic format lacks."""
        return self.dtype.kind == "i" and text_of(self.attributes.get("_Unsigned")).lower() == "true"

    @property
    def is_image(self) -> bool:
        """Whether it has two axes, others of length 1 before them apart."""
        flat = len(self.shape) >= 2 and all(n == 1 for n in self.shape[:-2]) and min(self.shape[-2:]) > 1
        return flat and (self.parts is not None or self.dtype.kind in "uifc")

    def samples(self, rows: slice, cols: slice) -> NDArray[Any]:
        raw = self.read((*(0 for _ in self.shape[:-2]), rows, cols))
        raw = raw.reshape(raw.shape[-2:])
        if self.parts is None and self.unsigned:
            return raw.astype(raw.dtype.newbyteorder("=")).view(raw.dtype.name.replace("int", "uint"))
        if self.parts is None:
            return raw.astype(raw.dtype.newbyteorder("="), copy=False)
        out = np.empty(raw.shape, np.complex64)
        out.real, out.imag = raw[self.parts[0]], raw[self.parts[1]]
        return out
