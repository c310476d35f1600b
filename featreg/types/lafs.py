"""Features as the local affine frames (LAFs) of kornia, and back.

A LAF is a matrix ``[A | c]`` that maps the square [-1, 1] x [-1, 1] onto the support of a feature around its centre c;
of a feature it holds ``A = scale [[cos, sin], [-sin, cos]]`` of its angle. kornia counts pixels as this package does,
so that its scale and angle are ours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError
from featreg.runtime.optional import import_torch
from featreg.types.arrays import FloatArray, read_only

if TYPE_CHECKING:
    from torch import Tensor


def to_lafs(xy: FloatArray, scale: FloatArray, angle: FloatArray) -> Tensor:
    """Return (1, N, 2, 3) float64 LAFs of N features: (N, 2) px, (N,) radius in px, (N,) radians."""
    torch = import_torch()
    cos, sin = scale * np.cos(angle), scale * np.sin(angle)
    x, y = xy.T
    rows = np.array([[cos, sin, x], [-sin, cos, y]], np.float64)
    tensor: Tensor = torch.from_numpy(np.ascontiguousarray(np.moveaxis(rows, 2, 0)))[None]
    return tensor


def from_lafs(
    lafs: Tensor, score: ArrayLike | None = None, descriptors: NDArray[Any] | Tensor | None = None
) -> dict[str, Any]:
    """Return the columns of `Features` of LAFs.

    Parameters
    ----------
    lafs : (1, N, 2, 3) or (N, 2, 3)
    score : (N,); without it 1
    descriptors : (N, D)

    Raises
    ------
    InputError
        Another shape.

    Notes
    -----
    The rows of zeros with which kornia fills up what its detectors return are left out. The scale is the root of the
    determinant and the angle that of the x axis in [0, 2 pi): an elongated or mirrored frame becomes a circle.
    """
    shape = tuple(lafs.shape)
    if shape[-2:] != (2, 3) or not (len(shape) == 3 or (len(shape) == 4 and shape[0] == 1)):
        raise InputError(f"LAFs have shape (1, N, 2, 3) or (N, 2, 3), got {shape}")
    frames = to_numpy(lafs).reshape(-1, 2, 3)
    filled = (frames != 0).any(axis=(1, 2))
    table = None if descriptors is None else read_only(np.ascontiguousarray(to_numpy(descriptors, np.float32)[filled]))
    frames = frames[filled]
    n = len(frames)
    return {
        "xy": frames[:, :, 2],
        "scale": np.sqrt(np.abs(np.linalg.det(frames[:, :, :2]))) if n else np.zeros(0),
        "angle": wrapped(np.arctan2(frames[:, 0, 1], frames[:, 0, 0])),
        "score": np.ones(n) if score is None else to_numpy(score).reshape(-1)[filled],
        "level": np.zeros(n, np.int64),
        "descriptors": table,
    }


def wrapped(angle: FloatArray) -> FloatArray:
    """Return angles in radians as the same directions in [0, 2 pi)."""
    turned = angle % (2 * np.pi)
    return np.where(turned >= 2 * np.pi, 0.0, turned)


def to_numpy(values: Any, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a tensor, wherever it lies, or anything like an array as a numpy array of `dtype`."""
    if hasattr(values, "detach"):
        values = values.detach().cpu().numpy()
    return np.asarray(values, dtype)
