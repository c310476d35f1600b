"""What a metric looks at: a result and its truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from featreg.results.registration import Registration
from featreg.study.evaluation import Scores, evaluate, stage_mask
from featreg.study.measures import match_errors, repeatable
from featreg.study.truth import Truth
from featreg.types import FloatArray


@dataclass(frozen=True, eq=False)
class Case:
    """All that a metric may look at.

    Parameters
    ----------
    registration : the result
    truth : where points really lie; None where it is not known
    threshold : px, greatest distance of a correct match
    stage : at which NM is counted; None for that of `featreg.study.evaluation.default_stage`
    act : stage -> seconds, measured in a serial pass; None where it was not
    keypoints : (N, 2) of the reference and of the secondary; None where they were not asked for or there are none
    """

    registration: Registration
    truth: Truth | None = None
    threshold: float = 1.5
    stage: str | None = None
    act: Mapping[str, float] | None = None
    keypoints: tuple[FloatArray, FloatArray] | None = None

    @cached_property
    def scores(self) -> Scores | None:
        """Everything that `evaluate` gives."""
        if self.truth is None:
            return None
        return evaluate(self.registration, self.truth, self.threshold, self.stage)

    @cached_property
    def errors(self) -> FloatArray | None:
        """(NM,) px, distances of the scored matches from the truth; NaN where it is not known."""
        if self.truth is None:
            return None
        rows = stage_mask(self.registration, self.stage)
        matches = self.registration.matches
        return match_errors(matches.reference_xy[rows], matches.secondary_xy[rows], self.truth)

    @property
    def model_error(self) -> float | None:
        """px, grid RMSE of a model that was returned as "ok"; infinite where none was."""
        if self.scores is None:
            return None
        if self.registration.status != "ok" or self.scores.model_failed:
            return float("inf")
        return None if np.isnan(self.scores.grid_rmse) else self.scores.grid_rmse

    @cached_property
    def found_again(self) -> tuple[int, int, int] | None:
        """(repeatable points, reference keypoints, secondary keypoints), each within the other image."""
        shapes = [self.shape("reference"), self.shape("secondary")]
        if self.truth is None or self.keypoints is None or shapes[0] is None or shapes[1] is None:
            return None
        return repeatable(*self.keypoints, self.truth, (shapes[0], shapes[1]), self.threshold)

    def shape(self, role: str) -> tuple[int, int] | None:
        """(H, W) of an image as the result says it."""
        image = self.registration.reference if role == "reference" else self.registration.secondary
        return None if image is None else image.shape
