"""The one place that knows how scikit-image is asked: its pictures, its (row, column), its angles, its half pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.interop.family import NORMALISE, Option, Row, option
from featreg.interop.opencv import grey
from featreg.types import Features, FloatArray, Image

CURE = "pip install scikit-image"


@dataclass(frozen=True)
class SkimageRow(Row):
    """One algorithm of scikit-image; every one that reads an image has a parameter `normalise`.

    Parameters
    ----------
    run : what it does; its arguments are those of the table's class
    """

    run: Callable[..., Any] = field(kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", {**self.parameters, **NORMALISE})


def own(**defaults: Any) -> dict[str, Option]:
    """Return parameters that scikit-image calls as we do."""
    return {key: option(default, keyword=key) for key, default in defaults.items()}


def picture(image: Image, normalise: str) -> FloatArray:
    """Return the (H, W) float64 picture, 0 to 1, that scikit-image is given; invalid pixels hold the median."""
    return np.asarray(grey(image, normalise), np.float64) / 255.0


def to_xy(rows_and_columns: Any) -> FloatArray:
    """Return (N, 2) positions x, y of scikit-image's (N, 2) positions row, column."""
    return np.array(rows_and_columns, np.float64).reshape(-1, 2)[:, ::-1]


def to_rows(xy: FloatArray) -> FloatArray:
    """Return scikit-image's (N, 2) positions row, column of positions x, y."""
    return np.ascontiguousarray(np.asarray(xy, np.float64)[:, ::-1])


def features(
    xy: FloatArray, scale: Any, score: Any, angle: Any = 0.0, level: Any = 0, descriptors: NDArray[Any] | None = None
) -> Features:
    """Return the features of columns, of which each may be one number; bits (N, D) bool become packed bytes."""
    n = len(xy)
    bits = descriptors is not None and descriptors.dtype == np.bool_
    table = np.packbits(descriptors, axis=1) if bits else descriptors  # type: ignore[arg-type]  # bits say that it is not None
    return Features(
        xy=xy,
        scale=np.broadcast_to(np.asarray(scale, np.float64), n),
        angle=np.broadcast_to(np.asarray(angle, np.float64), n),
        score=np.broadcast_to(np.asarray(score, np.float64), n),
        level=np.broadcast_to(np.asarray(level, np.int64), n),
        descriptors=None if table is None else np.ascontiguousarray(table),
        norm="hamming" if bits else "l2",
    )


def pyramid_to_true(xy: FloatArray, level: NDArray[Any], downscale: float, shape: tuple[int, int]) -> FloatArray:
    """Return the positions in the image of the points that ORB reports at `xy` (N, 2) on pyramid levels (N,).

    It multiplies a position of level l by ``downscale**l``; but a level has ceil(W / downscale) columns of the one
    below, and resizing maps x of a level to ``(x + 0.5) W / columns - 0.5``.
    """
    size = np.array(shape[::-1], np.float64)
    sizes = [size]
    for _ in range(int(level.max(initial=0))):
        sizes.append(np.ceil(sizes[-1] / downscale))
    ratio = size / np.array(sizes)[level]
    return np.asarray((xy / (downscale ** level.astype(np.float64))[:, None] + 0.5) * ratio - 0.5)
