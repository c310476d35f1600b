"""Where a block's window lies in the secondary before anything is matched: sensors, a known model, or overviews."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from featreg.errors import FeatregError, NoOverlapError
from featreg.geolocation import Heights, find_overlap, sensor_of
from featreg.geometry import Affine, Translation
from featreg.interfaces import FailedFit, Model
from featreg.pipeline import Pipeline
from featreg.raster_source import Source, Window
from featreg.robust import fit_consensus
from featreg.types import FloatArray, Registration

#: Longer side of the overviews of a coarse match, px.
OVERVIEW = 1000
#: Pixels of an overview by which its match may be off.
COARSE_PX = 3.0
#: A prior that is off by no more than this needs no pilot blocks, px.
SHARP_PX = 10.0
#: Least uncertainty of a prior that was corrected by pilot blocks, px, and tie points it takes.
LEAST_PX = 6.0
LEAST_PILOTS = 40
#: Relief that the heights do not know may bend a prior by so much around its correction, px.
BENT_PX = 8.0

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Prior:
    """A rough map reference -> secondary.

    Parameters
    ----------
    base : the map, of sensors or a model; NaN where it does not reach
    correction : what pilot blocks found it to be off by, in the secondary's pixels, or None
    uncertainty_px : how far it may be off along either axis, px
    source : where it comes from, for the record
    """

    base: Model
    uncertainty_px: float
    source: str
    correction: Model | None = None

    def __call__(self, xy: FloatArray) -> FloatArray:
        """Map (N, 2) reference points to the secondary image."""
        mapped = self.base(xy)
        return mapped if self.correction is None else self.correction(mapped)

    def record(self) -> dict[str, Any]:
        """What the result says of it, and what tells it from another."""
        correction = None if self.correction is None else self.correction.matrix
        return {
            "source": self.source,
            "uncertainty_px": self.uncertainty_px,
            "correction": None if correction is None else correction[:2].tolist(),
        }


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
    factor = max(1, math.ceil(max(*reference.shape, *secondary.shape) / OVERVIEW))
    result = pipeline.run(reference.overview(factor), secondary.overview(factor), seed=seed)
    if isinstance(result.model, FailedFit) or result.model.matrix is None:
        return result, Affine(np.eye(3)[:2])
    # The pixel (x, y) of an overview has its centre at factor * x + (factor - 1) / 2.
    up = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]], np.float64)
    matrix = up @ result.model.matrix @ np.linalg.inv(up)
    return result, Affine(matrix[:2])


def coarse_uncertainty(reference: Source, secondary: Source) -> float:
    """How far the match of the overviews may be off, px of the scenes."""
    return COARSE_PX * max(1, math.ceil(max(*reference.shape, *secondary.shape) / OVERVIEW)) + 2.0


def corrected(
    prior: Prior, reference_xy: FloatArray, secondary_xy: FloatArray, rng: np.random.Generator
) -> Prior:
    """The prior with what the tie points of the pilot blocks say it is off by; itself where they do not agree.

    Its new uncertainty covers the residuals of these tie points with a margin, and never grows.
    """
    if len(reference_xy) < LEAST_PILOTS:
        logger.info("pilot blocks: %d tie points, too few to correct the prior", len(reference_xy))
        return prior
    mapped = prior.base(reference_xy)
    good = np.isfinite(mapped).all(axis=1)
    kinds: tuple[type[Affine] | type[Translation], ...] = (Affine, Translation)
    fit: Callable[..., Any] = fit_consensus
    for kind in kinds:
        model, kept = fit(kind, mapped[good], secondary_xy[good], threshold=BENT_PX, rng=rng)
        if isinstance(model, FailedFit) or kept.sum() < max(LEAST_PILOTS // 2, 0.5 * good.sum()):
            continue
        try:
            residuals = model.residuals(mapped[good][kept], secondary_xy[good][kept])
        except FeatregError:
            continue
        reach = float(np.ceil(1.5 * np.percentile(residuals, 98) + 4.0))
        uncertainty = min(prior.uncertainty_px, max(reach, LEAST_PX))
        return Prior(prior.base, uncertainty, f"{prior.source}, corrected by pilot blocks", model)
    logger.info("pilot blocks: %d tie points that do not agree on a correction", len(reference_xy))
    return prior
