"""Ratio GLOH: histograms of ratio gradients in log-polar cells around a keypoint, the descriptor of SAR-SIFT."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval

from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.runtime.parameters import Positive
from featreg.sar.gradients.gradient_field import COARSEST_GRID, from_base, octave, ratio_field
from featreg.sar.keypoints.gradient_histograms import Harmonics, Step, described, gloh, normalised, row_length
from featreg.types import Features, Image


@register("ratio-gloh")
@dataclass(frozen=True)
class RatioGloh(Descriptor):
    """Log-polar histograms (17 cells) of ROEWA ratio gradients, in the keypoint's direction.

    Parameters
    ----------
    support : the gradients' alpha is the keypoint's scale (the descriptor's radius) divided by this
    finest : least alpha in pixels
    factor : ratio of neighbouring alphas, of which the nearest is taken, starting at `finest`
    floor : added to the means before their ratio is taken, relative to the image's mean amplitude
    step : distance of the samples relative to the radius
    soft : share a sample between neighbouring cells instead of giving it to one
    root : root of the share of each component (of each cell, where harmonics are kept) instead of clipping (RootSIFT)
    harmonics : Fourier harmonics kept of the directions of each cell, beside their mean, 0 to 4; 4 keeps the histograms
        of eight directions themselves
    exact : compute every alpha on the image itself; otherwise coarse ones on an image halved one or more times

    Notes
    -----
    F. Dellinger, J. Delon, Y. Gousseau, J. Michel, F. Tupin, "SAR-SIFT: a SIFT-like algorithm for SAR images", IEEE
    TGRS 53 (2015) 453, DOI 10.1109/TGRS.2014.2323552: circular neighbourhood of radius 12 alpha, log-polar sectors,
    histograms of the directions of the ratio gradient weighted by its magnitude, normalised and clipped as in SIFT.

    Departures: directions are counted relative to the keypoint's; samples are shared between cells; of the directions
    of a cell two harmonics are kept, which match as well as eight bins in less time; alpha never falls below `finest`,
    because finer gradients are speckle; samples lie 1.5 alpha apart by default, where the gradients are nearly
    independent. Fields of large alpha are computed on a halved image unless `exact`. What lies outside the image or
    near nodata counts as no gradient; only keypoints that lie there themselves, or without any gradient, are dropped.
    """

    support: Positive = 12.0
    finest: Positive = 2.0
    factor: Annotated[float, Interval(gt=1, lt=math.inf)] = 2 ** (1 / 3)
    floor: Annotated[float, Interval(ge=0, lt=math.inf)] = 0.01
    step: Step = 0.125
    soft: bool = True
    root: bool = False
    harmonics: Harmonics = 2
    exact: bool = False

    def reach_of(self, scale: float) -> float:
        """The radius, and twice the exponential weight of the gradients at its rim."""
        return scale + 2 * max(self.finest, scale / self.support)

    def describe_features(self, image: Image, features: Features) -> Features:
        cells = np.zeros((len(features), row_length(self.harmonics)), np.float32)
        steps = np.log(np.maximum(features.scale / self.support / self.finest, 1)) / math.log(self.factor)
        number = np.rint(np.minimum(steps, math.log(max(image.shape)) / math.log(self.factor))).astype(np.int64)
        for n in np.unique(number):
            rows = np.flatnonzero(number == n)
            alpha = self.finest * self.factor ** int(n)
            level, alpha = octave(image, alpha, math.inf if self.exact else COARSEST_GRID)
            smaller = level.shape[1] / image.shape[1]
            cells[rows] = gloh(
                ratio_field(level, alpha, self.floor), from_base(features.xy[rows], level, image),
                features.scale[rows] * smaller, features.angle[rows], self.harmonics, self.step, self.soft,
            )  # fmt: skip
        return described(image, features, normalised(cells, self.root))
