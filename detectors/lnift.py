"""Corners of the locally normalised image, LNIFT's detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Interval

from featreg.interfaces import Detector
from featreg.registry import register
from featreg.runtime.parameters import Count
from featreg.sar.gradients.local_normalisation import as_bytes, locally_normalised
from featreg.sar.keypoints.corners import fast_corners, orientation
from featreg.sar.keypoints.suppression import well_spread
from featreg.sar.pyramid import clear
from featreg.types import Features, Image

ORIENTATION_RADIUS = 15


@register("normalised-fast")
@dataclass(frozen=True)
class NormalisedFast(Detector):
    """FAST corners of an image less its local mean over its local standard deviation, well spread.

    Parameters
    ----------
    n_features : at most so many keypoints
    window : side of the square over which mean and standard deviation are taken, px
    threshold : least FAST score, of 255 for six standard deviations
    candidates : corners among which adaptive non-maximal suppression chooses, as a multiple of `n_features`
    support : radius in pixels that must be free of nodata and of the image border

    Notes
    -----
    J. Li, W. Xu, P. Shi, Y. Zhang, Q. Hu, "LNIFT: locally normalized image for rotation invariant multimodal feature
    matching", IEEE TGRS 60 (2022), DOI 10.1109/TGRS.2022.3165940: local normalisation, the keypoints of ORB with their
    intensity centroid, and adaptive non-maximal suppression. Written from what its abstract says; window, threshold and
    numbers of points are ours. Departures: corners are ranked by FAST's score, not Harris'; one level, no pyramid.
    """

    n_features: Count = 5000
    window: Annotated[int, Ge(5)] = 65
    threshold: Annotated[int, Interval(ge=0, le=254)] = 10
    candidates: Annotated[float, Interval(ge=1, le=20)] = 3.0
    support: Annotated[float, Ge(3)] = 20.0

    @property
    def reach(self) -> float:
        """The support, and half the window around its rim."""
        return self.support + self.window / 2

    def detect_features(self, image: Image) -> Features:
        allowed = clear(image, self.support)
        if not allowed.any():
            return Features.empty()
        view = locally_normalised(image, self.window)
        most = round(self.candidates * self.n_features)
        at, score = fast_corners(as_bytes(view), self.threshold, allowed, most)
        rows = well_spread(at.astype(np.float64), score.astype(np.float64), self.n_features)
        rows = rows[np.argsort(-score[rows].astype(np.float64), kind="stable")]
        at, score = at[rows], score[rows]
        return Features(
            xy=at.astype(np.float64),
            scale=self.support,  # one number stands for all rows
            angle=orientation(view, at, ORIENTATION_RADIUS),
            score=score.astype(np.float64),
            level=np.zeros(len(at), np.int64),
        )
