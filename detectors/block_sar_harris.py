"""Block-based SAR-Harris: the best corners of each block of an image, evenly spread over it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Interval

from featreg.interfaces import Detector
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive
from featreg.sar.keypoints.harris import ratio_harris_response
from featreg.sar.keypoints.maxima import local_maxima, quadratic_peak
from featreg.sar.pyramid import clear
from featreg.sar.speckle import filled_amplitude
from featreg.types import Features, Image, IntArray


@register("block-sar-harris")
@dataclass(frozen=True)
class BlockSarHarris(Detector):
    """Corners of the ratio gradients of one scale, the best of each block of a grid.

    Parameters
    ----------
    n_features : at most so many keypoints; the image is divided into blocks for as many
    per_block : at most so many keypoints in a block, the best ones
    alpha : exponential weight of the ROEWA means, px
    integration : standard deviation, in units of alpha, of the Gaussian that smooths the SAR-Harris matrix
    d : weight of the squared trace in the response det - d trace^2
    threshold : least response
    floor : added to the means before their ratio is taken, relative to the image's mean amplitude
    support : radius in pixels that must be free of nodata and of the image border

    Notes
    -----
    "A high-precision matching method for heterogeneous SAR images based on ROEWA and angle-weighted gradient", Remote
    Sensing 17 (2025) 749, DOI 10.3390/rs17050749, section 2.2: the SAR-Harris response of F. Dellinger et al. 2015, DOI
    10.1109/TGRS.2014.2323552, and its best points block by block, so that points are evenly spread. Written from what
    its abstract and headings say: number of blocks, points a block, alpha and threshold are ours, as are the position
    between the pixels (`sar-harris`) and the order by response. A keypoint has no direction: its angle is 0.
    """

    n_features: Count = 300
    per_block: Count = 1
    alpha: Positive = 2.0
    integration: Positive = 0.8
    d: Annotated[float, Interval(ge=0, lt=0.25)] = 0.04
    threshold: Annotated[float, Ge(0)] = 1e-8
    floor: Annotated[float, Interval(ge=0, lt=math.inf)] = 0.01
    support: Annotated[float, Interval(ge=1, lt=math.inf)] = 24.0

    @property
    def reach(self) -> float:
        """The support, and what decides on the response at its rim."""
        return self.support + 4 * self.alpha

    def detect_features(self, image: Image) -> Features:
        sigma = self.integration * self.alpha
        response = ratio_harris_response(filled_amplitude(image), self.alpha, self.floor, sigma, self.d)
        found = local_maxima(response, clear(image, self.support), self.threshold, response.size)
        at = found[self._chosen(found, image.shape)]
        return Features(
            xy=quadratic_peak(response, at),
            scale=self.support,  # one number stands for all rows
            angle=np.zeros(len(at)),
            score=response[at[:, 1], at[:, 0]].astype(np.float64),
            level=np.zeros(len(at), np.int64),
        )

    def _chosen(self, xy: IntArray, shape: tuple[int, int]) -> IntArray:
        """Rows of the best points of each block, of (N, 2) points in the order of their response; in that order."""
        height, width = shape
        blocks = max(1, self.n_features // self.per_block)
        down = min(height, max(1, round(math.sqrt(blocks * height / width))))
        across = min(width, max(1, blocks // down))
        block = xy[:, 1] * down // height * across + xy[:, 0] * across // width
        order = np.argsort(block, kind="stable")
        first = np.searchsorted(block[order], block[order])
        rank = np.empty(len(xy), np.int64)
        rank[order] = np.arange(len(xy)) - first
        return np.flatnonzero(rank < self.per_block)[: self.n_features]
