"""SAR-Harris: corners of the ratio gradients of a SAR image at several scales."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from annotated_types import Ge, Interval
from numpy.typing import NDArray

from featreg.interfaces import Detector
from featreg.registry import register
from featreg.runtime.buffers import scratch
from featreg.runtime.parameters import Count, Positive
from featreg.sar.gradients.gradient_field import (
    COARSEST_GRID,
    GradientField,
    filled_gradients,
    from_base,
    octave,
    ratio_field,
)
from featreg.sar.keypoints.gradient_histograms import dominant_orientation, further_orientations
from featreg.sar.keypoints.harris import harris_response, ratio_harris_response
from featreg.sar.keypoints.maxima import interpolated, local_maxima, parabola_peak, quadratic_peak
from featreg.sar.pyramid import clear, share_out, to_base
from featreg.sar.speckle import filled_amplitude
from featreg.types import Features, FloatArray, Image, IntArray, Searched

F32 = NDArray[np.float32]

# Pixels of the image for each keypoint asked for, from which on every other scale has more than enough corners, and
# from which on those do whose gradients are not mostly speckle.
PLENTY, ABUNDANT = 50, 140


@dataclass(frozen=True, eq=False)
class _Layer:
    """One scale: the SAR-Harris response, float32 on the grid of `level`, and the pixels (N, 2) of its maxima.

    `number` counts the scales from the finest on; `alpha` is in pixels of the image.
    """

    number: int
    alpha: float
    level: Image
    response: F32
    maxima: IntArray


@register("sar-harris")
@dataclass(frozen=True)
class SarHarris(Detector):
    """Corners of the ratio gradients of a SAR image at several scales, with orientation and sub-pixel position.

    Parameters
    ----------
    n_features : at most so many keypoints, shared out over the scales
    scales, alpha, factor : how many scales there are, the exponential weight in pixels of the ROEWA means of the
        finest, and the ratio of two neighbours
    integration : standard deviation, in units of alpha, of the Gaussian that smooths the SAR-Harris matrix
    d : weight of the squared trace in the response det - d trace^2
    threshold : least response
    floor : added to the means before their ratio is taken, relative to the image's mean amplitude
    quota_decay : a scale gets `quota_decay` times fewer keypoints than the finer one before it
    support : radius in units of alpha from which a keypoint is described; it must be free of nodata and border
    finest : least alpha of the gradients from which an orientation is taken
    subscale : interpolate the scale between neighbouring ones by a parabola through the responses
    thin : leave every other scale out of images with at least 50 valid pixels for each keypoint asked for
    coarse : leave the scales finer than `finest` out of images with at least 140 valid pixels for each keypoint, and
        as many so far from border and nodata that corners of `finest` are found there
    second : another peak of the histogram of directions of at least this share of the highest makes a further keypoint
        at the same place; 1: none does
    exact : compute every scale on the image itself and take directions from samples half an alpha apart; otherwise
        coarse scales are computed on an image halved one or more times, and samples lie 0.84 alpha apart

    Notes
    -----
    F. Dellinger, J. Delon, Y. Gousseau, J. Michel, F. Tupin, "SAR-SIFT: a SIFT-like algorithm for SAR images", IEEE
    TGRS 53 (2015) 453, DOI 10.1109/TGRS.2014.2323552: the ratio gradients (the logarithms of the ratios of
    exponentially weighted means, so that x and y gradients have zero mean where there is no edge), the multi-scale
    SAR-Harris matrix, smoothed by a Gaussian of sqrt(2) alpha, its response with d = 0.04, and local maxima in space
    of each scale alpha_k = 2 * 2^(k / 3), k = 0 to 7.

    Departures. The defaults begin at alpha = 1 and smooth by 0.8 alpha, since the position of a maximum is as blurred
    as the response, and finer scales get a larger share of the budget: on Sentinel-1 pairs more than three times as
    many correct matches as with the paper's values, which are parameters. One-sided means exclude the pixel itself.
    Coarse scales are computed on an image halved one or more times, where their alpha is at least 1.25 pixels, unless
    `exact`. The position comes from a quadratic surface through the 3 x 3 responses, the scale from a parabola over the
    logarithm of alpha; both stay at the pixel and the layer where the fit leaves it. A keypoint has one orientation
    (`second`). Neighbouring scales find many corners twice. Where there are more than enough of them (`thin`), every
    other scale gives as many correct matches in a fifth to a half more places, for half of the work; small images need
    all. How many valid pixels they have decides, and the smaller of a pair for both (`for_pair`): were only one of them
    thinned, a fifth of the matches would be lost. Where few keypoints are asked of many pixels (`coarse`), corners of
    the finest scales are mostly speckle's: without them a fifth to a quarter more matches are correct on single and
    four looks, in four fifths of the time, and 3 % less exact before they are measured again. Not in blocks.
    """

    block_parameters: ClassVar[Mapping[str, Any]] = MappingProxyType({"coarse": False})

    n_features: Count = 5000
    scales: Count = 8
    alpha: Positive = 1.0
    factor: Annotated[float, Interval(gt=1, lt=math.inf)] = 2 ** (1 / 3)
    integration: Positive = 0.8
    d: Annotated[float, Interval(ge=0, lt=0.25)] = 0.04
    threshold: Annotated[float, Ge(0)] = 1e-3
    floor: Annotated[float, Interval(ge=0, lt=math.inf)] = 0.01
    quota_decay: Annotated[float, Ge(1)] = 2**0.5
    support: Positive = 12.0
    finest: Positive = 2.0
    subscale: bool = True
    thin: bool = True
    coarse: bool = True
    second: Annotated[float, Interval(gt=0, le=1)] = 1.0
    exact: bool = False

    @property
    def reach(self) -> float:
        """The radius of the coarsest scale."""
        return self.support * self.alpha * self.factor ** (self.scales - 1)

    def for_pair(self, reference: Image, secondary: Image) -> Self:
        """With all scales where the smaller of the images needs them."""
        thin = self._plenty(reference) == self._plenty(secondary)
        coarse = self._abundant(reference) == self._abundant(secondary)
        return self if thin and coarse else replace(self, thin=self.thin and thin, coarse=self.coarse and coarse)

    def detect_features(self, image: Image) -> Features:
        return self.oriented(image, self.detect_places(image))

    def detect_places(self, image: Image) -> Features:
        if self.second < 1:
            # How many keypoints there are at a place is known with their directions only.
            return self._with_further(image, self._places(image))
        return self._best(self._places(image))

    def _places(self, image: Image) -> Features:
        numbers = self._numbers(image)
        step = numbers.step
        layers = [self._layer(image, number) for number in numbers]
        counts = share_out(self.n_features, [len(layer.maxima) for layer in layers], self.quota_decay**step)
        parts = []
        for k, (layer, count) in enumerate(zip(layers, counts, strict=True)):
            at = layer.maxima[:count]
            xy = to_base(quadratic_peak(layer.response, at), layer.level, image)
            alpha = layer.alpha * self.factor ** (step * self._sub_scale(image, layers, k, xy))
            score = layer.response[at[:, 1], at[:, 0]].astype(np.float64)
            parts.append(Features(xy, self.support * alpha, 0.0, score, np.full(len(at), layer.number)))
        return Features.concatenate(parts)

    def searched(self, image: Image) -> Searched:
        numbers = self._numbers(image)
        radii = [self.support * self.alpha * self.factor**number for number in range(self.scales)]
        finer = tuple(radii[: numbers.start])
        between = tuple(radii[n] for n in range(numbers.start, self.scales) if n not in numbers)
        left_out = {name: some for name, some in (("coarse", finer), ("thin", between)) if some}
        return Searched(radii=tuple(radii[number] for number in numbers), left_out=left_out)

    def _numbers(self, image: Image) -> range:
        """Those of the scales that are looked at."""
        step = 2 if self.thin and self._plenty(image) else 1
        first = self._first() if self.coarse and self._abundant(image) else 0
        return range(first, self.scales, step)

    def _best(self, features: Features) -> Features:
        return features.take(np.argsort(-features.score, kind="stable")[: self.n_features])

    def oriented(self, image: Image, features: Features) -> Features:
        if self.second < 1:
            return features
        angle = np.empty(len(features))
        for number in np.unique(features.level):
            rows = np.flatnonzero(features.level == number)
            around = self._gradients(image, int(number), features.xy[rows])
            angle[rows] = dominant_orientation(*around, self._step)
        return replace(features, angle=angle)

    def _with_further(self, image: Image, features: Features) -> Features:
        parts = []
        for number in np.unique(features.level):
            points = features.take(np.flatnonzero(features.level == number))
            around = self._gradients(image, int(number), points.xy)
            parts.append(replace(points, angle=dominant_orientation(*around, self._step)))
            rows, others = further_orientations(*around, self.second, self._step)
            parts.append(replace(points.take(rows), angle=others))
        return self._best(Features.concatenate(parts))

    def _plenty(self, image: Image) -> bool:
        return image.valid_count >= PLENTY * self.n_features

    def _abundant(self, image: Image) -> bool:
        """As `_plenty`, of pixels so far from border and nodata that corners of `finest` are found there."""
        radius = math.ceil(self.support * self.finest)
        if image.all_valid:
            inner = math.prod(max(0, side - 2 * radius) for side in image.shape)
        else:
            inner = int(np.count_nonzero(clear(image, radius)))
        return bool(inner >= ABUNDANT * self.n_features)

    def _first(self) -> int:
        """Number of the first scale that is not finer than `finest`, or of the last one."""
        return min(
            max(0, math.ceil(math.log(self.finest / self.alpha) / math.log(self.factor) - 1e-6)), self.scales - 1
        )

    @property
    def _step(self) -> float:
        """Distance of the samples of directions, relative to their radius of half the support."""
        return 1 / self.support if self.exact else 0.14

    def _grid(self, image: Image, alpha: float) -> tuple[Image, float]:
        """The image on which a scale is computed, and its alpha there."""
        return octave(image, alpha, math.inf if self.exact else COARSEST_GRID)

    def _layer(self, image: Image, number: int) -> _Layer:
        alpha = self.alpha * self.factor**number
        level, local = self._grid(image, alpha)
        out, sigma = scratch(f"response {alpha!r}", level.shape), self.integration * local
        # Neither orientations nor descriptors are taken from gradients finer than `finest`.
        if alpha < self.finest:
            response = ratio_harris_response(filled_amplitude(level), local, self.floor, sigma, self.d, out)
        else:
            response = harris_response(*filled_gradients(level, local, self.floor), sigma, self.d, out)
        reach = self.support * alpha * level.shape[1] / image.shape[1]
        maxima = local_maxima(response, clear(level, reach), self.threshold, self.n_features)
        return _Layer(number, alpha, level, response, maxima)

    def _sub_scale(self, image: Image, layers: list[_Layer], k: int, xy: FloatArray) -> FloatArray:
        """Where the response peaks between the neighbouring scales, in steps of the scale, -0.5 to 0.5."""
        if not self.subscale or not 0 < k < len(layers) - 1:
            return np.zeros(len(xy))
        near = [interpolated(layer.response, from_base(xy, layer.level, image)) for layer in layers[k - 1 : k + 2]]
        return parabola_peak(*near)

    def _gradients(self, image: Image, number: int, xy: FloatArray) -> tuple[GradientField, FloatArray, FloatArray]:
        """The gradients that give points (N, 2) of a scale their direction, their places in them, and (N,) radii."""
        level, local = self._grid(image, max(self.alpha * self.factor**number, self.finest))
        radius = np.full(len(xy), 0.5 * self.support * local)
        return ratio_field(level, local, self.floor), from_base(xy, level, image), radius
