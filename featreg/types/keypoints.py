"""OpenCV's keypoints as columns of features, and back.

`cv2.KeyPoint` has the angle in degrees clockwise as seen and the diameter of the support; `Features` has radians
counter-clockwise and the radius.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.types.arrays import FloatArray, read_only

_FIELDS = attrgetter("size", "angle", "response", "octave")


def to_keypoints(
    xy: FloatArray, scale: FloatArray, angle: FloatArray, score: FloatArray, octave: ArrayLike, class_id: ArrayLike = -1
) -> list[Any]:
    """Return N `cv2.KeyPoint`.

    Parameters
    ----------
    xy : (N, 2) px
    scale : (N,) radius of the support, px
    angle : (N,) radians, counter-clockwise as seen
    score : (N,)
    octave, class_id : (N,) or one int for `KeyPoint.octave` and `KeyPoint.class_id`

    Returns
    -------
    N keypoints: size is the diameter in pixels, angle in degrees clockwise as seen, [0, 360)
    """
    import cv2

    n = len(xy)
    degrees = (np.rad2deg(-angle) % 360.0).astype(np.float32)
    degrees[degrees >= 360.0] = 0.0
    columns: list[list[Any]] = [
        xy[:, 0].tolist(),
        xy[:, 1].tolist(),
        (2.0 * scale).tolist(),
        degrees.tolist(),
        score.tolist(),
        np.broadcast_to(octave, n).tolist(),
        np.broadcast_to(class_id, n).tolist(),
    ]
    make: Callable[..., Any] = cv2.KeyPoint
    return [make(*row) for row in zip(*columns, strict=True)]


def from_keypoints(keypoints: Sequence[Any], descriptors: NDArray[Any] | None = None) -> dict[str, Any]:
    """Return the columns of `Features` of a sequence of N `cv2.KeyPoint`.

    Parameters
    ----------
    keypoints : N keypoints; an angle of -1 (none) becomes 0
    descriptors : (N, D) array: uint8 holds packed bits and gets the norm "hamming", anything else becomes float32 "l2"

    Notes
    -----
    The level is the low byte of `KeyPoint.octave`, signed, which is SIFT's octave (SIFT packs octave, layer and
    sub-layer into one int) and every other algorithm's. `class_id` is not kept.
    """
    import cv2

    n = len(keypoints)
    if descriptors is not None:
        descriptors = np.array(descriptors, dtype=np.uint8 if descriptors.dtype == np.uint8 else np.float32)
        # OpenCV returns no rows as an array of one dimension.
        descriptors = None if n == 0 and descriptors.ndim != 2 else read_only(descriptors)
    table = np.array([_FIELDS(k) for k in keypoints], dtype=np.float64).reshape(n, 4)
    octave = table[:, 3].astype(np.int64) & 255
    xy = np.asarray(cv2.KeyPoint.convert(keypoints), np.float64) if n else np.zeros((0, 2))
    return {
        "xy": xy.reshape(n, 2),
        "scale": table[:, 0] / 2.0,
        "angle": to_radians(table[:, 1]),
        "score": table[:, 2],
        "level": np.where(octave > 127, octave - 256, octave),
        "descriptors": descriptors,
        "norm": "hamming" if descriptors is not None and descriptors.dtype == np.uint8 else "l2",
    }


def to_radians(degrees: FloatArray) -> FloatArray:
    """Return OpenCV's angles (degrees clockwise as seen, -1: none) as ours (radians counter-clockwise, [0, 2 pi))."""
    radians = np.deg2rad(-degrees) % (2.0 * np.pi)
    return np.where((degrees == -1.0) | (radians >= 2.0 * np.pi), 0.0, radians)
