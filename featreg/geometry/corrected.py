"""Models that are a known map followed by a correction, so that only the correction has to be estimated."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from featreg.interfaces import Model
from featreg.types import FloatArray


class CorrectedModel(Model):
    """``correction(known(xy))``, the known map taken from somewhere else (two sensors, for example).

    What has to be searched or judged by sampling is the correction alone: hypotheses and standard errors are those of
    `correction_kind` on the points ``known(reference_xy)``, however little the known map looks like a plane one.
    """

    #: The model of the correction.
    correction_kind: ClassVar[type[Model]]

    @classmethod
    @abstractmethod
    def known(cls, xy: FloatArray) -> FloatArray:
        """Map (N, 2) reference points to the secondary image without the correction; NaN where that cannot be done."""

    @classmethod
    @abstractmethod
    def with_correction(cls, correction: Model) -> Self:
        """Return the model with this correction."""

    @property
    @abstractmethod
    def correction(self) -> Model:
        """The correction, in secondary pixels."""

    def residuals(self, reference_xy: ArrayLike, secondary_xy: ArrayLike) -> FloatArray:
        """(M,) distances in pixels; very large where a reference point cannot be mapped."""
        return np.asarray(np.nan_to_num(super().residuals(reference_xy, secondary_xy), nan=1e9))
