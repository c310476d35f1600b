"""Heights of the ground above the ellipsoid; one number everywhere is the simplest."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.types import FloatArray


class Heights(ABC):
    """Metres above the WGS84 ellipsoid, anywhere."""

    @abstractmethod
    def at(self, lonlat: FloatArray) -> FloatArray:
        """Return (N,) heights at (N, 2) longitude and latitude in degrees; NaN where the point itself is not finite."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """A JSON-able dict from which `heights_from_dict` makes the same heights."""


@dataclass(frozen=True)
class ConstantHeight(Heights):
    """The same height everywhere, in metres above the ellipsoid.

    Raises
    ------
    InputError
        The height is not finite.
    """

    metres: float = 0.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.metres):
            raise InputError(f"a constant height must be a finite number of metres, got {self.metres}")
        object.__setattr__(self, "metres", float(self.metres))

    def at(self, lonlat: FloatArray) -> FloatArray:
        return np.where(np.isfinite(lonlat).all(axis=1), self.metres, np.nan)

    def to_dict(self) -> dict[str, Any]:
        return {"type": "constant", "metres": self.metres}
