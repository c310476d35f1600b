"""The descriptor of BFSIFT: histograms of the gradients of the bilateral scale space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive
from featreg.sar.gradients.bilateral import BilateralSpace, bilateral_field
from featreg.sar.gradients.gradient_field import from_base
from featreg.sar.keypoints.gradient_histograms import Harmonics, Step, described, gloh, normalised, row_length
from featreg.sar.pyramid import pyramid
from featreg.types import Features, Image


@register("bf-sift")
@dataclass(frozen=True)
class BfSiftDescriptor(Descriptor):
    """Log-polar histograms (17 cells) of gradients in a bilateral scale space, in the point's direction.

    Parameters
    ----------
    octaves, intervals, sigma, tone, exact : of the scale space, as in the detector `bf-sift`
    support : a keypoint of this many times the sigma of a level belongs to that level
    coarser : the gradients are taken from the level whose sigma is so many times larger
    step : distance of the samples relative to the radius
    harmonics : Fourier harmonics kept of the directions of each cell, beside their mean, 0 to 4; 4 keeps the histograms
        of eight directions themselves

    Notes
    -----
    S. Wang, H. You, K. Fu, "BFSIFT: a novel method to find feature matches for SAR image registration", IEEE Geosci.
    Remote Sens. Lett. 9 (2012) 649, DOI 10.1109/LGRS.2011.2177437, takes SIFT's descriptor from the bilateral scale
    space. Departures: GLOH's 17 circular cells instead of SIFT's 4 x 4 square ones, so that the methods compared differ
    in their gradients only; gradients half as coarse again as the keypoint, as what is left of speckle needs it. Two
    harmonics of a cell's directions instead of eight bins. What lies outside the image or on nodata counts as no
    gradient; keypoints that lie there themselves are dropped.
    """

    octaves: Count = 2
    intervals: Count = 3
    sigma: Positive = 1.2
    tone: Positive = 5.0
    exact: bool = False
    support: Positive = 8.0
    coarser: Positive = 1.5
    step: Step = 0.125
    harmonics: Harmonics = 2

    def reach_of(self, scale: float) -> float:
        """The radius, and twice the standard deviation of the gradients' level at its rim."""
        return scale + 2 * max(self.sigma, scale * self.coarser / self.support)

    def describe_features(self, image: Image, features: Features) -> Features:
        space = BilateralSpace(self.intervals, float(self.sigma), float(self.tone), self.exact)
        chain = pyramid(image, self.octaves, 2.0)
        wanted = np.maximum(features.scale, 1e-9) * self.coarser / self.support / self.sigma
        steps = np.rint(np.log2(wanted) * self.intervals).astype(np.int64)
        number = np.clip(steps, 1, len(chain) * self.intervals) - 1
        cells = np.zeros((len(features), row_length(self.harmonics)), np.float32)
        for n in np.unique(number):
            rows = np.flatnonzero(number == n)
            octave, interval = divmod(int(n), self.intervals)
            level = chain[octave]
            field = bilateral_field(level, space, interval + 1)
            cells[rows] = gloh(
                field, from_base(features.xy[rows], level, image),
                features.scale[rows] * level.shape[1] / image.shape[1], features.angle[rows], self.harmonics, self.step,
            )  # fmt: skip
        return described(image, features, normalised(cells))
