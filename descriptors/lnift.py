"""Histograms of oriented gradients of the locally normalised image, LNIFT's descriptor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Interval
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.runtime.parameters import Share
from featreg.sar.gradients.lengths import lengths
from featreg.sar.gradients.local_normalisation import locally_normalised
from featreg.sar.keypoints.index_map import Cells, places_of, turned_histograms
from featreg.types import Features, Image

F32 = NDArray[np.float32]

#: Of the Gaussian before the gradients, px.
SIGMA = 1.0
# Points described at a time.
BLOCK = 512


@register("normalised-hog")
@dataclass(frozen=True)
class NormalisedHog(Descriptor):
    """Histograms of the direction of gradients, contrast forgotten, in cells that turn with the keypoint.

    Parameters
    ----------
    patch : side of the square that is described, px
    grid : cells along each side of it
    bins : of half a turn
    window : side of the square over which the image is normalised, px
    least : share of the cells that must lie on data

    Returns
    -------
    float32 unit vectors of grid * grid * bins numbers.

    Notes
    -----
    J. Li, W. Xu, P. Shi, Y. Zhang, Q. Hu, "LNIFT: locally normalized image for rotation invariant multimodal feature
    matching", IEEE TGRS 60 (2022), DOI 10.1109/TGRS.2022.3165940: a descriptor like histograms of oriented gradients
    (N. Dalal, B. Triggs, CVPR 2005, DOI 10.1109/CVPR.2005.177) of the normalised image. Written from what its abstract
    says; patch, cells and bins are those of RIFT. Departures: a gradient and its opposite are one direction, since
    sensors reverse contrast; cells stay upright squares, whose centres turn with the keypoint to every second pixel,
    and the histograms are turned by its angle; numbers are square roots (R. Arandjelovic, A. Zisserman, CVPR 2012).
    """

    patch: Annotated[float, Interval(ge=6, le=1000)] = 96.0
    grid: Annotated[int, Interval(ge=1, le=32)] = 6
    bins: Annotated[int, Interval(ge=2, le=36)] = 9
    window: Annotated[int, Ge(5)] = 65
    least: Share = 0.6

    def __post_init__(self) -> None:
        if self.patch < 4 * self.grid:
            raise ParameterError(f"normalised-hog needs patch >= 4 * grid, got {self.patch} and {self.grid}")

    def reach_of(self, scale: float) -> float:
        """Half the diagonal of the patch, which may be turned, and half the window around its corner."""
        return self.patch / math.sqrt(2) + self.window / 2 + 3 * SIGMA

    def describe_features(self, image: Image, features: Features) -> Features:
        cells = Cells(self.patch / self.grid, soft=False)
        listed = image.derive(_cell_list, side=cells.side, bins=self.bins, window=self.window)
        described, indices = [np.zeros((0, self.grid**2 * self.bins), np.float32)], [np.zeros(0, np.int64)]
        for start in range(0, len(features), BLOCK):
            xy, angle = features.xy[start : start + BLOCK], features.angle[start : start + BLOCK]
            place = places_of(cells, image.shape, xy, angle, self.grid)
            values, known = turned_histograms(listed, place, angle * self.bins / math.pi)
            kept = np.flatnonzero(known >= self.least)
            rows = np.sqrt(values[kept]).reshape(len(kept), self.grid**2 * self.bins)
            described.append(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.float32(1e-12)))
            indices.append(start + kept)
        index = np.concatenate(indices)
        return replace(features.take(index), descriptors=np.concatenate(described), norm="l2", index=index)


def _cell_list(image: Image, side: float, bins: int, window: int) -> F32:
    """The (rows * columns + 1, bins + 1) histograms around every second pixel, as `places_of` numbers them.

    The last column is 1 where half of the pixels are data, 0 elsewhere; the last row stands for what lies outside.
    """
    import cv2

    view = cv2.GaussianBlur(locally_normalised(image, window), (0, 0), SIGMA)
    gx, gy = cv2.Sobel(view, cv2.CV_32F, 1, 0), cv2.Sobel(view, cv2.CV_32F, 0, 1)
    clear = cv2.erode(image.mask.view(np.uint8), np.ones((5, 5), np.uint8), borderType=cv2.BORDER_REPLICATE)
    strength = lengths(gx, gy) * clear
    # Clockwise as seen, in bins of half a turn, so that a keypoint's angle is added.
    at = np.arctan2(gy, gx) * np.float32(bins / math.pi)
    low = np.floor(at)
    part = at - low
    first = low.astype(np.int64) % bins
    height, width = ((n + 1) // 2 for n in image.shape)
    blocks = len(Cells(side, soft=False).taps)
    out = np.zeros((height * width + 1, bins + 1), np.float32)

    def summed(votes: F32) -> F32:
        even = cv2.copyMakeBorder(votes, 0, votes.shape[0] % 2, 0, votes.shape[1] % 2, cv2.BORDER_CONSTANT, value=0)
        small = cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA)
        # Running sums leave a little less than nothing where nothing is.
        total = cv2.boxFilter(small, -1, (blocks, blocks), normalize=True, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(np.maximum(total, 0), np.float32)

    known = summed(clear.astype(np.float32)) >= 0.5
    for k in range(bins):
        votes = strength * ((first == k) * (1 - part) + ((first + 1) % bins == k) * part)
        out[:-1, k] = (summed(np.asarray(votes, np.float32)) * known).ravel()
    out[:-1, -1] = known.ravel()
    return out
