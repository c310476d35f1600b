"""What an export writes: the chosen tie points, their residuals, and what is known of the two images."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, suggest
from featreg.geolocation.geotransform import on_map
from featreg.interfaces import FailedFit, Model
from featreg.results.registration import Registration
from featreg.results.tie_point_table import tie_point_columns
from featreg.types import BoolArray, FloatArray, Geolocation, Matches

#: Stages that every result has, beside its filters.
ALWAYS = ("inliers", "all")

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class ImageInfo:
    """What is known of one image: `path` as it was matched, `size` (H, W), and where it lies if its file is at hand."""

    path: str
    size: tuple[int, int]
    geolocation: Geolocation | None = None


@dataclass(frozen=True, eq=False)
class Content:
    """What is exported.

    Parameters
    ----------
    matches : the chosen tie points, featreg's pixel convention
    offset : (M, 2) model minus tie point in the secondary, px; NaN where there is no model
    columns : name -> (M,), all columns of the result's tie-point table
    model : of the result, or why there is none
    reference, secondary : the images
    verdict : status, reason and method of the result
    """

    matches: Matches
    offset: FloatArray
    columns: Mapping[str, NDArray[Any]]
    model: Model | FailedFit
    reference: ImageInfo
    secondary: ImageInfo
    verdict: Mapping[str, str] = field(default_factory=dict)


def content_of(
    registration: Registration, stage: str, reference: str | Path | None, secondary: str | Path | None
) -> Content:
    """Return what an export of `stage` writes.

    Parameters
    ----------
    registration : the result
    stage : "inliers", the name of a filter, or "all"
    reference, secondary : the images' files where they are no longer where the result says
    """
    rows = rows_of(registration, stage)
    matches = registration.matches.take(rows)
    model = registration.model
    offset = np.full((len(matches), 2), np.nan)
    if not isinstance(model, FailedFit) and len(matches):
        try:
            offset = model(matches.reference_xy) - matches.secondary_xy
        except InputError as error:
            # The elevation model of an RPC bias need not be at hand where the tie points are all that is wanted.
            logger.warning("the model cannot be used, so residuals are left out (%s)", error)
            registration = replace(registration, model=FailedFit(str(error)))
    columns = {name: values[rows] for name, values in tie_point_columns(registration).items()}
    images = [_info(registration, role, path) for role, path in (("reference", reference), ("secondary", secondary))]
    method = str(registration.provenance.get("method", ""))
    verdict = {"status": registration.status, "reason": registration.reason, "method": method}
    return Content(matches, offset, columns, model, images[0], images[1], verdict)


def rows_of(registration: Registration, stage: str) -> BoolArray:
    """Return the (M,) mask of the tie points of a stage.

    Raises
    ------
    ParameterError
        The result has no such stage; the text names those it has.
    """
    if stage == "inliers":
        return registration.inliers
    if stage == "all":
        return np.ones(len(registration.matches), np.bool_)
    if stage not in registration.stages:
        names = (*registration.stages, *ALWAYS)
        hint = suggest(stage, names)
        more = "" if hint.startswith("known") else f" (this result has {', '.join(names)})"
        raise ParameterError(f"the result has no stage '{stage}', {hint}{more}")
    return registration.stages[stage]


def _info(registration: Registration, role: str, given: str | Path | None) -> ImageInfo:
    from featreg.io.raster_files import is_there
    from featreg.io.raster_source import located_source

    known = registration.reference if role == "reference" else registration.secondary
    path = str(given) if given is not None else role if known is None else known.path
    size = (0, 0) if known is None else known.shape
    place = None if known is None else known.geolocation
    if given is None and not is_there(path):
        if place is None and path not in (role, "array", "tie points"):
            logger.warning(
                "the %s '%s' is not there, and the result does not say where it lies: give its file (--%s) for map "
                "coordinates", role, path, role,
            )  # fmt: skip
        return ImageInfo(path, size, place)
    try:
        source = located_source(path, None if known is None else known.band)
        shape, now = source.shape, source.geolocation
    except InputError:
        if given is not None:
            raise
        return ImageInfo(path, size, place)
    if size != (0, 0) and shape != size:
        if given is None:
            return ImageInfo(path, size, place)
        raise InputError(
            f"{path}: {shape[1]} x {shape[0]} pixels, but the {role} of the result was {size[1]} x {size[0]}"
        )
    return ImageInfo(path, shape, now if given is not None or place is None else place)


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground coordinates of points: (M, 3) x, y, height in `crs` (WKT or authority code)."""

    xyz: FloatArray
    crs: str


def ground_of(image: ImageInfo, xy: FloatArray, model: Model | FailedFit) -> Ground | None:
    """Return the ground coordinates of points of an image; None where nothing says where the image lies.

    A geotransform gives its own map coordinates. RPC coefficients and ground control points give longitude, latitude
    and height: on the ground that the model rests on where it has one, else all at one height, the offset of the
    coefficients or the mean of the control points.
    """
    place = image.geolocation
    if place is None:
        return None
    if place.transform is not None and place.rpcs is None and place.sensor is None:
        ground = np.column_stack([on_map(place.transform, xy), np.zeros(len(xy))])
        return Ground(ground, place.crs or "")
    from featreg.geolocation import ConstantHeight, RpcBias, ground_level, sensor_of
    from featreg.geolocation.transfer import on_ground

    if isinstance(model, RpcBias):
        heights = model.heights
    elif place.sensor is not None:
        heights = ConstantHeight(ground_level(sensor_of(place, image.size, image.path))[0])
    elif place.rpcs is not None:
        heights = ConstantHeight(place.rpcs["height_off"])
    elif place.gcps is not None:
        heights = ConstantHeight(place.gcps[:, 4].mean())
    else:
        return None
    if place.sensor is None and place.rpcs is None and not place.crs:
        logger.warning(
            "%s: its ground control points have no coordinate system, the map is its own pixels instead", image.path
        )
        return None
    lonlat, level = on_ground(sensor_of(place, image.size, image.path), np.asarray(xy, np.float64), heights)
    lost = int((~np.isfinite(lonlat).all(axis=1)).sum())
    if lost:
        raise InputError(f"{image.path}: {lost} tie points have no place on the ground")
    return Ground(np.column_stack([lonlat, level]), "EPSG:4326")
