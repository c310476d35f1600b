"""The user's own tie points: filters, model and trust without images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.interfaces import Model
from featreg.pipeline.assembly import assemble_fit
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.runtime.parameters import check_seed
from featreg.types import FloatArray, Matches


def fit(
    points: Matches | Any,
    *,
    model: str | type[Model] | None = None,
    filters: Any = ("fsc",),
    seed: int = 0,
    reference_shape: tuple[int, int] | None = None,
    secondary_shape: tuple[int, int] | None = None,
    **keywords: Any,
) -> Registration:
    """Run filters, model and trust on the user's own tie points.

    Parameters
    ----------
    points : `Matches`, an (M, 4) array of reference x, y, secondary x, y in pixels, or a file of tie points
        (`featreg.read_tie_points`)
    model, filters, seed, keywords : as in `match`
    reference_shape, secondary_shape : (H, W); without them the images are taken to begin and end at the outermost tie
        points, wherever these lie: moved tie points (map coordinates, say) are judged alike

    Returns
    -------
    Registration
    """
    check_seed(seed)
    matches = points if isinstance(points, Matches) else _as_matches(points)
    pipeline = assemble_fit(model=model, filters=filters, **keywords)
    frames = [
        ((0, 0), given) if given is not None else _outer_frame(xy)
        for given, xy in ((reference_shape, matches.reference_xy), (secondary_shape, matches.secondary_xy))
    ]
    origins, shapes = zip(*frames, strict=True)
    first, second = (InputImage("tie points", shape) for shape in shapes)  # raises where they cannot be
    result = pipeline.fit(matches, shapes[0], shapes[1], seed=seed, origins=origins)
    return replace(result, reference=first, secondary=second)


def _as_matches(points: Any) -> Matches:
    if isinstance(points, str | Path):
        from featreg.exports.formats import read_tie_points

        return read_tie_points(points)
    try:
        array = np.asarray(points, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"tie points must be Matches or an (M, 4) array of numbers, got {points!r:.40}") from error
    if array.ndim != 2 or array.shape[1] != 4:
        raise InputError(f"tie points must be an (M, 4) array of reference x, y, secondary x, y, got {array.shape}")
    return Matches(array[:, :2], array[:, 2:], np.ones(len(array)))


def _outer_frame(xy: FloatArray) -> tuple[tuple[int, int], tuple[int, int]]:
    """First pixel (x, y) and shape (H, W) of the smallest image that holds all of (M, 2) points."""
    if not len(xy):
        return (0, 0), (1, 1)
    left, top = (int(n) for n in np.floor(xy.min(axis=0)))
    right, bottom = (int(n) for n in np.ceil(xy.max(axis=0)))
    return (left, top), (bottom - top + 1, right - left + 1)
