"""Many dates of one landscape that drift against each other: a jump, a changed date, an image of another place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.runtime.parameters import checked
from featreg.runtime.watching import Progress, Steps
from featreg.simulate.pairs import Textures, render, similarity_matrix
from featreg.simulate.speckle_field import RADIUS, Looks
from featreg.types import FloatArray, read_only


@dataclass(frozen=True, eq=False)
class SimulatedSeries:
    """Images of one landscape in the order of time.

    Parameters
    ----------
    images : (H, W) float32 linear amplitude each
    truths : (2, 3) float64 matrix, first image -> image; that of an unrelated image means nothing
    """

    images: Sequence[NDArray[np.float32]]
    truths: Sequence[FloatArray]


@checked("sar_series")
def sar_series(
    count: Annotated[int, Interval(ge=2, le=1000)] = 8,
    shape: tuple[int, int] = (300, 300),
    *,
    looks: Looks = 4,
    drift: Annotated[float, Interval(ge=0, le=16)] = 0.25,
    rotation_deg: Annotated[float, Interval(ge=0, le=10)] = 0.02,
    jump: tuple[int, float, float] | None = None,
    changed: int | None = None,
    unrelated: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> SimulatedSeries:
    """Simulate dates of one landscape.

    Parameters
    ----------
    count : how many dates
    shape : (H, W) of all images, at least 64 x 64
    looks : independent looks averaged in intensity
    drift : standard deviation, px along either axis, of the step from date to date
    rotation_deg : standard deviation of the rotation of each date against the first
    jump : (first date, at least 1; dx, dy): from that date on all images lie (dx, dy) px further
    changed : a date on which a third of the fields, buildings and targets differ
    unrelated : a date that shows another place
    seed : the same seed gives the same series
    progress : called with (dates made, dates in all)

    Raises
    ------
    ParameterError
        An argument outside its range, a date that there is not.

    Examples
    --------
    >>> series = sar_series(3, (128, 128), jump=(2, 2.0, 0.0), drift=0.0, rotation_deg=0.0)
    >>> series.truths[2].tolist()
    [[1.0, 0.0, 2.0], [0.0, 1.0, 0.0]]
    """
    from featreg.simulate.scenery import countryside

    if len(shape) != 2 or min(shape) < 64:
        raise ParameterError(f"shape must be (H, W) of at least 64 x 64, got {tuple(shape)}")
    if jump is not None and jump[0] == 0:
        raise ParameterError("jump must name a date from 1 on: the first image is where the others are counted from")
    for name, date in (("jump", None if jump is None else jump[0]), ("changed", changed), ("unrelated", unrelated)):
        if date is not None and not 0 <= date < count:
            raise ParameterError(f"{name} must name a date from 0 to {count - 1}, got {date}")
    layout, ground, motion, elsewhere, *speckle = np.random.default_rng(seed).spawn(4 + count)
    steps = motion.normal(0, drift, (count, 2))
    steps[0] = 0
    if jump is not None:
        steps[jump[0]] += jump[1:]
    shifts = np.cumsum(steps, axis=0)
    turns = motion.normal(0, rotation_deg, count)
    turns[0] = 0
    reach = 64.0 * math.ceil((math.hypot(*shape) / 2 + 2 * RADIUS + float(np.abs(shifts).max())) / 64)
    places = [(countryside(shape, reach, 1 / 3, layout), Textures.made(shape, reach, ground))]
    if unrelated is not None:
        places.append((countryside(shape, reach, 0.0, elsewhere), Textures.made(shape, reach, elsewhere)))
    images, truths, made = [], [], Steps(count, progress)
    for date in range(count):
        x, y = shifts[date].tolist()
        truth = similarity_matrix(shape, float(turns[date]), 1.0, (x, y))
        land, textures = places[1 if date == unrelated else 0]
        images.append(render(land, textures, truth, shape, int(date == changed), looks, speckle[date]))
        truths.append(read_only(truth))
        made.advance()
    return SimulatedSeries(images, truths)
