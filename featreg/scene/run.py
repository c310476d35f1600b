"""A pair of scenes, from two files to a registration."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import CancelledError, InputError, NoOverlapError, ParameterError
from featreg.geolocation import ConstantHeight, DemHeights, Heights, RpcBias, Transfer, ground_level, sensor_of
from featreg.geometry import Affine
from featreg.interfaces import Matcher, Model
from featreg.io.raster_files import unchanged
from featreg.io.raster_source import Source
from featreg.io.window import Window
from featreg.pipeline.frame import beyond, linear_at
from featreg.pipeline.inputs import input_image
from featreg.pipeline.pipeline import Pipeline
from featreg.pipeline.steps import located, refined
from featreg.results.losses import block_words, heights_words
from featreg.results.registration import Registration
from featreg.runtime.buffers import give_back_freed
from featreg.runtime.executors import TaskExecutor, open_executor
from featreg.runtime.parameters import check
from featreg.runtime.timing import collecting, stage
from featreg.runtime.versions import versions
from featreg.runtime.watching import Canceller, Progress, cancellable
from featreg.scene.blocks import SPLITS, Block, halo_of, middle_of, plan_blocks, spread_out, suitable_side
from featreg.scene.first_prior import first_prior
from featreg.scene.merge import Merged, accuracy, block_errors, block_gates, concatenated, fit_refined, merge
from featreg.scene.prior import Prior, corrected
from featreg.scene.record import block_table, searched_in, seconds_of, with_final
from featreg.scene.state import BlockFiles, check_folder, digest_of
from featreg.scene.task import BlockResult, Job, run_block, search_window
from featreg.types import Matches

#: Most and fewest pilot blocks.
PILOTS = 9
LEAST_PILOTS = 4
#: How far, px, pilot blocks are searched around what two geolocations say, one step after the other, when they do not
#: agree on less: what products without precise orbits, or with a wrong geoid, are off by.
SEARCH_PX = (100.0, 300.0)

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SceneOptions:
    """How a scene is worked on; nothing here changes the result but `block`, `dem`, `height`, `prior` and `split`.

    Parameters
    ----------
    block : side of a block, px; None is what suits the area of the overlap, see `featreg.scene.blocks.suitable_side`
    executor, workers : see `featreg.runtime.executors.open_executor`
    dem, height : heights of the ground: a file, or metres above the ellipsoid; where neither is given the height offset
        of an RPC, else 0
    resume : folder in which finished blocks are kept and looked for
    progress : called with (blocks done, blocks in all)
    cancel : when set, the work stops with a `CancelledError`
    prior : "none" leaves aside where the files say they lie, "geolocation" asks for it; None takes it where it is
    split : "prior" or "proportional", see `featreg.match`
    """

    block: int | None
    executor: Any = None
    workers: int | None = None
    dem: str | Path | None = None
    height: float | None = None
    resume: str | Path | None = None
    progress: Progress | None = None
    cancel: Canceller | None = None
    prior: str | None = None
    split: str = SPLITS[0]

    def heights(self, *sources: Source) -> tuple[Heights, str]:
        """The heights of the ground under the scenes, and where they come from."""
        if self.height is not None:
            check("height", self.height, float)
        if self.dem is not None and self.height is not None:
            raise ParameterError("heights come from a DEM file or from one height, not from both: leave out one")
        if self.dem is not None:
            return DemHeights(os.path.abspath(self.dem)), "elevation model"
        if self.height is not None:
            return ConstantHeight(self.height), "stated"
        sensors = []
        for source in sources:
            # Whoever needs the geolocation says what is wrong with it.
            with suppress(InputError):
                sensors.append(sensor_of(source.geolocation, source.shape, source.name))
        level, whence = ground_level(*sensors)
        return ConstantHeight(level), whence


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
    pipeline : the method; its matcher, its `block_filters` and refinement run in each block, the other filters, the
        model and trust once over all
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
    matcher = pipeline.matcher
    if matcher is None:
        raise ParameterError("this pipeline has no matcher: give it one, or use featreg.fit with tie points")
    heights, whence = options.heights(reference, secondary)
    _check_heights(options, pipeline, (reference, secondary), initial)
    if options.resume is not None:
        check_folder(options.resume)  # before the prior and the pilot blocks take their time
    with _finished_blocks_kept(options.resume), collecting() as timings:
        with ExitStack() as stack:
            executor = stack.enter_context(open_executor(options.executor, options.workers))
            shared = shareable(reference, secondary, executor, stack)
            pipeline = _bound(pipeline, reference, secondary, heights)
            with cancellable(options.cancel), stage("prior"), unchanged():
                found = first_prior(
                    pipeline, reference, secondary, heights, seed, initial, search_radius, options.prior
                )
            if isinstance(found, Registration):
                return found
            prior, area = found
            size = options.block or suitable_side(area, pipeline, options.split)
            blocks = plan_blocks(area, size)
            pipeline = replace(pipeline, n_features=pipeline.n_features * len(blocks))
            job = _job(pipeline, matcher, *shared, seed, executor, len(blocks), initial)
            if options.split == "proportional":
                job = replace(job, areas=_areas(prior, area, secondary), halo=0)
                # Each block is compared with a whole part, whatever the prior claims.
                prior = replace(prior, uncertainty_px=max(prior.uncertainty_px, size / 2))
            with stage("prior"):
                prior = prior if job.areas else _piloted(job, prior, blocks, executor, options.cancel, seed)
            with stage("blocks"):
                results, counts = _all_blocks(
                    job, prior, blocks, executor, options, pipeline, (reference, secondary), heights
                )
        # The workers are gone, and the columns of the blocks go once they are put together: what is left to do needs
        # the memory more.
        record = (
            {**counts, "size": size, "halo": job.halo},
            block_table(blocks, results),
            {"block_seconds": seconds_of(results), **searched_in(results)},
        )
        merged = merge(results, ["prior", *(name for name, _ in job.filters)])
        results.clear()
        give_back_freed()
        with cancellable(options.cancel):
            return _finished(
                pipeline, merged, blocks, record, prior, reference, secondary, {**heights.to_dict(), "source": whence},
                seed=seed, initial=initial, search_radius=search_radius, timings=timings,
            )  # fmt: skip


@contextmanager
def _finished_blocks_kept(resume: str | Path | None) -> Iterator[None]:
    """Say of a scene that was cancelled how to go on."""
    try:
        yield
    except CancelledError as error:
        how = "with resume= the finished blocks are kept" if resume is None else f"finished blocks are in '{resume}'"
        raise CancelledError(f"the scene was cancelled; {how}") from error


def _check_heights(options: SceneOptions, pipeline: Pipeline, sources: Sequence[Source], initial: Model | None) -> None:
    """Raise where heights of the ground were given that nothing would look at."""
    given = next((name for name in ("dem", "height") if getattr(options, name) is not None), None)
    if given is None or pipeline.model is RpcBias:
        return
    if initial is not None:
        raise ParameterError(f"{given} does nothing here: the prior is the initial model; leave one of them out")
    if options.prior == "none":
        raise ParameterError(f"{given} does nothing here: prior='none' leaves aside where the files say they lie")
    for source in sources:
        if source.geolocation is None:
            raise ParameterError(
                f"{given} does nothing here: {source.name} does not say where it lies, so the prior is a match of the "
                "overviews; leave it out"
            )


def shareable(reference: Source, secondary: Source, executor: TaskExecutor, stack: ExitStack) -> tuple[Source, Source]:
    """The scenes as workers that do not share this memory and this folder find them: as files, by absolute names."""
    if not executor.own_process:
        return reference, secondary
    made: list[Path] = []

    def folder() -> Path:
        if not made:
            made.append(Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="featreg-scene-"))))
        return made[0]

    return reference.shareable(folder, "reference"), secondary.shareable(folder, "secondary")


def _bound(pipeline: Pipeline, reference: Source, secondary: Source, heights: Heights) -> Pipeline:
    """The pipeline with a model that knows the sensors, where it asks for one."""
    if pipeline.model is not RpcBias:
        return pipeline
    sensors = [sensor_of(s.geolocation, s.shape, s.name) for s in (reference, secondary)]
    return replace(pipeline, model=RpcBias.bind(sensors[0], sensors[1], heights))


def _job(
    pipeline: Pipeline,
    matcher: Matcher,
    reference: Source,
    secondary: Source,
    seed: int,
    executor: TaskExecutor,
    count: int,
    initial: Model | None,
) -> Job:
    return Job(
        reference, secondary, matcher, pipeline.block_filters, pipeline.model, pipeline.refine, seed,
        max(1, pipeline.n_features // count), halo_of(matcher, pipeline.locate, pipeline.refine),
        executor.own_process, initial, pipeline.locate,
    )  # fmt: skip


def _areas(prior: Prior, area: Window, secondary: Source) -> tuple[Window, Window]:
    """The overlap in the reference, and the upright rectangle that it covers in the secondary."""
    there = search_window(replace(prior, uncertainty_px=0.0), area, secondary.shape)
    if there is None:
        raise NoOverlapError(f"the prior ({prior.source}) maps no part of the reference into the secondary")
    return area, there


def _piloted(
    job: Job, prior: Prior, blocks: Sequence[Block], executor: TaskExecutor, cancel: Canceller | None, seed: int
) -> Prior:
    """The prior, corrected by a few blocks that were searched as widely as its uncertainty asks.

    Where these do not agree, the geography of the images is taken to be off by more: they are searched more widely, in
    steps up to a limit, which the prior records where nothing is found either.
    """
    pilots = [middle_of(block) for block in spread_out(tuple(blocks), min(PILOTS, max(LEAST_PILOTS, len(blocks) // 8)))]
    first = prior.widened()
    wider = [r for r in SEARCH_PX if r > first.uncertainty_px] if prior.stated else []
    for search in (first, *(replace(prior, uncertainty_px=radius) for radius in wider)):
        found = sorted(
            (
                result
                for _, result in executor.run(
                    run_block, (replace(job, locate=None, refine=None), search), pilots, cancel
                )
            ),
            key=lambda result: result.index,
        )
        done = [r for r in found if r.status == "done"]
        together = concatenated([r.matches.take(r.supported) for r in done])
        rng = np.random.default_rng([seed, len(blocks)])
        better = corrected(prior, together.reference_xy, together.secondary_xy, rng)
        if better is not prior or not done:
            return better
    return replace(prior, searched_px=search.uncertainty_px)


def _all_blocks(
    job: Job,
    prior: Prior,
    blocks: Sequence[Block],
    executor: TaskExecutor,
    options: SceneOptions,
    pipeline: Pipeline,
    sources: Sequence[Source],
    heights: Heights,
) -> tuple[list[BlockResult], dict[str, int]]:
    """Every block, from its file where there is a sound one; finished ones are saved as they come."""
    files = None
    if options.resume is not None:
        files = BlockFiles(options.resume, digest_of(_ingredients(job, prior, heights, pipeline, blocks, sources)))
    results = [] if files is None else [r for r in (files.load(block) for block in blocks) if r is not None]
    reused = len(results)
    known = {r.index for r in results}
    todo = [block for block in blocks if block.index not in known]
    tell = options.progress or (lambda done, total: None)
    tell(reused, len(blocks))
    for position, result in executor.run(run_block, (job, prior), todo, options.cancel):
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
    job: Job,
    prior: Prior,
    heights: Heights,
    pipeline: Pipeline,
    blocks: Sequence[Block],
    sources: Sequence[Source],
) -> dict[str, Any]:
    """Everything on which the content of a block depends."""
    model = job.model.binding if isinstance(job.model, type) and issubclass(job.model, RpcBias) else None
    base = prior.base
    return {
        "inputs": [source.identity() for source in sources],
        "method": pipeline.name,
        "matcher": repr(job.matcher),
        "filters": [[name, repr(keeper)] for name, keeper in job.filters],
        "locate": repr(job.locate),
        "refine": repr(job.refine),
        "parameters": pipeline.parameters,
        "model": None if model is None else [model[0].parameters, model[1]],
        "seed": job.seed,
        "areas": None if job.areas is None else [list(vars(window).values()) for window in job.areas],
        "n_features": job.n_features,
        "halo": job.halo,
        "prior": [prior.record(), base.parameters if isinstance(base, Transfer | Model) else repr(base)],
        "heights": heights.to_dict(),
        "blocks": [[b.index, b.window.x, b.window.y, b.window.width, b.window.height] for b in blocks],
        "versions": versions(),
    }


def _finished(
    pipeline: Pipeline,
    merged: Merged,
    blocks: Sequence[Block],
    record: tuple[dict[str, int], dict[str, list[Any]], dict[str, Any]],
    prior: Prior,
    reference: Source,
    secondary: Source,
    heights: dict[str, Any],
    *,
    seed: int,
    initial: Model | None,
    search_radius: float | None,
    timings: dict[str, float],
) -> Registration:
    """Global filters, model, refined model and trust over the tie points of all blocks."""
    counts, table, further = record
    # The blocks lie where both images see the ground.
    middle = np.mean([b.window.origin + np.array(b.window.shape[::-1]) / 2 for b in blocks], axis=0)
    asked, grids = pipeline.model, prior.base
    if isinstance(grids, Transfer) and beyond(asked, grids, middle, reference.shape) is not None:
        # In the secondary's own pixels, where tie points of blocks lie, no such model holds what both images state.
        pipeline = replace(pipeline, model=Affine)
    matches, owners, shapes = merged.matches, merged.blocks, (reference.shape, secondary.shape)
    known: Any = {"seed": seed, "initial": initial, "search_radius": search_radius}
    ground = heights_words(heights) if prior.source.startswith("geolocation") else ""
    where = f"lies within {prior.uncertainty_px:.0f} px of where the prior ({prior.source}) says"
    stages = pipeline.filtered(matches, *shapes, before=merged.stages, **known)
    draft = pipeline.fitted(matches, stages, {"prior": ", ".join(part for part in (where, ground) if part)})
    draft = draft.without_model(block_words(table["status"], table["reason"]))
    if pipeline.locate is not None:
        with stage("locate"):
            measured = merged.located if draft.model else Matches.empty()
            draft = located(draft, measured, pipeline.n_features, pipeline.locate.side)
        owners = np.concatenate([owners, merged.located_blocks])[: len(draft.matches)]
    if pipeline.refine is not None:
        with stage("refine"):
            found, mine = None, owners[:0]
            if draft.model:
                found, mine = fit_refined(merged, draft.model, pipeline.refine.max_residual)
            draft = refined(draft, found, 0 if found is None else pipeline.refine.least(found.candidates))
        # Refined tie points that were not worth using were not appended.
        owners = np.concatenate([owners, mine])[: len(draft.matches)]
    final = draft.matches.take(np.flatnonzero(draft.inliers))
    gates = {}
    if draft.model:
        tried = table["status"].count("done")
        with stage("trust"):
            gates = block_gates(
                blocks, tried, owners[draft.inliers], final, draft.model, merged, prior, pipeline.limits
            )
    stated = None
    if prior.stated and draft.model:
        stated = linear_at(prior, middle)
    result = pipeline.judged(
        draft, reference.shape, merged.chance_shape, further=gates, seconds=timings, stated=stated, **known
    )
    if result.status != "ok" and prior.searched_px:
        why = f"pilot blocks found no agreement within {prior.searched_px:.0f} px of where both geolocations say"
        result = replace(result, reason=f"{result.reason}; {why}")
    errors = block_errors(merged, result.model, len(blocks)) if result.model else np.zeros(0)
    return replace(
        result,
        timings=dict(timings),
        provenance={
            **result.provenance,
            "blocks": counts,
            "block_table": with_final(table, owners[result.inliers]),
            "tie_point_blocks": owners,
            "prior": prior.record()
            | ({} if stated is None else {"linear": stated.tolist()})
            | ({} if asked is pipeline.model else {"model": asked.__name__.lower()}),
            "heights": heights,
            "accuracy": accuracy(result.model, final, errors, result.gates, reference.shape),
            **further,
        },
        reference=input_image(reference),
        secondary=input_image(secondary),
    )
