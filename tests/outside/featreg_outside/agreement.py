"""A filter that looks at all tie points at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Gt

from featreg import FailedFit, Filter, FilterContext, Matches, register
from featreg.geometry.robust import irls
from featreg.types import BoolArray


@register("outside-agreement")
@dataclass(frozen=True)
class OutsideAgreement(Filter):
    """Keep what agrees with the median motion, then with a robust fit.

    Parameters
    ----------
    reach : px, how far from the median motion a tie point may move
    threshold : px, how far from the fit it may lie
    """

    reach: Annotated[float, Gt(0)] = 60.0
    threshold: Annotated[float, Gt(0)] = 3.0

    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        motion = matches.secondary_xy - matches.reference_xy
        if len(matches) < context.model.minimum:
            return np.zeros(len(matches), np.bool_)
        near = np.hypot(*(motion - np.median(motion, axis=0)).T) <= self.reach
        model, _ = irls(
            context.model, matches.reference_xy[near], matches.secondary_xy[near], scale_px=1.0, iterations=30
        )
        if isinstance(model, FailedFit):
            return np.zeros(len(matches), np.bool_)
        return np.asarray(model.residuals(matches.reference_xy, matches.secondary_xy) <= self.threshold)
