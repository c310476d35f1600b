"""Outlier cancellation of OBCLS: the equations that fit worst go, step by step, by the median absolute deviation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from featreg.geometry.robust import fit_consensus
from featreg.interfaces import FailedFit, Filter, FilterContext
from featreg.registry import register
from featreg.runtime.parameters import Positive
from featreg.sar.obcls.cancellation import Rule, cancelled, check_kappa
from featreg.types import BoolArray, FloatArray, Matches


@register("mad")
@dataclass(frozen=True)
class Mad(Filter):
    """Cancel the tie points that fit worst, step by step, by the median absolute deviation of the errors.

    Parameters
    ----------
    cancellation : whether to cancel at all; if not, every tie point is kept
    threshold : "mad" (kappa times the scaled median absolute deviation, as published, Eq. 4) or
        "median+mad" (the same above the median of the errors)
    start : of what the first fit is: "all" tie points, or the largest "consensus" among them within `start_px`
    start_px : largest distance from the consensus of a tie point that belongs to it, px
    kappa_first, kappa_last, kappa_step : kappa falls from the first to the last

    Notes
    -----
    The errors are those of the least-squares fit of the context's model to what is left, with equal weights as in the
    paper (Eq. 3); see `featreg.sar.obcls.cancellation.cancelled`. From a first fit to all tie points, most must be
    good.

    References
    ----------
    L. Pallotta, G. Giunta, C. Clemente, J. J. Soraghan, "SAR coregistration by robust selection of extended targets and
    iterative outlier cancellation", IEEE Geosci. Remote Sens. Lett., section III
    """

    cancellation: bool = True
    threshold: Rule = "median+mad"
    start: Literal["all", "consensus"] = "all"
    start_px: Positive = 3.0
    kappa_first: Positive = 3.0
    kappa_last: Positive = 2.0
    kappa_step: Positive = 0.25

    def __post_init__(self) -> None:
        check_kappa(self.kappa_first, self.kappa_last)

    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        """Return what was not cancelled; all False where the tie points cannot be fitted."""
        if not self.cancellation:
            return np.ones(len(matches), np.bool_)

        def errors_of(kept: BoolArray) -> FloatArray | None:
            model = context.model.from_estimate(matches.reference_xy[kept], matches.secondary_xy[kept])
            if isinstance(model, FailedFit):
                return None
            return model.residuals(matches.reference_xy, matches.secondary_xy)

        first = None
        if self.start == "consensus":
            _, first = fit_consensus(
                context.model, matches.reference_xy, matches.secondary_xy, threshold=self.start_px, rng=context.rng
            )
        return cancelled(
            errors_of,
            len(matches),
            threshold=self.threshold,
            first=self.kappa_first,
            last=self.kappa_last,
            step=self.kappa_step,
            least=context.model.minimum + 1,
            start=first,
        )
