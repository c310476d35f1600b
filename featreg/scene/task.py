"""The work of one block, as a function that any process can run from names, parameters and windows."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.geometry.robust import irls
from featreg.geometry.uncertainty import inverse_variances
from featreg.interfaces import FailedFit, Filter, FilterContext, Matcher, Model
from featreg.io.excerpt import Excerpt, together
from featreg.io.raster_files import unchanged
from featreg.io.raster_source import Source, Window
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.frame import Frame, frame_of, linear_at
from featreg.pipeline.inputs import local_scale, searched_record
from featreg.pipeline.locate import Locate
from featreg.pipeline.refine import Refine
from featreg.pipeline.steps import (
    LEAST_LOCATED,
    LOCATED_SCALE_PX,
    NEAR_PX,
    ROUNDS,
    SCALE_PX,
    filtered,
    survivors,
)
from featreg.runtime.timing import collecting, stage
from featreg.sar.bridging import bridged, on_samples
from featreg.scene.blocks import Block, proportional_part
from featreg.scene.drawn import moving, without_drawn, words
from featreg.scene.prior import Prior
from featreg.scene.window_model import WindowModel
from featreg.types import BoolArray, FloatArray, Image, IntArray, Matches

#: Least share of a window's pixels that are data.
LEAST_VALID = 0.05
#: Side of the cells whose means tell structure from speckle, px, and how many times the variance of these means must
#: exceed what independent pixels give. Speckle alone gives 1, oversampled speckle up to 4.
CELL = 16
STRUCTURE = 6.0
#: Share of the squared mean below which a variance is an error of rounding.
ROUNDING = 1e-10
#: Tie points of a block that determine its own affine model, and those that determine a shift.
LEAST_AFFINE, LEAST_SHIFT = 24, 6
#: In standard deviations of located tie points (the Mahalanobis distance), the farthest that a corner of the window may
#: lie from their middle: 2.5 where they lie all over it, 5.5 where they fill half of it, 7.4 where they fill a quarter.
#: Over 14 scenes of 300 m of relief, whose points lie on some of the slopes, 6 costs a tenth of the model's precision.
FAR = 7.5
#: Refined tie points of a block of up to 600 x 600 pixels, and pixels for each of a larger one.
REFINED, PIXELS_PER_REFINED = 64, 600 * 600 // 64

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Job:
    """What all blocks of a scene have in common.

    Parameters
    ----------
    reference, secondary : the scenes
    matcher : the source of tie points
    filters : (name, filter) of those that run block by block, in their order
    model : class of the model to be fitted over all blocks, which filters may ask for
    refine : the refinement, or None
    seed : of everything random
    n_features : most tie points of a block
    halo : pixels read beyond a block on each side
    own_process : whether the work is done in a process of its own, whose library threads are ours to set
    initial : a model known beforehand, in pixels of the scenes, which filters may ask for
    areas : the overlap in the reference and in the secondary, where the second is divided in proportion to the first
        and the prior is not asked for each block
    """

    reference: Source
    secondary: Source
    matcher: Matcher
    filters: tuple[tuple[str, Filter], ...]
    model: type[Model]
    refine: Refine | None
    seed: int
    n_features: int
    halo: int
    own_process: bool = False
    initial: Model | None = None
    locate: Locate | None = None
    areas: tuple[Window, Window] | None = None


@dataclass(frozen=True, eq=False)
class BlockResult:
    """What came of one block: columns in scene coordinates.

    Parameters
    ----------
    index : of the block
    status : "done", "skipped" or "failed"
    reason : why it was skipped or failed, or what of it did not vote
    matches : its own putative tie points
    stages : name -> (M,) bool, of the prior and of each local filter, in their order
    refined : its own refined tie points
    located : those of its matches that were measured again; `origin` names rows of `matches`
    searched : where in its windows tie points were looked for, as a result records it; empty where nobody tells
    candidates : points that refinement looked at
    window : of the secondary that was searched, or None
    seconds : by stage; of this run only
    """

    index: int
    status: str
    reason: str = ""
    matches: Matches = field(default_factory=Matches.empty)
    stages: Mapping[str, BoolArray] = field(default_factory=dict)
    refined: Matches = field(default_factory=Matches.empty)
    candidates: int = 0
    window: Window | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    located: Matches = field(default_factory=Matches.empty)
    searched: Mapping[str, Any] = field(default_factory=dict)

    @property
    def supported(self) -> BoolArray:
        """(M,) tie points that every stage of the block kept."""
        return survivors(self.stages, len(self.matches))


def run_block(job: Job, prior: Prior, block: Block) -> BlockResult:
    """Match one block; whatever goes wrong is said in the result, and the scene goes on."""
    import cv2

    if job.own_process and cv2.getNumThreads() != 1:
        cv2.setNumThreads(1)
    try:
        with collecting() as seconds, unchanged():
            result = _matched(job, prior, block)
        return replace(result, seconds=dict(seconds))
    except Exception as error:
        logger.debug("block %d failed", block.index, exc_info=True)
        text = " ".join(str(error).split()) or "no message"
        return BlockResult(block.index, "failed", f"{type(error).__name__}: {text}"[:300])


def _matched(job: Job, prior: Prior, block: Block) -> BlockResult:
    here = block.window.grown(job.halo)
    if job.areas is None:
        there = search_window(prior, here, job.secondary.shape)
    else:
        there = proportional_part(here, *job.areas).within(job.secondary.shape)
    if there is None:
        return BlockResult(block.index, "skipped", "outside the secondary")
    # What is drawn on both scenes is looked for over both windows in both.
    around = together(here, there) if job.reference.shape == job.secondary.shape else None
    scene, other = (source if around is None else Excerpt(source, around) for source in (job.reference, job.secondary))
    with stage("read"):
        read = scene.read(here)
        reference = bridged(read)
        why = skip_reason(reference, "reference")
        if not why:
            read_there = other.read(there)
            secondary = bridged(read_there)
            why = skip_reason(secondary, "secondary")
    if why:
        return BlockResult(block.index, "skipped", why, window=there)
    with stage("identical"):
        read, read_there, drawn = without_drawn(scene, other, here, there, read, read_there)
        if drawn is not None:
            reference, secondary = bridged(read), bridged(read_there)
    frame = None if job.areas else _frame(job, prior, here, there)
    if frame is not None:
        with stage("prior"):
            secondary = frame.resampled(secondary)
    expected = None if job.areas else _linear_prior(prior, here, there, frame)
    if expected is None:
        found = job.matcher.match(reference, secondary)
    else:
        found = job.matcher.match_near(reference, secondary, expected, math.sqrt(2) * prior.uncertainty_px)
    looked = searched_record(job.matcher, reference, secondary)
    found = on_samples(found, reference, secondary)
    own = found if frame is None else frame.back(found)
    if drawn is not None:
        rows = np.flatnonzero(moving(own, here, there))
        found, own = found.take(rows), own.take(rows)
    rng = np.random.default_rng([job.seed, block.index])
    known = None if job.initial is None else WindowModel(job.initial, here, there)
    middle = here.x + here.width / 2, here.y + here.height / 2
    # In the frame of the reference the pixels are as large as there.
    ratio = 1.0 if frame is not None else 1 / (local_scale(prior, middle) or 1.0)
    context = FilterContext(reference.shape, secondary.shape, job.model, rng, known, (ratio, ratio))
    with stage("prior"):
        predicted = prior(own.reference_xy + here.origin) - there.origin
        # A point that the prior does not reach cannot agree with it.
        off = np.hypot(*(predicted - own.secondary_xy).T)
        near = np.nan_to_num(off, nan=np.inf) <= prior.uncertainty_px * np.sqrt(2)
    stages = filtered(found, job.filters, context, {"prior": near})
    located, refined, candidates = Matches.empty(), Matches.empty(), 0
    if job.locate is not None or job.refine is not None:
        kept = np.flatnonzero(survivors(stages, len(found)))
        local, near = _local_model(prior, here, there, frame, found.take(kept)), False
        if job.locate is not None and local is not None:
            with stage("locate"):
                seen_at = job.locate.run(reference, secondary, local, found, kept)
                located = _moved(seen_at if frame is None else frame.back(seen_at), here, there, seen_at.origin)
                measured = measured_model(local, seen_at, len(kept), reference.shape)
                local, near = (local, False) if measured is None else (measured, True)
        if job.refine is not None and local is not None:
            with stage("refine"):
                wanted = refined_points(block.window)
                seen = job.refine.run(reference, secondary, local, Matches.empty(), wanted, near=near)
                refined = seen.matches if frame is None else frame.back(seen.matches)
                refined, candidates = _moved(refined, here, there), seen.candidates
                refined = refined.take(np.flatnonzero(block.window.holds(refined.reference_xy)))
    matches = _moved(own, here, there)
    mine = np.flatnonzero(block.window.holds(matches.reference_xy))
    # Best first, so that the cap leaves out the least confident; equal scores stay in their order.
    mine = np.sort(mine[np.argsort(-np.nan_to_num(matches.score[mine]), kind="stable")][: job.n_features])
    row_of = np.full(len(matches), -1)
    row_of[mine] = np.arange(len(mine))
    located = located.take(np.flatnonzero(row_of[located.origin] >= 0))
    located = replace(located, origin=row_of[located.origin])
    return BlockResult(
        block.index,
        "done",
        "" if drawn is None else words(drawn),
        matches.take(mine),
        {name: mask[mine] for name, mask in stages.items()},
        refined,
        candidates,
        there,
        located=located,
        searched=looked,
    )


def refined_points(window: Window) -> int:
    """How many points of a block are refined: as many a pixel in large blocks as in those of 600 x 600."""
    return max(REFINED, window.size // PIXELS_PER_REFINED)


def search_window(prior: Prior, here: Window, shape: tuple[int, int]) -> Window | None:
    """The rectangle of the secondary in which the homologous points of a window of the reference may lie, or None."""
    x, y = np.meshgrid(np.linspace(0, here.width - 1, 7), np.linspace(0, here.height - 1, 7))
    at = prior(np.column_stack([x.ravel(), y.ravel()]) + here.origin)
    at = at[np.isfinite(at).all(axis=1)]
    if not len(at):
        return None
    low = np.floor(at.min(axis=0) - prior.uncertainty_px).astype(int).tolist()
    high = np.ceil(at.max(axis=0) + prior.uncertainty_px).astype(int).tolist()
    return Window(low[0], low[1], high[0] - low[0] + 1, high[1] - low[1] + 1).within(shape)


def skip_reason(image: Image, role: str) -> str:
    """Why a window holds nothing to match, or an empty text."""
    import cv2

    valid = None if image.all_valid else image.mask.view(np.uint8)
    share = 1.0 if valid is None else float(image.mask.mean())
    if share < LEAST_VALID:
        return f"no data in the {role}: {100 * share:.0f} % of the window"
    height, width = (n // CELL * CELL for n in image.shape)
    if min(height, width) < 4 * CELL:
        return f"no room in the {role}: {image.shape[1]} x {image.shape[0]} pixels"
    size = (width // CELL, height // CELL)
    means = cv2.resize(image.amplitude[:height, :width], size, interpolation=cv2.INTER_AREA).ravel()
    if valid is not None:
        # Cells that lie wholly on data; the rim of nodata is no structure.
        whole = cv2.resize(valid[:height, :width] * 255, size, interpolation=cv2.INTER_AREA).ravel() == 255
        if whole.sum() < 16:
            return f"no data in the {role}: no cell of {CELL} x {CELL} pixels is whole"
        means = means[whole]
    # Invalid pixels hold 0, so that the moments of all give those of the valid ones, much sooner than by the mask.
    mean, deviation = (float(part[0, 0]) for part in cv2.meanStdDev(image.amplitude))
    square = (mean / share) ** 2
    variance = max((mean**2 + deviation**2) / share - square, ROUNDING * square)
    if float(means.var()) <= STRUCTURE * variance / CELL**2:
        return f"no structure in the {role}: nothing but speckle, as on open water or in shadow"
    return ""


def _frame(job: Job, prior: Prior, here: Window, there: Window) -> Frame | None:
    """The frame in which the window of the secondary looks as that of the reference does, where the sensors state one.

    Complex samples keep their own pixels unless features are all that is compared.
    """
    if not prior.stated or (job.secondary.is_complex and not isinstance(job.matcher, FeatureMatcher)):
        return None
    centre = here.origin + np.array([here.width - 1, here.height - 1]) / 2
    linear = linear_at(prior, centre)
    return None if linear is None else frame_of(linear, there.shape)


def _local_model(prior: Prior, here: Window, there: Window, frame: Frame | None, kept: Matches) -> Affine | None:
    """The affine map of a block in the pixels of its window and of the frame that stands for the other one.

    It is made from the block's own tie points; None where there are none.

    Few tie points only shift what the prior says.
    """
    if len(kept) < LEAST_SHIFT:
        return None
    if len(kept) >= LEAST_AFFINE:
        own, _ = irls(Affine, kept.reference_xy, kept.secondary_xy, scale_px=SCALE_PX, iterations=ROUNDS)
        if not isinstance(own, FailedFit):
            return own
    linear = _linear_prior(prior, here, there, frame)
    if linear is None:
        return None
    off = np.median(kept.secondary_xy - linear(kept.reference_xy), axis=0)
    return Affine(linear.coefficients + np.column_stack([np.zeros((2, 2)), off]))


def measured_model(local: Affine, located: Matches, count: int, shape: tuple[int, int]) -> Affine | None:
    """The affine map of a block by its located tie points near its first one.

    None where of `count` these are few, or where they lie so close together that the map of the whole window, `shape`
    (H, W), would be a guess at its far corners.
    """
    if located.covariance is None:
        return None
    near = located.take(np.flatnonzero(local.residuals(located.reference_xy, located.secondary_xy) <= NEAR_PX))
    if len(near) < max(LEAST_AFFINE, LEAST_LOCATED * count) or near.covariance is None:
        return None
    model, used = irls(
        Affine, near.reference_xy, near.secondary_xy, weights=inverse_variances(near.covariance),
        scale_px=LOCATED_SCALE_PX, iterations=ROUNDS,
    )  # fmt: skip
    if isinstance(model, FailedFit):
        return None
    return model if _reaches(near.reference_xy[used > 0], shape) else None


def _reaches(xy: FloatArray, shape: tuple[int, int]) -> bool:
    """Whether (N, 2) points determine an affine map at the corners of a window: none lies more than `FAR` times as far
    from their middle as they do.
    """
    if len(xy) < LEAST_AFFINE:
        return False
    height, width = shape
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64)
    spread = np.cov(xy.T)
    if np.linalg.det(spread) <= 0:
        return False
    away = corners - xy.mean(axis=0)
    return bool(np.einsum("ni,ij,nj->n", away, np.linalg.inv(spread), away).max() <= FAR**2)


def _linear_prior(prior: Prior, here: Window, there: Window, frame: Frame | None) -> Affine | None:
    """What the prior says of a block, as an affine map in the pixels of its window and of the frame or other window."""
    x, y = np.meshgrid(np.linspace(0, here.width - 1, 5), np.linspace(0, here.height - 1, 5))
    lattice = np.column_stack([x.ravel(), y.ravel()])
    mapped = prior(lattice + here.origin) - there.origin
    mapped = mapped if frame is None else frame.from_secondary(mapped)
    good = np.isfinite(mapped).all(axis=1)
    linear = Affine.from_estimate(lattice[good], mapped[good])
    return None if isinstance(linear, FailedFit) else linear


def _moved(matches: Matches, here: Window, there: Window, origin: IntArray | None = None) -> Matches:
    """Tie points of two windows in the coordinates of the scenes; of no match unless `origin` says of which."""
    return replace(
        matches,
        reference_xy=matches.reference_xy + here.origin,
        secondary_xy=matches.secondary_xy + there.origin,
        origin=np.full(len(matches), -1) if origin is None else origin,
    )


def columns_of(result: BlockResult) -> dict[str, NDArray[Any]]:
    """A finished block as plain arrays, enough to make it again with `from_columns`."""
    out: dict[str, NDArray[Any]] = {
        "index": np.array(result.index),
        "status": np.array(result.status),
        "reason": np.array(result.reason),
        "candidates": np.array(result.candidates),
        "searched": np.array(json.dumps(result.searched)),
        "window": np.array([] if result.window is None else [*vars(result.window).values()], np.int64),
        "stages": np.array(list(result.stages), np.str_),
        "masks": np.array(list(result.stages.values()), np.bool_).reshape(len(result.stages), len(result.matches)),
    }
    for part, matches in (("matches", result.matches), ("refined", result.refined), ("located", result.located)):
        for name in ("reference_xy", "secondary_xy", "score", "covariance", "origin", "rotation", "scale_ratio"):
            values: FloatArray | None = getattr(matches, name)
            if values is not None:
                out[f"{part}.{name}"] = values
    return out


def from_columns(columns: Mapping[str, NDArray[Any]]) -> BlockResult:
    """The block of `columns_of`."""
    parts = {}
    for part in ("matches", "refined", "located"):
        known = {k.partition(".")[2]: v for k, v in columns.items() if k.startswith(f"{part}.")}
        parts[part] = Matches(**known)
    window = columns["window"].tolist()
    return BlockResult(
        int(columns["index"]),
        str(columns["status"]),
        str(columns["reason"]),
        parts["matches"],
        {str(name): mask for name, mask in zip(columns["stages"], columns["masks"], strict=True)},
        parts["refined"],
        int(columns["candidates"]),
        Window(*window) if window else None,
        located=parts["located"],
        searched=json.loads(str(columns["searched"])),
    )
