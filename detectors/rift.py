"""Corner and edge points of phase congruency, as RIFT detects them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.interfaces import Detector
from featreg.registry import register
from featreg.sar.corners import fast_corners, orientation, refine_centroid
from featreg.sar.log_gabor import LogGabor
from featreg.sar.phase_congruency import Congruency, congruency_maps, without_rim
from featreg.sar.pyramid import clear
from featreg.types import Features, Image


@register("phase-congruency")
@dataclass(frozen=True)
class PhaseCongruency(Detector):
    n_features: int = 5000
    corner_share: float = 0.5
    threshold: int = 5
    support: float = 20.0
    subpixel: str = "centroid"
    sigma: float = 1.0
    scales: int = 4
    orientations: int = 6
    min_wavelength: float = 3.0
    multiplier: float = 1.6
    bandwidth: float = 0.75
    noise: float = 1.0
    floor: float = 0.3
    blur: float = 0.0
    dedupe: float = 0.0
    top: float = 0.99

    def detect_features(self, image: Image) -> Features:
        bank = LogGabor(self.scales, self.orientations, self.min_wavelength, self.multiplier, self.bandwidth)
        largest, smallest, _, mask = congruency_maps(image, bank, Congruency(self.noise, floor=self.floor))
        allowed = clear(without_rim(image), self.support)
        found = []
        import cv2
        maps = [quantised(cv2.GaussianBlur(m, (0, 0), self.blur) if self.blur else m, mask, self.top) for m in (smallest, largest)]
        for m in maps:
            found.append(fast_corners(m, self.threshold, allowed, self.n_features))
            if self.dedupe:
                disc = np.zeros(allowed.shape, np.uint8)
                disc[found[-1][0][:, 1], found[-1][0][:, 0]] = 1
                r = int(self.dedupe)
                allowed = allowed & (cv2.dilate(disc, np.ones((2 * r + 1, 2 * r + 1), np.uint8)) == 0)
        supply = [len(f[0]) for f in found]
        corners = min(supply[0], max(round(self.corner_share * self.n_features), self.n_features - supply[1]))
        counts = [corners, min(supply[1], self.n_features - corners)]
        parts = []
        for level, (m, (xy, score), count) in enumerate(zip(maps, found, counts)):
            at = xy[:count]
            parts.append(
                Features(
                    refine_centroid(m, at, self.sigma)[0] if self.subpixel == "centroid" else at.astype(float),
                    self.support,
                    orientation(largest, at, 15),
                    score[:count].astype(np.float64),
                    np.zeros(count, np.int64),
                )
            )
        everything = Features.concatenate(parts)
        return everything.take(np.argsort(-everything.score, kind="stable"))


def quantised(strength: NDArray[np.float32], mask: NDArray[np.bool_], top: float) -> NDArray[np.uint8]:
    import cv2

    sample = strength[::7, ::7][mask[::7, ::7]]
    top = float(np.quantile(sample, top)) if sample.size else 0.0
    if not top > 0:
        return np.zeros(strength.shape, np.uint8)
    return np.asarray(cv2.convertScaleAbs(strength, alpha=255 / top), np.uint8)
