"""The first prior of a scene: from a known model, from the geolocation of both images, or from their overviews."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from featreg.errors import InputError, NoOverlapError
from featreg.geolocation import Heights, RpcBias, find_overlap, sensor_of
from featreg.geolocation.projection import check_proj
from featreg.geometry import Affine
from featreg.interfaces import FailedFit, Model
from featreg.io.raster_source import Source, Window
from featreg.pipeline.inputs import input_image
from featreg.pipeline.pipeline import Pipeline
from featreg.results.registration import Registration
from featreg.scene.prior import Prior
from featreg.types import Image, Matches

#: Longer side of the overviews of a coarse match, px.
OVERVIEW = 1000
#: Pixels of an overview by which its match may be off.
COARSE_PX = 3.0

logger = logging.getLogger(__name__)


def first_prior(
    pipeline: Pipeline,
    reference: Source,
    secondary: Source,
    heights: Heights,
    seed: int,
    initial: Model | None,
    search_radius: float | None,
    asked: str | None = None,
) -> tuple[Prior, Window] | Registration:
    """Prior and overlap from the model given, the geolocation, or a coarse match, whose failure is the result.

    `asked` is "none" to leave the geolocation aside, "geolocation" to have it or an `InputError`.
    """
    shapes = reference.shape, secondary.shape
    if initial is not None:
        return from_model(initial, float(search_radius or 0), "initial model", shapes)
    if asked != "none" and (asked or (reference.geolocation is not None and secondary.geolocation is not None)):
        try:
            return from_sensors(reference, secondary, heights)
        except InputError as error:
            check_proj()
            # A transform without a coordinate system, for example, does not locate an image.
            if asked is not None or not _unlocated(reference, secondary):
                raise
            logger.info("no prior from the geolocation: %s", error)
    plain = pipeline if not issubclass(pipeline.model, RpcBias) else replace(pipeline, model=Affine)
    result, model = coarse_match(plain, reference, secondary, seed)
    if result.status == "ok":
        return from_model(model, coarse_uncertainty(reference, secondary), "coarse match of overviews", shapes)
    without = "without geolocation" if asked is None else "with prior 'none'"
    reason = f"{without} the prior is a match of the overviews, which failed: {result.reason}"
    # Where features were looked for in overviews is told in their pixels, which are not those of the scenes.
    provenance = {name: value for name, value in result.provenance.items() if name != "searched"}
    return Registration(
        Matches.empty(), {}, np.zeros(0, np.bool_), FailedFit(reason), "unreliable", reason,
        provenance=provenance, timings=result.timings, reference=input_image(reference),
        secondary=input_image(secondary),
    )  # fmt: skip


def _unlocated(*sources: Source) -> bool:
    for source in sources:
        try:
            sensor_of(source.geolocation, source.shape, source.name)
        except InputError:
            return True
    return False


def from_sensors(reference: Source, secondary: Source, heights: Heights) -> tuple[Prior, Window]:
    """The prior of both images' geolocation, and the overlap in the reference.

    Raises
    ------
    NoOverlapError
        The images do not see the same ground.
    """
    names = reference.name, secondary.name
    sensors = [
        sensor_of(source.geolocation, source.shape, name)
        for source, name in zip((reference, secondary), names, strict=True)
    ]
    found = find_overlap(sensors[0], sensors[1], reference.shape, secondary.shape, heights, names=names)
    return Prior(found.transfer, max(found.uncertainty_px, 2.0), "geolocation"), found.reference


def from_model(model: Model, radius: float, source: str, shapes: Sequence[tuple[int, int]]) -> tuple[Prior, Window]:
    """The prior of a model, and the rectangle of the reference around what it maps into the secondary.

    Raises
    ------
    NoOverlapError
        It maps no part of the reference into the secondary.
    """
    (height, width), (there_h, there_w) = shapes
    xs, ys = np.linspace(0, width - 1, 65), np.linspace(0, height - 1, 65)
    x, y = np.meshgrid(xs, ys)
    at = model(np.column_stack([x.ravel(), y.ravel()]))
    inside = ((at >= -radius) & (at <= np.array([there_w, there_h]) - 1 + radius)).all(axis=1).reshape(65, 65)
    if not inside.any():
        raise NoOverlapError(f"the prior ({source}) maps no part of the reference into the secondary")
    # One step of the lattice more on every side, because the rim of the overlap lies between two nodes.
    rows, cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    left, right = xs[max(cols[0] - 1, 0)], xs[min(cols[-1] + 1, 64)]
    top, bottom = ys[max(rows[0] - 1, 0)], ys[min(rows[-1] + 1, 64)]
    x0, y0 = math.floor(left), math.floor(top)
    return Prior(model, radius, source), Window(x0, y0, math.ceil(right) - x0 + 1, math.ceil(bottom) - y0 + 1)


def coarse_match(pipeline: Pipeline, reference: Source, secondary: Source, seed: int) -> tuple[Registration, Affine]:
    """Register overviews of both images; returns that registration and its model in pixels of the scenes.

    The model is the identity where the registration could not be made.
    """
    factor = _reduction(reference, secondary)
    result = pipeline.run(*overviews(reference, secondary), seed=seed)
    if isinstance(result.model, FailedFit) or result.model.matrix is None:
        return result, Affine(np.eye(3)[:2])
    # The pixel (x, y) of an overview has its centre at factor * x + (factor - 1) / 2.
    up = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]], np.float64)
    matrix = up @ result.model.matrix @ np.linalg.inv(up)
    return result, Affine(matrix[:2])


def coarse_uncertainty(reference: Source, secondary: Source) -> float:
    """How far the match of the overviews may be off, px of the scenes."""
    return COARSE_PX * _reduction(reference, secondary) + 2.0


def overviews(reference: Source, secondary: Source) -> tuple[Image, Image]:
    """Both scenes, reduced alike to at most about 1000 pixels."""
    factor = _reduction(reference, secondary)
    return reference.overview(factor), secondary.overview(factor)


def _reduction(reference: Source, secondary: Source) -> int:
    return max(1, math.ceil(max(*reference.shape, *secondary.shape) / OVERVIEW))
