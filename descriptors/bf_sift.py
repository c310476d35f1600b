"""The descriptor of BFSIFT: histograms of the gradients of the bilateral scale space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from featreg.errors import ParameterError
from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.sar.gradients.bilateral import BilateralSpace, bilateral_field
from featreg.sar.gradients.gradient_field import from_base
from featreg.sar.keypoints.gradient_histograms import HARMONICS, described, gloh, normalised, row_length
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

    octaves: int = 2
    intervals: int = 3
    sigma: float = 1.2
    tone: float = 5.0
    exact: bool = False
    support: float = 8.0
    coarser: float = 1.5
    step: float = 0.125
    harmonics: int = 2

    def __post_init__(self) -> None:
        if (
            self.octaves < 1
            or self.intervals < 1
            or not all(0 < value < math.inf for value in (self.sigma, self.tone, self.support))
        ):
            raise ParameterError(
                "bf-sift needs octaves and intervals >= 1, and finite sigma, tone and support > 0, got "
                f"{self.octaves}, {self.intervals}, {self.sigma}, {self.tone} and {self.support}"
            )
        if not 0 < self.coarser < math.inf or not 0.01 <= self.step <= 0.25:
            raise ParameterError(
                f"bf-sift needs coarser > 0 and 0.01 <= step <= 0.25, got {self.coarser} and {self.step}"
            )
        if not 0 <= self.harmonics <= HARMONICS:
            raise ParameterError(f"bf-sift needs 0 <= harmonics <= {HARMONICS}, got {self.harmonics}")

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
