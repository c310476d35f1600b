"""Pairs whose ground moved between the dates: a glacier, a fault, a subsiding bowl, with the exact displacement."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.errors import ParameterError, suggest
from featreg.runtime.parameters import checked
from featreg.simulate.pairs import sar_pair
from featreg.simulate.speckle_field import Looks, speckled_intensity
from featreg.types import FloatArray, read_only

Field = NDArray[np.float32]

#: Steps of the fixed-point iteration that inverts a displacement.
INVERSIONS = 40
#: What they may leave, px.
UNSETTLED = 0.01


@dataclass(frozen=True, eq=False)
class DisplacedPair:
    """Two images and how far each pixel of the first moved.

    Parameters
    ----------
    reference, secondary : (H, W) float32 linear amplitude
    displacement : (H, W, 2) float32 px (dx, dy), reference -> secondary, exact
    """

    reference: NDArray[np.float32]
    secondary: NDArray[np.float32]
    displacement: NDArray[np.float32]


def glacier(x: FloatArray, y: FloatArray, size: float) -> FloatArray:
    """A winding stream of ice: `size` px along its middle line, falling off to both sides, 0 far from it."""
    speed = size * np.exp(-(((x - 0.2 * np.sin(2 * y)) / 0.45) ** 2))
    return np.stack([0.4 * speed * np.cos(2 * y), speed], axis=-1)


def fault(x: FloatArray, y: FloatArray, size: float) -> FloatArray:
    """A strike-slip fault down the middle: what lies right of it moved down by `size` px, what lies left did not."""
    return np.stack([np.zeros_like(x), np.where(x > 0, size, 0.0)], axis=-1)


def subsidence(x: FloatArray, y: FloatArray, size: float) -> FloatArray:
    """A sinking bowl: at most `size` px along x, as ground that sinks moves towards the sensor, and inwards by half."""
    bowl = np.exp(-2 * (x**2 + y**2))
    inwards = -2 * math.exp(0.5) * bowl * size / 2
    return np.stack([size * bowl + inwards * x, inwards * y], axis=-1)


#: Displacements by name: functions of coordinates from -1 to 1 over the image and of a size in px.
FIELDS: dict[str, Callable[[FloatArray, FloatArray, float], FloatArray]] = {
    "glacier": glacier,
    "fault": fault,
    "subsidence": subsidence,
}


@checked("displaced_pair")
def displaced_pair(
    kind: str = "glacier",
    shape: tuple[int, int] = (600, 600),
    *,
    size: Annotated[float, Interval(ge=-64, le=64)] = 6.0,
    looks: Looks = 4,
    change: Annotated[float, Interval(ge=0, le=1)] = 0.05,
    seed: int = 0,
) -> DisplacedPair:
    """Simulate two dates of a landscape that moved by a known field.

    Parameters
    ----------
    kind : "glacier", "fault" or "subsidence"
    shape : (H, W), at least 64 x 64
    size : largest displacement, px
    looks : independent looks averaged in intensity; `math.inf` for no speckle
    change : share of fields, buildings and point targets that differ between the dates
    seed : the same seed gives the same pair

    Returns
    -------
    `DisplacedPair`

    Raises
    ------
    ParameterError
        An unknown kind, an argument outside its range, or a displacement that folds the image.

    Notes
    -----
    The expected image of the second date is resampled by a cubic spline at the inverse of the field, then speckle is
    drawn for both dates: speckle does not move with the ground. A fault is no invertible field: each side is resampled
    by its own shift.

    Examples
    --------
    >>> pair = displaced_pair("fault", (128, 128), size=8.0, seed=1)
    >>> pair.displacement[64, 100].tolist()
    [0.0, 8.0]
    """
    from scipy.ndimage import map_coordinates

    if kind not in FIELDS:
        raise ParameterError(f"unknown kind '{kind}', {suggest(kind, FIELDS)}")
    still = sar_pair(shape, looks=math.inf, rotation_deg=0.0, scale=1.0, shift=(0.0, 0.0), change=change, seed=seed)
    height, width = shape
    rows, cols = np.mgrid[0.0:height, 0.0:width]

    def field(x: FloatArray, y: FloatArray) -> FloatArray:
        across, down = 2 * x / (width - 1) - 1, 2 * y / (height - 1) - 1
        return np.asarray(FIELDS[kind](across, down, float(size)), np.float64)

    u, v = cols.copy(), rows.copy()
    for _ in range(1 if kind == "fault" else INVERSIONS):
        u, v = (whole - part for whole, part in zip((cols, rows), np.moveaxis(field(u, v), -1, 0), strict=True))
    across, down = np.moveaxis(field(u, v), -1, 0)
    if kind != "fault" and max(np.abs(u + across - cols).max(), np.abs(v + down - rows).max()) > UNSETTLED:
        raise ParameterError(f"a {kind} of {size:g} px folds an image of {height} x {width}: make it smaller")
    # A spline may swing below 0 beside a bright point.
    moved = np.maximum(map_coordinates(still.secondary, [v, u], order=3, mode="mirror"), 0)
    rngs = np.random.default_rng([seed, 1]).spawn(2)
    first, second = (
        np.sqrt(speckled_intensity(image.astype(np.float32) ** 2, None, looks, rng))
        for image, rng in zip((still.reference, moved), rngs, strict=True)
    )
    return DisplacedPair(first, second, read_only(field(cols, rows).astype(np.float32)))
