"""Prewitt feature points: pixels where the amplitude changes abruptly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.interfaces import Detector
from featreg.registry import register
from featreg.runtime.parameters import Count
from featreg.types import BoolArray, Features, Image

#: Rows whose gradients are computed at a time.
STRIP = 256
#: Pixels from a point to the edge of its 3 x 3 neighbourhood.
REACH = 1.5


@register("prewitt")
@dataclass(frozen=True)
class Prewitt(Detector):
    """Pixels whose Prewitt gradient exceeds a threshold.

    Parameters
    ----------
    n_features : at most so many points, the steepest first
    threshold : T: a point's gradient exceeds it, relative to `relative_to`
    relative_to : "mean" or "max" of the gradient over the image
    length : of the gradient: "euclidean", the root of the sum of squares, or "absolute", the sum of the magnitudes

    Notes
    -----
    Eq. 6 to 9 of the PMEA autofocus paper: 3 x 3 Prewitt gradients of the amplitude, their length, and a threshold.
    The paper at hand does not show the length (Eq. 8) and leaves the threshold open: four times the mean gradient, like
    0.3 times the largest (``relative_to="max", threshold=0.3``), gave usable range cells on point targets and on Gotcha
    images. No neighbourhood is suppressed, since the paper counts all points; the angle is that of the gradient.
    """

    n_features: Count = 5000
    threshold: Annotated[float, Interval(ge=0, lt=math.inf)] = 4.0
    relative_to: Literal["mean", "max"] = "mean"
    length: Literal["euclidean", "absolute"] = "euclidean"

    def detect_features(self, image: Image) -> Features:
        size, used = self._gradient(image)
        inner = used if used is not None else np.s_[1:-1, 1:-1]
        seen = size[inner]
        if not seen.size:
            return Features.empty()
        level = float(seen.max() if self.relative_to == "max" else seen.mean(dtype=np.float64))
        # Rounding leaves steps of 1e-6 of the amplitude in a flat image.
        least = max(self.threshold * level, 1e-5 * float(image.amplitude.max()))
        flat = np.flatnonzero(size > least)
        score = size.ravel()[flat]
        if len(flat) > self.n_features:
            near = score >= np.partition(score, len(score) - self.n_features)[len(score) - self.n_features]
            flat, score = flat[near], score[near]
        order = np.argsort(-score, kind="stable")[: self.n_features]
        y, x = np.divmod(flat[order], size.shape[1])
        gx, gy = (_at(image.amplitude, x, y, axis) for axis in (1, 0))
        return Features(
            xy=np.column_stack([x, y]).astype(np.float64),
            scale=np.full(len(x), REACH),
            angle=np.mod(np.arctan2(-gy, gx), 2 * np.pi),
            score=score[order].astype(np.float64),
            level=np.zeros(len(x), np.int64),
        )

    def _gradient(self, image: Image) -> tuple[NDArray[np.float32], BoolArray | None]:
        """(H, W) length of the gradient, 0 where its window leaves the image or the data, and where it does not."""
        amplitude = image.amplitude
        size = np.zeros(amplitude.shape, np.float32)
        for top in range(1, len(amplitude) - 1, STRIP):
            stop = min(top + STRIP, len(amplitude) - 1)
            part = amplitude[top - 1 : stop + 1]
            # Plain sums: OpenCV's filters round differently from one memory alignment to another.
            down = part[:-2] + part[1:-1] + part[2:]
            across = part[:, :-2] + part[:, 1:-1] + part[:, 2:]
            gx, gy = down[:, 2:] - down[:, :-2], across[2:] - across[:-2]
            size[top:stop, 1:-1] = np.abs(gx) + np.abs(gy) if self.length == "absolute" else np.sqrt(gx * gx + gy * gy)
        if image.all_valid:
            return size, None
        import cv2

        used = np.asarray(
            cv2.erode(image.mask.view(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT,
                      borderValue=0)
        ).view(np.bool_)  # fmt: skip
        size[~used] = 0
        return size, used


def _at(amplitude: NDArray[np.float32], x: NDArray[np.int64], y: NDArray[np.int64], axis: int) -> NDArray[np.float64]:
    """Prewitt gradient (Eq. 6 and 7) along an axis at inner pixels."""
    total = np.zeros(len(x))
    for side in (-1, 0, 1):
        for sign in (-1, 1):
            dx, dy = (sign, side) if axis == 1 else (side, sign)
            total += sign * amplitude[y + dy, x + dx].astype(np.float64)
    return total
