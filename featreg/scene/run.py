"""A pair of scenes, from two files to a registration."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from featreg.assembly import assemble
from featreg.errors import InputError, ParameterError
from featreg.geolocation import ConstantHeight, DemHeights, Heights, RpcBias, Transfer, sensor_of
from featreg.interfaces import FailedFit, Model
from featreg.pipeline import Gathered, Pipeline
from featreg.presets import PRESETS
from featreg.provenance import versions
from featreg.raster_source import ImageSource, Source, Window
from featreg.scene.blocks import Block, plan_blocks, spread_out
from featreg.scene.execution import Canceller, Lane, open_lane
from featreg.scene.merge import Merged, accuracy, block_gates, concatenated, fit_refined, merge
from featreg.scene.prior import (
    SHARP_PX,
    Prior,
    coarse_match,
    coarse_uncertainty,
    corrected,
    from_model,
    from_sensors,
)
from featreg.scene.state import BlockFiles, digest_of
from featreg.scene.task import BlockResult, Job, run_block
from featreg.timing import collecting, stage
from featreg.types import BoolArray, Gate, IntArray, Matches, Registration

#: Features of a block: detection takes the same time for a hundred as for a thousand.
FEATURES = 1000
#: Cells of GMS along a block, which holds fewer tie points than a whole image does.
GMS_CELLS = 10
#: Pilot blocks, and the fewest blocks for which they are worth their time.
PILOTS = 9
LEAST_FOR_PILOTS = 4

Progress = Callable[[int, int], None]

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SceneOptions:
    """How a scene is worked on; nothing here changes the result but `block`, `dem` and `height`.

    Parameters
    ----------
    block : side of a block, px
    executor, workers : see `featreg.scene.execution.open_lane`
    dem, height : heights of the ground: a file, or metres above the ellipsoid (0 where neither is given)
    resume : folder in which finished blocks are kept and looked for
    progress : called with (blocks done, blocks in all)
    cancel : when set, the work stops with a `CancelledError`
    """

    block: int
    executor: Any = None
    workers: int | None = None
    dem: str | Path | None = None
    height: float | None = None
    resume: str | Path | None = None
    progress: Progress | None = None
    cancel: Canceller | None = None

    def heights(self) -> Heights:
        """The heights of the ground."""
        if self.dem is not None and self.height is not None:
            raise ParameterError("heights come from a DEM file or from one height, not from both: leave out one")
        return ConstantHeight(self.height or 0.0) if self.dem is None else DemHeights(str(self.dem))


def assemble_scene(method: Any, *, n_features: int | None, **keywords: Any) -> Pipeline:
    """`featreg.assembly.assemble` with the budgets of a block where none are asked for."""
    if isinstance(method, Pipeline):
        return assemble(method, n_features=n_features, **keywords)
    preset = PRESETS.get(method) if isinstance(method, str) else None
    given = {"grid", "gms.grid", "filters"} & set(keywords)
    if preset is not None and not given and any(part.name == "gms" for part in preset.filters):
        keywords["gms.grid"] = GMS_CELLS
    return assemble(method, n_features=FEATURES if n_features is None else n_features, **keywords)


def match_scene(
    reference: Source,
    secondary: Source,
    pipeline: Pipeline,
    options: SceneOptions,
    *,
    seed: int = 0,
    initial: Model | None = None,
    search_radius: float | None = None,
) -> Registration:
    """Register two scenes block by block.

    Parameters
    ----------
    reference, secondary : the scenes
    pipeline : the method; its matcher, local filters and refinement run in each block, the other filters, the model and
        trust once over all
    options : how
    seed : of everything random
    initial, search_radius : a model known beforehand, in place of geolocation

    Raises
    ------
    NoOverlapError
        The scenes do not see the same ground.
    InputError, ParameterError, CancelledError
        Input that cannot be used, parameters that cannot be, `options.cancel` was set.
    """
    if pipeline.matcher is None:
        raise ParameterError("this pipeline has no matcher: give it one, or use featreg.fit with tie points")
    with ExitStack() as stack, collecting() as timings:
        lane = stack.enter_context(open_lane(options.executor, options.workers))
        reference, secondary = _shareable(reference, secondary, lane, stack)
        heights = options.heights()
        pipeline = _bound(pipeline, reference, secondary, heights)
        with stage("prior"):
            prior, area, failure = _first_prior(pipeline, reference, secondary, heights, seed, initial, search_radius)
        if failure is not None:
            return failure
        blocks = plan_blocks(area, options.block)
        pipeline = replace(pipeline, n_features=pipeline.n_features * len(blocks))
        job = _job(pipeline, reference, secondary, seed, lane, len(blocks))
        with stage("prior"):
            prior = _piloted(job, prior, blocks, lane, options.cancel, seed)
        with stage("blocks"):
            results, counts = _all_blocks(job, prior, blocks, lane, options, pipeline)
        names = ["prior", *(name for name, _ in job.filters)]
        merged = merge(results, names)
        return _finished(
            pipeline, merged, blocks, results, counts, prior, reference, secondary, options,
            seed=seed, initial=initial, search_radius=search_radius, timings=timings,
        )  # fmt: skip


def _shareable(reference: Source, secondary: Source, lane: Lane, stack: ExitStack) -> tuple[Source, Source]:
    """Scenes in memory go to files for workers that do not share this memory."""
    if not lane.own_process or not any(isinstance(s, ImageSource) for s in (reference, secondary)):
        return reference, secondary
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="featreg-scene-")))
    made: list[Source] = []
    for role, source in (("reference", reference), ("secondary", secondary)):
        made.append(source.spooled(folder, role) if isinstance(source, ImageSource) else source)
    return made[0], made[1]


def _bound(pipeline: Pipeline, reference: Source, secondary: Source, heights: Heights) -> Pipeline:
    """The pipeline with a model that knows the sensors, where it asks for one."""
    if pipeline.model is not RpcBias:
        return pipeline
    sensors = [sensor_of(s.geolocation, s.shape, s.name) for s in (reference, secondary)]
    return replace(pipeline, model=RpcBias.bind(sensors[0], sensors[1], heights))


def _first_prior(
    pipeline: Pipeline,
    reference: Source,
    secondary: Source,
    heights: Heights,
    seed: int,
    initial: Model | None,
    search_radius: float | None,
) -> tuple[Prior, Window, Registration | None]:
    """Prior and overlap from the model given, the geolocation, or a coarse match, whose failure is the result."""
    shapes = reference.shape, secondary.shape
    if initial is not None:
        return *from_model(initial, float(search_radius or 0), "initial model", shapes), None
    if reference.geolocation is not None and secondary.geolocation is not None:
        try:
            return *from_sensors(reference, secondary, heights), None
        except InputError as error:
            # A transform without a coordinate system, for example, does not locate an image.
            if not _unlocated(reference, secondary):
                raise
            logger.info("no prior from the geolocation: %s", error)
    plain = pipeline if not issubclass(pipeline.model, RpcBias) else replace(pipeline, model=_affine())
    result, model = coarse_match(plain, reference, secondary, seed)
    prior, area = from_model(
        model if result.status == "ok" else _affine()([[1, 0, 0], [0, 1, 0]]),
        coarse_uncertainty(reference, secondary),
        "coarse match of overviews",
        shapes,
    )
    if result.status == "ok":
        return prior, area, None
    reason = f"without geolocation the prior is a match of the overviews, which failed: {result.reason}"
    provenance = {**result.provenance, "inputs": inputs_of_sources(reference, secondary)}
    none = Registration(
        Matches.empty(), {}, np.zeros(0, np.bool_), FailedFit(reason), "unreliable", reason,
        provenance=provenance, timings=result.timings,
    )  # fmt: skip
    return prior, area, none


def _affine() -> Any:
    from featreg.geometry import Affine

    return Affine


def _unlocated(*sources: Source) -> bool:
    for source in sources:
        try:
            sensor_of(source.geolocation, source.shape, source.name)
        except InputError:
            return True
    return False


def _job(
    pipeline: Pipeline, reference: Source, secondary: Source, seed: int, lane: Lane, count: int
) -> Job:
    local = tuple((name, keeper) for name, keeper in pipeline.filters if keeper.local)
    return Job(
        reference, secondary, pipeline.matcher, local, pipeline.model, pipeline.refine, seed,
        max(1, pipeline.n_features // count), lane.own_process,
    )  # type: ignore[arg-type]  # fmt: skip


def _piloted(
    job: Job, prior: Prior, blocks: Sequence[Block], lane: Lane, cancel: Canceller | None, seed: int
) -> Prior:
    """The prior, corrected by a few blocks that were searched as widely as its uncertainty asks."""
    if prior.uncertainty_px <= SHARP_PX or len(blocks) < LEAST_FOR_PILOTS:
        return prior
    pilots = spread_out(tuple(blocks), min(PILOTS, max(LEAST_FOR_PILOTS, len(blocks) // 8)))
    found = sorted(
        (result for _, result in lane.run(run_block, (replace(job, refine=None), prior), pilots, cancel)),
        key=lambda result: result.index,
    )
    done = [r for r in found if r.status == "done"]
    together = concatenated([r.matches.take(_survivors(r)) for r in done])
    return corrected(prior, together.reference_xy, together.secondary_xy, np.random.default_rng([seed, len(blocks)]))


def _survivors(result: BlockResult) -> BoolArray:
    """(M,) tie points of a block that every local stage kept."""
    kept = np.ones(len(result.matches), np.bool_)
    for mask in result.stages.values():
        kept = kept & mask
    return kept


def _all_blocks(
    job: Job, prior: Prior, blocks: Sequence[Block], lane: Lane, options: SceneOptions, pipeline: Pipeline
) -> tuple[list[BlockResult], dict[str, int]]:
    """Every block, from its file where there is a sound one; finished ones are saved as they come."""
    files = None
    if options.resume is not None:
        files = BlockFiles(options.resume, digest_of(_ingredients(job, prior, options, pipeline, blocks)))
    results = [] if files is None else [r for r in (files.load(block) for block in blocks) if r is not None]
    reused = len(results)
    known = {r.index for r in results}
    todo = [block for block in blocks if block.index not in known]
    tell = options.progress or (lambda done, total: None)
    tell(reused, len(blocks))
    for position, result in lane.run(run_block, (job, prior), todo, options.cancel):
        # A block that failed is tried again next time.
        if files is not None and result.status != "failed":
            files.save(todo[position], result)
        results.append(result)
        tell(len(results), len(blocks))
    results.sort(key=lambda r: r.index)
    failed = [r for r in results if r.status == "failed"]
    for result in failed[:1]:
        logger.warning("%d of %d blocks failed, the first with %s", len(failed), len(blocks), result.reason)
    counts = {
        "total": len(blocks),
        "computed": len(blocks) - reused - len(failed),
        "reused": reused,
        "skipped": sum(r.status == "skipped" for r in results),
        "failed": len(failed),
    }
    return results, counts


def _ingredients(
    job: Job, prior: Prior, options: SceneOptions, pipeline: Pipeline, blocks: Sequence[Block]
) -> dict[str, Any]:
    """Everything on which the content of a block depends."""
    model = job.model.binding if isinstance(job.model, type) and issubclass(job.model, RpcBias) else None
    base = prior.base
    return {
        "inputs": [job.reference.identity(), job.secondary.identity()],
        "method": pipeline.name,
        "matcher": repr(job.matcher),
        "filters": [[name, repr(keeper)] for name, keeper in job.filters],
        "refine": repr(job.refine),
        "parameters": pipeline.parameters,
        "model": None if model is None else [model[0].parameters, model[1]],
        "seed": job.seed,
        "most": job.most,
        "prior": [prior.record(), base.parameters if isinstance(base, Transfer | Model) else repr(base)],
        "heights": options.heights().to_dict(),
        "blocks": [[b.index, b.window.x, b.window.y, b.window.width, b.window.height] for b in blocks],
        "versions": versions(),
    }


def _finished(
    pipeline: Pipeline,
    merged: Merged,
    blocks: Sequence[Block],
    results: Sequence[BlockResult],
    counts: Mapping[str, int],
    prior: Prior,
    reference: Source,
    secondary: Source,
    options: SceneOptions,
    *,
    seed: int,
    initial: Model | None,
    search_radius: float | None,
    timings: dict[str, float],
) -> Registration:
    """Global filters, model, refined model and trust over the tie points of all blocks."""
    owners: list[IntArray] = [merged.blocks]
    tried = sum(r.status == "done" for r in results)

    def refine(first: Model) -> Any:
        limit = pipeline.refine.max_residual if pipeline.refine is not None else 1.0
        refined, mine = fit_refined(merged, first, limit)
        owners[:] = [merged.blocks, mine]
        return refined

    def gates(matches: Matches, inliers: BoolArray, model: Model) -> Mapping[str, Gate]:
        # Refined tie points that were not worth using were not appended either.
        everyone = np.concatenate(owners)[: len(matches)]
        return block_gates(blocks, tried, everyone[inliers], matches.take(inliers), model, pipeline.limits)

    gathered = Gathered(
        merged.stages, refine if pipeline.refine is not None else None, merged.chance_shape, gates
    )
    result = pipeline.finish(
        merged.matches, reference.shape, secondary.shape, seed=seed, initial=initial, search_radius=search_radius,
        timings=timings, gathered=gathered,
    )  # fmt: skip
    everyone = np.concatenate(owners)[: len(result.matches)]
    final = result.matches.take(result.inliers)
    return replace(
        result,
        timings=dict(timings),
        provenance={
            **result.provenance,
            "inputs": inputs_of_sources(reference, secondary),
            "blocks": {**counts, "size": options.block},
            "block_table": _table(blocks, results, everyone[result.inliers]),
            "tie_point_blocks": everyone,
            "prior": prior.record(),
            "heights": options.heights().to_dict(),
            "accuracy": accuracy(result.model, final, result.gates, reference.shape),
            "block_seconds": _seconds(results),
        },
    )


def _table(blocks: Sequence[Block], results: Sequence[BlockResult], owners: IntArray) -> dict[str, list[Any]]:
    """One row a block, in columns."""
    final = np.bincount(owners, minlength=len(blocks))
    by_index = {r.index: r for r in results}
    ordered = [by_index[block.index] for block in blocks]
    return {
        "row": [b.row for b in blocks],
        "col": [b.col for b in blocks],
        "x": [b.window.x for b in blocks],
        "y": [b.window.y for b in blocks],
        "width": [b.window.width for b in blocks],
        "height": [b.window.height for b in blocks],
        "status": [r.status for r in ordered],
        "reason": [r.reason for r in ordered],
        "putative": [len(r.matches) for r in ordered],
        "kept": [int(_survivors(r).sum()) for r in ordered],
        "refined": [len(r.refined) for r in ordered],
        "final": final.tolist(),
    }


def _seconds(results: Sequence[BlockResult]) -> dict[str, float]:
    """Seconds of all blocks computed now together, by stage."""
    total: dict[str, float] = {}
    for result in results:
        for name, seconds in result.seconds.items():
            total[name] = total.get(name, 0.0) + seconds
    return total


def inputs_of_sources(reference: Source, secondary: Source) -> dict[str, Any]:
    """What the result records of its two scenes."""
    return {
        role: {
            "path": source.name,
            "width": source.shape[1],
            "height": source.shape[0],
            "scale": source.known_scale,
            "dtype": source.dtype,
        }
        for role, source in (("reference", reference), ("secondary", secondary))
    }
