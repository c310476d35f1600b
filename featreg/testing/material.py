"""What a plugin under test is given, and one run of each kind of plugin on it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.interfaces import FilterContext
from featreg.io import as_image
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Features, FloatArray, Image, Matches

#: (2, 3) map of the tie points that filters are given, and the size of their images.
MATRIX, SHAPE = np.array([[1.01, 0.03, 5.0], [-0.03, 1.0, -4.0]]), (400, 400)


@cache
def texture(height: int, width: int) -> NDArray[np.float32]:
    """(height, width) of a simulated image of four looks, the same landscape for every size."""
    return sar_pair((260, 260), seed=3).reference[:height, :width]


def keypoints(shape: tuple[int, int], count: int = 40) -> Features:
    rng = np.random.default_rng(0)
    xy = np.column_stack([rng.uniform(45, shape[1] - 45, count), rng.uniform(45, shape[0] - 45, count)])
    return Features(xy, np.full(count, 8.0), rng.uniform(0, 6, count), np.ones(count), np.zeros(count, np.int64))


def features_of(descriptors: NDArray[Any]) -> Features:
    count = len(descriptors)
    norm = "hamming" if descriptors.dtype == np.uint8 else "l2"
    xy = np.random.default_rng(2).uniform(0, 100, (count, 2))
    return Features(xy, np.ones(count), np.zeros(count), np.ones(count), np.zeros(count, np.int64), descriptors, norm)


def tie_points(good: int, bad: int) -> tuple[Matches, NDArray[np.bool_]]:
    rng = np.random.default_rng(0)
    here = rng.uniform(60, 340, (good + bad, 2))
    there = here @ MATRIX[:, :2].T + MATRIX[:, 2] + rng.normal(0, 0.3, here.shape)
    there[good:] = rng.uniform(0, 399, (bad, 2))
    right = np.arange(good + bad) < good
    score = np.where(right, rng.uniform(0.3, 1, good + bad), rng.uniform(0, 0.7, good + bad))
    order = rng.permutation(good + bad)
    return Matches(here[order], there[order], score[order]), right[order]


def context() -> FilterContext:
    return FilterContext(SHAPE, SHAPE, Affine, np.random.default_rng(0))


def empty_images(shape: tuple[int, int] = (80, 90)) -> Iterator[tuple[str, Image]]:
    whole = np.ones(shape, np.bool_)
    yield "a constant image", Image(np.full(shape, 3, np.float32), whole)
    yield "an image of zeros", Image(np.zeros(shape, np.float32), whole)
    yield "an image without data", Image(np.zeros(shape, np.float32), ~whole)


def work(kind: str, plugin: Any) -> Any:
    """One run of any plugin on fixed input."""
    if kind == "detector":
        return plugin.detect_features(as_image(texture(150, 160)))
    if kind == "descriptor":
        return plugin.describe_features(as_image(texture(150, 160)), keypoints((150, 160)))
    if kind == "nearest":
        rng = np.random.default_rng(0)
        return plugin.match_features(*(features_of(rng.integers(0, 256, (n, 32)).astype(np.uint8)) for n in (90, 80)))
    if kind == "filter":
        return plugin.keep(tie_points(300, 200)[0], context())
    pair = shifted_pair()
    return plugin.match(as_image(pair.reference), as_image(pair.secondary))


@cache
def shifted_pair() -> SimulatedPair:
    return sar_pair((240, 240), looks=8, rotation_deg=0.0, scale=1.0, shift=(3.0, -2.0), change=0.0, seed=1)


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit."""
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, Features | Matches):
        return all(same(getattr(a, field), getattr(b, field)) for field in a.__dataclass_fields__)
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f")) if isinstance(a, np.ndarray) else bool(a == b)


def apart(xy: FloatArray, others: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Distance of each point to the nearest of the others, and which that is; inf where there is none."""
    from scipy.spatial import cKDTree

    if not len(others):
        return np.full(len(xy), np.inf), np.zeros(len(xy), np.int64)
    distance, nearest = cKDTree(others).query(xy)
    return np.asarray(distance), np.asarray(nearest, np.int64)
