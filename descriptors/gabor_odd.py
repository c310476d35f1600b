"""GOF: histograms of odd-Gabor ratio gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.sar.gabor import gabor_gradients
from featreg.sar.gradient_histograms import PolarField, gloh, normalised
from featreg.types import Features, Image


@register("gabor-odd")
@dataclass(frozen=True)
class GaborOdd(Descriptor):
    scales: int = 1
    sigma: float = 2.0
    factor: float = math.sqrt(2)
    orientations: int = 6
    floor: float = 0.01
    step: float = 0.125
    mode: str = "sum"

    def describe_features(self, image: Image, features: Features) -> Features:
        if self.mode == "sum":
            gx = gy = 0
            for k in range(self.scales):
                a, b = gabor_gradients(image, self.sigma * self.factor**k, self.orientations, self.floor)
                gx, gy = gx + a, gy + b
            fields = [PolarField.of(gx, gy)]
        else:
            fields = [PolarField.of(*gabor_gradients(image, self.sigma * self.factor**k, self.orientations, self.floor)) for k in range(self.scales)]
        h = [normalised(gloh(f, features.xy, features.scale, features.angle, self.step)) for f in fields]
        if self.mode == "concat":
            h = np.concatenate(h, 1) / np.float32(np.sqrt(len(h)))
        else:
            h = normalised(sum(h))
        return replace(features, descriptors=np.ascontiguousarray(h), norm="l2", index=np.arange(len(features)))
