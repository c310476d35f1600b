"""Fast sample consensus: hypotheses from the most confident matches, consensus among all."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from featreg.geometry.robust import fit_consensus
from featreg.interfaces import Filter, FilterContext
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive, Probability, Share
from featreg.types import BoolArray, Matches


@register("fsc")
@dataclass(frozen=True)
class Fsc(Filter):
    """Fast sample consensus: hypotheses from the most confident matches, consensus among all.

    Parameters
    ----------
    threshold : largest distance from the model of a match that is kept, px in the secondary image
    iterations : most hypotheses
    share : share of the matches, best scores first, from which hypotheses are drawn; 1 is plain RANSAC
    confidence : probability with which a sample of good matches has been drawn when the search stops early

    Notes
    -----
    The paper draws from the matches that pass a strict ratio test and counts those that pass a loose one; here the
    scores of any matcher rank them. The share never falls below eight samples' worth of matches, and where all scores
    are equal, and so say nothing, all matches are drawn from.

    Departures: hypotheses are compared by the truncated quadratic cost instead of the number of inliers and polished by
    least squares, and the search stops when the confidence is reached (see `featreg.geometry.robust.fit_consensus`,
    which also says how models without hypotheses of their own are sought: by affine ones within a wider threshold). The
    paper's iterative removal of the worst tie points afterwards is a matter of refinement and not part of this filter.

    References
    ----------
    Y. Wu, W. Ma, M. Gong, L. Su, L. Jiao, "A novel point-matching algorithm based on fast sample consensus for image
    registration", IEEE Geosci. Remote Sens. Lett. 12(1), 43-47, 2015, DOI 10.1109/LGRS.2014.2325970
    """

    threshold: Positive = 3.0
    iterations: Count = 800
    share: Share = 0.3
    confidence: Probability = 0.999

    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        """Return the matches within the threshold of the best model; all False where there is none."""
        score = matches.score
        candidates = None
        if len(matches) and score.min() < score.max():
            size = max(math.ceil(self.share * len(matches)), 8 * max(context.model.minimum, 3))
            candidates = np.argsort(-score, kind="stable")[:size]
        _, inliers = fit_consensus(
            context.model,
            matches.reference_xy,
            matches.secondary_xy,
            threshold=self.threshold,
            rng=context.rng,
            candidates=candidates,
            iterations=self.iterations,
            confidence=self.confidence,
        )
        return inliers
