"""BRIEF: binary intensity comparisons around a keypoint, turned with it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Annotated

import numpy as np
from annotated_types import Ge, Interval, MultipleOf
from numpy.typing import NDArray

from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive
from featreg.sar.pyramid import REACH, SUPPORT, clear, level_count, pyramid
from featreg.sar.speckle import despeckled_bytes_around
from featreg.types import Features, FloatArray, Image, IntArray, read_only

TURNS = 72


@register("brief")
@dataclass(frozen=True)
class Brief(Descriptor):
    """Oriented BRIEF on the despeckled view of the pyramid level that fits a keypoint's scale.

    Parameters
    ----------
    bits : length of the descriptor, a multiple of 256
    radius : of the comparisons, in pixels of the level; also the keypoint scale that belongs to the first level
    spread : standard deviation of the samples around the keypoint, in pixels of the level
    sigma : of the Gaussian that smooths the log-amplitude
    levels, factor : of the pyramid; a keypoint of scale radius * factor^n is described on level n, a larger one than
        there are levels for on the last, by less around it than it was found by: where the detector is given more
        levels, or leaves more of the finest out, this is to be given as many as both together
    oriented : False leaves the comparisons upright, whatever the keypoint's angle

    Notes
    -----
    M. Calonder et al., "BRIEF: Binary Robust Independent Elementary Features", ECCV 2010,
    DOI 10.1007/978-3-642-15561-1_56; turned by the keypoint's angle, in steps of 5 degrees, as in Rublee et al. 2011,
    DOI 10.1109/ICCV.2011.6126544. The comparisons are our own: a quasi-random (Halton) sample of the Gaussian, which
    is the same everywhere and needs no training set. They are made on the smoothed logarithm of the amplitude,
    because on the amplitude itself speckle decides most of them. Keypoints whose samples would touch nodata or leave
    the image are dropped.
    """

    bits: Annotated[int, Ge(256), MultipleOf(256)] = 256
    radius: Annotated[float, Interval(ge=5, le=100)] = SUPPORT
    spread: Annotated[float, Interval(ge=1, lt=math.inf)] = 9.0
    sigma: Positive = 1.0
    levels: Count = 8
    factor: Annotated[float, Interval(gt=1, lt=math.inf)] = 1.2
    oriented: bool = True

    def reach_of(self, scale: float) -> float:
        """What must be free on the level of that scale."""
        return (self.radius + REACH) * min(max(scale / self.radius, 1.0), self.factor ** (self.levels - 1))

    def describe_features(self, image: Image, features: Features) -> Features:
        from featreg.sar.keypoints import binary_kernels

        steps = np.log(np.maximum(features.scale, 1e-9) / self.radius) / math.log(self.factor)
        last = level_count(image.shape, self.levels, self.factor) - 1
        numbers = np.clip(np.rint(steps), 0, last).astype(np.int64)
        chain = pyramid(image, int(numbers.max(initial=0)) + 1, self.factor)
        words = np.zeros((len(features), self.bits // 64), np.uint64)
        kept = np.zeros(len(features), np.uint8)
        table = turned_pattern(self.bits, self.radius, self.spread)
        turns = _turns(features.angle) if self.oriented else np.zeros(len(features), np.int64)
        height, width = image.shape
        for number, count in enumerate(np.bincount(numbers, minlength=len(chain)).tolist()):
            if not count:
                continue
            level = chain[number]
            allowed = clear(level, self.radius + REACH).view(np.uint8)
            places = partial(_places, features.xy, numbers, number, level, image)
            flat = despeckled_bytes_around(level, places, count, math.ceil(self.radius), self.sigma).ravel()
            binary_kernels.describe_level(
                flat, allowed, features.xy, width, height, numbers, number, table, turns, words, kept
            )
        index = read_only(kept.nonzero()[0])
        words = words.view(np.uint8)
        if len(index) == len(features):
            return features.having(descriptors=read_only(words), norm="hamming", index=index)
        return features.take(index, descriptors=read_only(words.take(index, 0)), norm="hamming", index=index)


def _places(xy: FloatArray, numbers: IntArray, number: int, level: Image, image: Image) -> IntArray:
    """(M, 2) pixels of a level of an image on which those of the points fall whose number is that."""
    # As the kernel that describes them has it, to the last bit: a share of the sides taken first rounds otherwise.
    (height, width), (image_height, image_width) = level.shape, image.shape
    at = (xy[numbers == number] + 0.5) * (width, height) / (image_width, image_height) - 0.5
    return np.asarray(np.rint(at), np.int64)


def _turns(angle: FloatArray) -> NDArray[np.int64]:
    return np.rint(angle * (TURNS / (2 * math.pi))).astype(np.int64) % TURNS


@lru_cache(maxsize=8)
def turned_pattern(bits: int, radius: float, spread: float) -> NDArray[np.int8]:
    """Return the (72, 4, bits) int8 comparisons (x1, x2, y1, y2) for every turn, counter-clockwise as seen."""
    first, second = _halton_disc(bits, radius, spread)
    table = np.empty((TURNS, 4, bits), np.int8)
    for turn in range(TURNS):
        t = 2 * math.pi * turn / TURNS
        # x to the right, y down: counter-clockwise as seen is (cos, sin; -sin, cos).
        matrix = np.array([[math.cos(t), math.sin(t)], [-math.sin(t), math.cos(t)]])
        table[turn, ::2] = np.rint(first @ matrix.T).T
        table[turn, 1::2] = np.rint(second @ matrix.T).T
    table.flags.writeable = False
    return table


def _halton_disc(count: int, radius: float, spread: float) -> tuple[FloatArray, FloatArray]:
    """Two (count, 2) point sets, Gaussian in the disc of radius - 1, whose partners are at least two pixels apart."""
    limit = 1 - math.exp(-0.5 * ((radius - 1) / spread) ** 2)
    pairs: list[FloatArray] = []
    i = 0
    while len(pairs) < count:
        i += 1
        u = [_radical_inverse(i, base) for base in (2, 3, 5, 7)]
        r = [spread * math.sqrt(-2 * math.log(1 - limit * u[k])) for k in (0, 2)]
        t = [2 * math.pi * u[k] for k in (1, 3)]
        pair = np.array([[r[k] * math.cos(t[k]), r[k] * math.sin(t[k])] for k in (0, 1)])
        if math.hypot(*(pair[0] - pair[1])) >= 2:
            pairs.append(pair)
    both = np.array(pairs)
    return both[:, 0], both[:, 1]


def _radical_inverse(index: int, base: int) -> float:
    value, weight = 0.0, 1.0 / base
    while index:
        index, digit = divmod(index, base)
        value += digit * weight
        weight /= base
    return value
