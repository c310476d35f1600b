"""GOF: histograms of odd-Gabor ratio gradients, at one scale (S-GOF) or several (M-GOF)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Interval

from featreg.errors import ParameterError
from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive
from featreg.sar.gradients.gabor import gabor_gradients
from featreg.sar.gradients.gradient_field import GradientField, from_base, octave
from featreg.sar.keypoints.gradient_histograms import (
    Harmonics,
    Step,
    described,
    gloh,
    normalised,
    row_length,
    unit_length,
)
from featreg.types import Features, Image

# A scale is computed on the coarsest halving of the image on which its sigma is at least so many pixels.
COARSEST_GRID = 1.4
# From this sigma on, in pixels of that halving, gradients are computed in every other row and column.
SPARSE = 1.9
# Samples lie no further apart than so much of the radius.
SPARSEST = 0.25


@register("gabor-odd")
@dataclass(frozen=True)
class GaborOdd(Descriptor):
    """Log-polar histograms (17 cells) of the ratio gradients of odd Gabor filters.

    Parameters
    ----------
    scales, sigma, factor : how many scales of filters, the standard deviation in pixels of the finest across the edge,
        and the ratio of neighbours; the same filters serve keypoints of every scale
    orientations : filter directions over half a turn
    floor : added to the means before their ratio is taken, relative to the image's mean amplitude
    step : distance of the samples relative to the radius
    spread : up to so many times the finest standard deviation samples lie that far apart; those of coarser filters,
        which smooth more, lie further apart as they are coarser, up to a quarter of the radius
    harmonics : Fourier harmonics kept of the directions of each cell, beside their mean, 0 to 4; 4 keeps the histograms
        of eight directions themselves
    magnification : the radius is so many times the keypoint's scale; 6 suits OpenCV's SIFT, which gives its sigma
    exact : compute every scale on the image itself, in every pixel, instead of coarsely where filters are wide

    Notes
    -----
    S. Paul, U. C. Pati, "A Gabor Odd Filter-Based Ratio Operator for SAR Image Matching", IEEE Geosci. Remote Sens.
    Lett. 16 (2019) 397, DOI 10.1109/LGRS.2018.2872979. The paper leaves open to us, and our reading is: the edge
    response of a direction is the logarithm of the ratio of the means under the two halves of the odd filter (so that a
    ratio and its inverse count alike), the gradient its projection on the axes (see `featreg.sar.gradients.gabor`);
    several scales are joined by adding their normalised histograms, which keeps the length and counts every scale
    alike; any detector's keypoints may be described, those kept being the ones of the highest score. Three directions
    match as well as four, six or eight. Cells are GLOH's 17 instead of SIFT's 16 square ones. Two harmonics of a cell's
    directions match as well as its eight bins. Filters of larger sigma run on a halved image, and from a sigma of 1.9
    of its pixels on in every other row and column of it, unless `exact`; the two coarser of four are sampled half as
    often (`spread`), which loses one in a hundred correct matches. What lies outside the image or near nodata counts as
    no gradient; only keypoints that lie there themselves, or have no gradient around them, are dropped.
    """

    scales: Count = 1
    sigma: Annotated[float, Interval(ge=0.5, le=100)] = 2.0
    factor: Annotated[float, Interval(gt=1, lt=math.inf)] = math.sqrt(2)
    orientations: Annotated[int, Ge(2)] = 3
    floor: Annotated[float, Interval(ge=0, lt=math.inf)] = 0.01
    step: Step = 0.125
    spread: Annotated[float, Interval(ge=1, lt=math.inf)] = math.sqrt(2)
    harmonics: Harmonics = 2
    magnification: Positive = 1.0
    exact: bool = False

    def __post_init__(self) -> None:
        if math.log(self.sigma) + (self.scales - 1) * math.log(self.factor) > math.log(100) + 1e-9:
            raise ParameterError(
                "gabor-odd needs a coarsest sigma * factor ** (scales - 1) of at most 100 px, got "
                f"{self.sigma} * {self.factor} ** {self.scales - 1}"
            )

    def reach_of(self, scale: float) -> float:
        """The radius, and twice the standard deviation of the coarsest filter at its rim."""
        return self.magnification * scale + 2 * self.sigma * self.factor ** (self.scales - 1)

    def describe_features(self, image: Image, features: Features) -> Features:
        total = np.zeros((len(features), row_length(self.harmonics)), np.float32)
        for k in range(self.scales):
            sigma = self.sigma * self.factor**k
            level, sigma = octave(image, sigma, math.inf if self.exact else COARSEST_GRID)
            sparse = sigma >= SPARSE and not self.exact
            field = GradientField(*gabor_gradients(level, sigma, self.orientations, self.floor, sparse))
            radius = self.magnification * features.scale * level.shape[1] / image.shape[1]
            xy = from_base(features.xy, level, image)
            step = max(self.step, min(SPARSEST, self.step * self.factor**k / self.spread))
            total += normalised(gloh(field, xy, radius, features.angle, self.harmonics, step))
        return described(image, features, unit_length(total))
