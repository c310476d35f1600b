"""What the vector formats hold, as plain arrays on a map: tie points, arrows, error ellipses and outlines.

All lie in the coordinate system of the reference (longitude and latitude where it has an RPC or control points). Where
nothing says where the reference lies, they lie in its pixels, x = column + 0.5 and y = -(row + 0.5), and name none.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.exports.content import Content, Ground, ImageInfo, ground_of
from featreg.geolocation.footprint import outline
from featreg.geolocation.projection import Projection
from featreg.geometry import local_linear
from featreg.interfaces import FailedFit
from featreg.types import FloatArray

#: Corners of an ellipse, and the squared radius within which 95 % of a two-dimensional normal error lies.
CORNERS, RADIUS2 = 24, -2 * math.log(0.05)

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Layers:
    """M tie points and two images on one map.

    Parameters
    ----------
    crs : WKT or authority code; empty for the reference's pixels
    columns : name -> (M,), of the result's table of tie points
    points : (M, 2), where the reference's points lie
    arrows : (M, 2, 2), from there to where the secondary's point lies; NaN where that is not known
    arrows_by : what says where the secondary's point lies: "geolocation" of the secondary itself, "model" (its inverse,
        so that the arrow is the residual), "pixels" (both in the pixels of their images), "nothing"
    ellipses : (M, 25, 2) closed rings that hold 95 % of the error that the tie points' covariances state, NaN where
        there is none
    outlines : the images' attributes and rings (K, 2)
    """

    crs: str
    columns: Mapping[str, NDArray[Any]]
    points: FloatArray
    arrows: FloatArray
    arrows_by: str
    ellipses: FloatArray
    outlines: list[tuple[dict[str, Any], FloatArray]]


def layers_of(content: Content) -> Layers:
    """Return the layers of what is exported.

    Raises
    ------
    InputError
        A tie point has no place on the ground.
    """
    here, there = content.matches.reference_xy, content.matches.secondary_xy
    ground = ground_of(content.reference, here, content.model)
    located = ground is not None
    crs = ground.crs if ground is not None else ""
    on_map = partial(_placed, content.reference, content.model) if located else _flat
    points = on_map(here)
    ends, by = _ends(content, crs, located, on_map, there)
    return Layers(
        crs,
        content.columns,
        points,
        np.stack([points, ends], axis=1),
        by,
        _ellipses(content, on_map, points),
        list(_outlines(content, crs, located, on_map)),
    )


def _flat(xy: FloatArray) -> FloatArray:
    return np.asarray((xy + 0.5) * (1, -1))


def _placed(image: ImageInfo, model: Any, xy: FloatArray) -> FloatArray:
    ground = ground_of(image, xy, model)
    return _flat(xy) if ground is None else ground.xyz[:, :2]


def _in(crs: str, ground: Ground) -> FloatArray | None:
    """Ground coordinates in another coordinate system; None where one of the two is not known."""
    if ground.crs == crs:
        return ground.xyz[:, :2]
    if not ground.crs or not crs:
        return None
    return Projection(crs).from_lonlat(Projection(ground.crs).to_lonlat(ground.xyz[:, :2]))


def _ends(
    content: Content, crs: str, located: bool, on_map: Callable[[FloatArray], FloatArray], there: FloatArray
) -> tuple[FloatArray, str]:
    """Where the secondary's points lie on the map of the reference, and what says so."""
    ground = ground_of(content.secondary, there, content.model)
    if located and ground is not None:
        found = _in(crs, ground)
        if found is not None:
            return found, "geolocation"
    if not located and ground is None:
        return _flat(there), "pixels"
    back = _back(content, there)
    return (np.full((len(there), 2), np.nan), "nothing") if back is None else (on_map(back), "model")


def _back(content: Content, xy: FloatArray) -> FloatArray | None:
    """Points of the secondary in the reference by the inverse of the model; None where there is none."""
    if isinstance(content.model, FailedFit):
        return None
    try:
        found = np.asarray(content.model.inverse(xy), np.float64)
    except InputError as error:
        logger.warning("the model cannot be inverted, so what needs it is left out (%s)", error)
        return None
    return found if np.isfinite(found).all() else None


def _ellipses(content: Content, on_map: Callable[[FloatArray], FloatArray], points: FloatArray) -> FloatArray:
    """The covariances, which are of the secondary's position, seen from the reference and laid on the map."""
    rings = np.full((len(points), CORNERS + 1, 2), np.nan)
    covariance, model = content.matches.covariance, content.model
    if covariance is None or isinstance(model, FailedFit) or not len(points):
        return rings
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    rest = yy - np.divide(xy**2, xx, out=np.full_like(xx, np.nan), where=xx > 0)
    known = np.flatnonzero((xx > 0) & (rest > 0))
    at = content.matches.reference_xy[known]
    root = np.zeros((len(known), 2, 2))
    root[:, 0, 0], root[:, 1, 1] = np.sqrt(xx[known]), np.sqrt(rest[known])
    root[:, 1, 0] = xy[known] / root[:, 0, 0]
    # An ellipse is so small that model and map are linear over it.
    steps = (np.array([0.5, 0.0]), np.array([0.0, 0.5]))
    to_map = np.stack([on_map(at + step) - on_map(at - step) for step in steps], axis=-1)
    shape = to_map @ np.linalg.solve(local_linear(model, at), root)
    angle = 2 * np.pi * np.arange(CORNERS + 1) / CORNERS
    circle = math.sqrt(RADIUS2) * np.stack([np.cos(angle), np.sin(angle)])
    circle[:, -1] = circle[:, 0]
    rings[known] = points[known, None] + np.swapaxes(shape @ circle, 1, 2)
    return rings


def _outlines(content: Content, crs: str, located: bool, on_map: Callable[[FloatArray], FloatArray]) -> Any:
    for role, image in (("reference", content.reference), ("secondary", content.secondary)):
        if image.size == (0, 0):
            continue
        ring = outline(image.size)
        by = "geolocation" if located else "pixels"
        try:
            if role == "reference":
                placed = on_map(ring)
            else:
                ground = ground_of(image, ring, content.model)
                own = _in(crs, ground) if ground is not None and located else None
                back = _back(content, ring) if own is None else None
                if own is None and back is None:
                    continue
                placed, by = (own, "geolocation") if own is not None else (on_map(np.asarray(back)), "model")
        except InputError:
            # The tie points have their places by now, so it is the rim that has none.
            logger.warning("%s: its rim does not lie on the ground, so its outline is left out", image.path)
            continue
        height, width = image.size
        facts = {"image": role, "path": image.path, "width": width, "height": height, "placed_by": by}
        yield {**facts, **content.verdict}, placed
