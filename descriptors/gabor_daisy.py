"""GOF in DAISY's cells: ratio gradients of odd Gabor filters, at one scale (S-GOF) or several (M-GOF)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval

from featreg.errors import ParameterError
from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive
from featreg.sar.gradients.gabor import gabor_fields
from featreg.sar.gradients.gradient_field import octave
from featreg.sar.keypoints.daisy import LENGTH, Gradients, daisy
from featreg.sar.keypoints.gradient_histograms import described
from featreg.types import Features, Image

# The filters run on the coarsest halving of the image on which the sigma of the finest is at least so many pixels.
COARSEST_GRID = 1.4
# Gradients are computed in every other row and column of that, of this sigma on in every fourth.
SPARSE = 2.7


@register("gabor-daisy")
@dataclass(frozen=True)
class GaborDaisy(Descriptor):
    """Harmonics of the directions of odd-Gabor ratio gradients in 13 round cells, in the keypoint's direction.

    Parameters
    ----------
    scales, sigma, factor : how many scales of filters, the standard deviation in pixels of the finest across the edge,
        and the ratio of neighbours; the same filters serve keypoints of every scale
    orientations : filter directions over half a turn
    floor : added to the means before their ratio is taken, relative to the image's mean amplitude
    magnification : the radius is so many times the keypoint's scale; 6 suits OpenCV's SIFT, which gives its sigma

    Raises
    ------
    ParameterError
        The coarsest filter has a sigma of more than 100 px, or of more than 16 times that of the finest.

    Notes
    -----
    The gradients are those of `gabor-odd`, after S. Paul, U. C. Pati, "A Gabor Odd Filter-Based Ratio Operator for SAR
    Image Matching", IEEE Geosci. Remote Sens. Lett. 16 (2019) 397, DOI 10.1109/LGRS.2018.2872979, the cells those of
    DAISY (E. Tola, V. Lepetit, P. Fua, IEEE TPAMI 32 (2010) 815, DOI 10.1109/TPAMI.2009.77): Gaussians of 0.2 of the
    radius, one in the middle, four and eight on rings, read from maps that are smoothed once. Several scales are joined
    by adding their gradients' lengths and harmonics before cells gather them, where `gabor-odd` adds normalised
    histograms: as distinctive, and no dearer for four scales than for one but for the filters. These are evaluated in
    every other row and column, those of a sigma of 2.7 pixels or more in every fourth with a straight line between.
    What lies outside the image or near nodata counts as no gradient; only keypoints that lie there themselves, or have
    no gradient around them, are dropped.
    """

    scales: Count = 1
    sigma: Annotated[float, Interval(ge=0.5, le=100)] = 2.0
    factor: Annotated[float, Interval(gt=1, lt=math.inf)] = math.sqrt(2)
    orientations: Annotated[int, Ge(2)] = 3
    floor: Annotated[float, Interval(ge=0, lt=math.inf)] = 0.01
    magnification: Positive = 1.0

    def __post_init__(self) -> None:
        wider = (self.scales - 1) * math.log(self.factor)
        if wider > math.log(16) + 1e-9 or math.log(self.sigma) + wider > math.log(100) + 1e-9:
            raise ParameterError(
                "gabor-daisy needs a coarsest sigma * factor ** (scales - 1) of at most 100 px and 16 times sigma, got "
                f"{self.sigma} * {self.factor} ** {self.scales - 1}"
            )

    def reach_of(self, scale: float) -> float:
        """That of the outermost cells, and twice the standard deviation of the coarsest filter at their rim."""
        return 1.3 * self.magnification * scale + 2 * self.sigma * self.factor ** (self.scales - 1)

    def form(self) -> tuple[str, int]:
        return "l2", LENGTH

    def describe_features(self, image: Image, features: Features) -> Features:
        level, finest = octave(image, self.sigma, COARSEST_GRID)
        sigmas = tuple(finest * self.factor**k for k in range(self.scales))
        spacings = tuple(4 if sigma >= SPARSE else 2 for sigma in sigmas)
        gradients = Gradients(gabor_fields, (sigmas, spacings, 2, self.orientations, self.floor), 2)
        return described(image, features, daisy(image, level, gradients, features, self.magnification * features.scale))
