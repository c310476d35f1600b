"""A detector with a parameter whose name means something to detectors of OpenCV, and not here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Interval

from featreg import Detector, Features, Image, register


@register("outside-corners")
@dataclass(frozen=True)
class OutsideCorners(Detector):
    """Maxima of the smaller eigenvalue of the structure tensor of the logarithm.

    Parameters
    ----------
    n_features : at most so many
    sigma : of the smoothing before, px
    describe : weigh the corners by their contrast, and not at all
    spacing : half the side of the square in which a corner is the largest, px
    """

    block_parameters: ClassVar[Mapping[str, Any]] = MappingProxyType({"spacing": 2})

    n_features: Annotated[int, Ge(1)] = 5000
    sigma: Annotated[float, Interval(gt=0, le=10)] = 1.2
    describe: bool = True
    spacing: Annotated[int, Interval(ge=1, le=50)] = 3

    def detect_features(self, image: Image) -> Features:
        from scipy import ndimage

        good = image.mask & (image.amplitude > 0)
        if not good.any():
            return Features.empty()
        middle = float(np.median(image.amplitude[good]))
        view = np.log(np.where(good, image.amplitude, middle).astype(np.float64) / middle)
        smooth = ndimage.gaussian_filter(view, self.sigma, mode="nearest")
        dy, dx = np.gradient(smooth)
        a, b, c = (ndimage.gaussian_filter(p, 2 * self.sigma, mode="nearest") for p in (dx * dx, dx * dy, dy * dy))
        strength = (a + c) / 2 - np.hypot((a - c) / 2, b)
        peak = strength == ndimage.maximum_filter(strength, 2 * self.spacing + 1, mode="nearest")
        reach = round(self.reach)
        clear = ndimage.binary_erosion(image.mask, np.ones((2 * reach + 1, 2 * reach + 1), np.bool_), border_value=0)
        y, x = np.nonzero(peak & clear & (strength > 1e-6))
        score = strength[y, x] if self.describe else np.ones(len(x), np.float64)
        n = len(x)
        xy = np.column_stack([x, y]).astype(np.float64)
        found = Features(xy, np.full(n, 8.0), np.zeros(n), score, np.zeros(n, np.int64))
        return found.best(self.n_features)

    @property
    def reach(self) -> float:
        return 16.0
