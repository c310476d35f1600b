"""A model of two scenes as a block sees it: in the pixels of its two windows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from featreg.interfaces import FailedFit, Model
from featreg.io.window import Window
from featreg.types import FloatArray


class WindowModel(Model):
    """``model(xy + here.origin) - there.origin`` of a model of the scenes, a window of the reference and one of the
    secondary; what a filter is told of the model known beforehand.
    """

    minimum: ClassVar[int] = 0

    def __init__(self, model: Model, here: Window, there: Window) -> None:
        self.model, self.here, self.there = model, here, there

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        return FailedFit("a model known beforehand is not fitted")

    def __call__(self, xy: ArrayLike) -> FloatArray:
        return self.model(np.asarray(xy, np.float64) + self.here.origin) - self.there.origin

    @property
    def inverse(self) -> Model:
        return WindowModel(self.model.inverse, self.there, self.here)

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"model": self.model, "here": self.here, "there": self.there}
