"""Ratio GLOH: histograms of ratio gradients in log-polar cells around a keypoint."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.sar.gradient_histograms import gloh, normalised, octave, ratio_field
from featreg.types import Features, Image


@register("ratio-gloh")
@dataclass(frozen=True)
class RatioGloh(Descriptor):
    support: float = 12.0
    factor: float = 2 ** (1 / 3)
    floor: float = 0.01
    step: float = 0.125
    root: bool = False
    soft: bool = True
    grow: float = 1.0
    fine: float = 2.0

    def describe_features(self, image: Image, features: Features) -> Features:
        out = np.zeros((len(features), 136), np.float32)
        wanted = features.scale / self.support
        number = np.maximum(np.rint(np.log(np.maximum(wanted, 1e-9) / self.fine) / math.log(self.factor)), 0).astype(
            int
        )
        for n in np.unique(number):
            rows = np.flatnonzero(number == n)
            level, alpha = octave(image, self.fine * self.factor ** int(n))
            s = np.array(level.shape[::-1]) / image.shape[::-1]
            xy = (features.xy[rows] + 0.5) * s - 0.5
            out[rows] = gloh(
                ratio_field(level, alpha, self.floor),
                xy,
                features.scale[rows] * s[0] * self.grow,
                features.angle[rows],
                self.step,
                self.soft,
            )
        return Features(
            features.xy,
            features.scale,
            features.angle,
            features.score,
            features.level,
            normalised(out, self.root),
            "l2",
            np.arange(len(features)),
        )
