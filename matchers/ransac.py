"""RANSAC: our seeded sampler, or one of OpenCV's estimators where OpenCV has one for the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from featreg.errors import ParameterError
from featreg.geometry.robust import fit_consensus
from featreg.interfaces import Filter, FilterContext, Model
from featreg.registry import model_name, register
from featreg.runtime.parameters import Count, Positive, Probability
from featreg.types import BoolArray, Matches

USAC = ("usac-default", "usac-fast", "usac-accurate", "usac-magsac")
#: Model -> OpenCV's function and the estimators it takes (`estimateAffinePartial2D` raises for USAC and RHO).
OPENCV: dict[str, tuple[str, tuple[str, ...]]] = {
    "similarity": ("estimateAffinePartial2D", ("ransac", "lmeds")),
    "affine": ("estimateAffine2D", ("ransac", "lmeds", *USAC)),
    "homography": ("findHomography", ("ransac", "lmeds", "rho", *USAC)),
}
Estimator = Literal[
    "own", "ransac", "lmeds", "rho", "usac-default", "usac-fast", "usac-accurate", "usac-magsac"
]  # fmt: skip


@register("ransac")
@dataclass(frozen=True)
class Ransac(Filter):
    """RANSAC over all matches: our seeded sampler, or one of OpenCV's estimators.

    Parameters
    ----------
    threshold : largest distance from the model of a match that is kept, px in the secondary ("lmeds" finds its own)
    iterations : most hypotheses
    confidence : probability with which a sample of good matches has been drawn when the search stops early
    estimator : "own" for any model; of OpenCV "ransac" and "lmeds" for similarity, these and "usac-default",
        "usac-fast", "usac-accurate", "usac-magsac" for affine, all of these and "rho" for homography

    Raises
    ------
    ParameterError
        A value that is impossible, or, when it filters, an estimator that OpenCV does not have for the model.

    Notes
    -----
    Only "own" draws from the context's random generator. OpenCV's estimators seed themselves: `cv2.setRNGSeed` does not
    reach them, equal input gives equal output. They compute in float32, so they are given centred coordinates.
    USAC_PROSAC is left out: it needs sorted matches and accepts models of three inliers. "lmeds" needs more than half
    of the matches to be good. `featreg.geometry.robust.fit_consensus` documents "own", also for models without
    hypotheses of their own.
    """

    threshold: Positive = 3.0
    iterations: Count = 5000
    confidence: Probability = 0.999
    estimator: Estimator = "own"

    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        """Return the inliers of the best model; all False where there is none."""
        if self.estimator != "own":
            return self._opencv(matches, context.model)
        _, inliers = fit_consensus(
            context.model,
            matches.reference_xy,
            matches.secondary_xy,
            threshold=self.threshold,
            rng=context.rng,
            iterations=self.iterations,
            confidence=self.confidence,
        )
        return inliers

    def _opencv(self, matches: Matches, model: type[Model]) -> BoolArray:
        import cv2

        name = model_name(model)
        function, estimators = OPENCV.get(name, ("", ()))
        if self.estimator not in estimators:
            raise ParameterError(
                f"ransac: OpenCV has no estimator '{self.estimator}' for the model '{name}'; "
                f"for this model use {' or '.join(repr(e) for e in ('own', *estimators))}"
            )
        none = np.zeros(len(matches), np.bool_)
        # One match more than the model needs is the least that says anything.
        if len(matches) <= model.minimum:
            return none
        reference = matches.reference_xy - matches.reference_xy.mean(axis=0)
        secondary = matches.secondary_xy - matches.secondary_xy.mean(axis=0)
        arguments: dict[str, Any] = {
            "method": getattr(cv2, self.estimator.replace("-", "_").upper()),
            "ransacReprojThreshold": self.threshold,
            "maxIters": self.iterations,
            "confidence": self.confidence,
        }
        try:
            found, mask = getattr(cv2, function)(reference, secondary, **arguments)
        except cv2.error:
            return none
        if found is None or mask is None or not np.isfinite(found).all():
            return none
        inliers = np.asarray(mask).reshape(-1) != 0
        return inliers if inliers.sum() > model.minimum else none
