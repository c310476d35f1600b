"""Displacement fields of two images of any size: whole, or block by block."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.displacement.cells import CellGrid, Reason
from featreg.displacement.coarse import LEAST_WINDOW, levels_of
from featreg.displacement.field import Offsets
from featreg.displacement.measure import Measured, measure
from featreg.errors import InputError, ParameterError
from featreg.geometry import as_model, model_to_dict
from featreg.interfaces import FailedFit, Model
from featreg.io import ImageLike
from featreg.io.bands import BandLike
from featreg.io.masks import MaskLike
from featreg.io.raster_source import Source, Window, open_source
from featreg.pipeline.inputs import input_image
from featreg.pipeline.keywords import bands_of
from featreg.products.placement import Placed, relation
from featreg.results.registration import Registration
from featreg.runtime.cluster import dask_client
from featreg.runtime.executors import check_executor, open_executor
from featreg.runtime.parameters import checked
from featreg.runtime.threads import worker_count
from featreg.runtime.versions import versions
from featreg.runtime.watching import Canceller, Progress, check_watch
from featreg.scene.run import shareable
from featreg.scene.state import ArrayFiles, digest_of
from featreg.types import FloatArray

#: Images of more pixels are worked on in blocks, of about this side, px.
MOST_PIXELS, BLOCK = 4_000_000, 1024
#: Cells read beyond a block, besides the reach of the windows, so that its rim has neighbours.
NEIGHBOURS = 2

logger = logging.getLogger(__name__)


@checked("offsets")
def offsets(
    reference: ImageLike,
    secondary: ImageLike,
    *,
    step: Annotated[int, Interval(ge=1, le=4096)] = 16,
    window: Annotated[int, Interval(ge=8, le=4096)] = 64,
    search: Annotated[float, Interval(ge=0, le=4096)] = 16.0,
    initial: Any = None,
    reference_mask: MaskLike | None = None,
    secondary_mask: MaskLike | None = None,
    nodata: complex | None = None,
    scale: str | None = None,
    calibrate: str | None = None,
    band: BandLike = None,
    reference_band: BandLike = None,
    secondary_band: BandLike = None,
    block: int | bool | None = None,
    executor: Any = None,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: str | Path | None = None,
    progress: Progress | None = None,
    cancel: Canceller | None = None,
) -> Offsets:
    """Measure how far each cell of a grid over the reference moved in the secondary.

    Parameters
    ----------
    reference, secondary : paths, 2-D arrays (real or complex) or `Image`
    step : side of a cell, px
    window : side of the square about a cell that is correlated, px
    search : largest displacement looked for, px, beyond what `initial` says
    initial : what is known beforehand: a `Registration`, a model, a matrix or the JSON file of a result. None takes the
        images' geolocation where both have a geotransform, else that they lie on one grid
    reference_mask, secondary_mask, nodata, scale, calibrate, band, reference_band, secondary_band : as in
        `featreg.match`
    block : side of the blocks in which to work, px, False for the whole images at once; None works in blocks where an
        image has more than 4 million pixels
    executor, workers, scheduler : what runs the blocks, as in `featreg.match`; never changes the result
    resume : folder in which finished blocks are kept, and looked for
    progress : called with (blocks done, blocks in all)
    cancel : an event; when set, the work stops between blocks with a `CancelledError`

    Returns
    -------
    Offsets
        A cell whose window leaves an image or its valid pixels, or whose peak cannot be trusted, has a reason.

    Raises
    ------
    InputError, ParameterError
        An unreadable image, a model that there is not, a parameter outside its range.
    CancelledError
        `cancel` was set.

    Notes
    -----
    Windows of the band-passed log-amplitude are correlated on halved images first, whose windows show more ground, then
    at full size around what these say; the peak is that of a quadratic through 3 x 3 shifts, as in the refinement of
    `featreg.match`. Windows that overlap share their sums (`featreg.sar.grid_correlation`).
    """
    worker_count(workers)
    check_executor(executor)
    check_watch(progress, cancel)
    bands = bands_of({"band": band, "reference_band": reference_band, "secondary_band": secondary_band})
    here, there = (
        open_source(source, mask=mask, nodata=nodata, scale=scale, calibrate=calibrate, band=asked)
        for source, mask, asked in zip((reference, secondary), (reference_mask, secondary_mask), bands, strict=True)
    )
    base = _known(initial, here, there)
    side = _block_side(block, step, here, there)
    whole = CellGrid(here.shape, step, window)
    blocks = _blocks(whole, side)
    job = _Job(here, there, base, step, window, float(search))
    record: dict[str, Any] = {
        "step": step,
        "window": window,
        "search": float(search),
        "initial": None if base is None else model_to_dict(base),
        "block": side,
        "versions": versions(),
    }
    files = None
    if resume is not None:
        content = {
            **record,
            "inputs": [source.identity() for source in (here, there)],
            "plan": [asdict(b) for b in blocks],
        }
        files = ArrayFiles(resume, digest_of(content), "offsets")
    columns = _empty(whole.cells)
    done = 0
    todo = []
    for cells in blocks:
        kept = None if files is None else files.load(cells.name)
        if kept is None:
            todo.append(cells)
            continue
        _put(columns, cells, kept)
        done += 1
    tell = progress or (lambda count, total: None)
    tell(done, len(blocks))
    with ExitStack() as stack:
        runner = stack.enter_context(dask_client(scheduler, executor))
        tasks = stack.enter_context(open_executor("serial" if len(todo) < 2 else runner, workers))
        if len(todo) > 1 or tasks.own_process:
            first, second = shareable(here, there, tasks, stack)
            job = _Job(first, second, base, step, window, float(search))
        for position, found in tasks.run(measure_block, (job,), todo, cancel):
            if files is not None:
                files.save(todo[position].name, found)
            _put(columns, todo[position], found)
            done += 1
            tell(done, len(blocks))
    dx, dy = np.moveaxis(columns["displacement"], -1, 0)
    return Offsets(
        whole, dx, dy, columns["covariance"], columns["peak"], columns["snr"], columns["reason"],
        input_image(here), input_image(there), record,
    )  # fmt: skip


@dataclass(frozen=True)
class CellBlock:
    """Cells that one task measures: those of rows top to bottom and columns left to right, the last ones excluded."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.top:05d}_{self.left:05d}"


@dataclass(frozen=True, eq=False)
class _Job:
    reference: Source
    secondary: Source
    base: Model | None
    step: int
    window: int
    search: float


def measure_block(job: _Job, cells: CellBlock) -> dict[str, NDArray[Any]]:
    """Measure the cells of a block, reading as much around it as they need."""
    step = job.step
    whole = CellGrid(job.reference.shape, step, job.window)
    coarsest = max(job.window, LEAST_WINDOW << levels_of(job.search))
    halo = -(-int(coarsest / 2 + job.search + 1) // step) + NEIGHBOURS
    top, left = max(cells.top - halo, 0), max(cells.left - halo, 0)
    bottom, right = (
        n if last + halo >= count else (last + halo) * step
        for last, count, n in zip((cells.bottom, cells.right), whole.cells, job.reference.shape, strict=True)
    )
    seen = Window(left * step, top * step, right - left * step, bottom - top * step)
    reference = job.reference.read(seen)
    grid = CellGrid(reference.shape, step, job.window)
    rows, cols = slice(cells.top - top, cells.bottom - top), slice(cells.left - left, cells.right - left)
    part = _secondary_window(job, seen)
    if part is None:
        return {name: values[rows, cols] for name, values in _empty(grid.cells).items()}
    secondary = job.secondary.read(part)
    origin, far = np.array([seen.x, seen.y], np.float64), np.array([part.x, part.y], np.float64)
    base = None if job.base is None else _Local(job.base, origin, far)
    height, width = job.secondary.shape
    extent = (-float(part.x), -float(part.y), width - 1.0 - part.x, height - 1.0 - part.y)
    found: Measured = measure(reference, secondary, grid, job.search, base, extent)
    moved = found.displacement if base is None else found.displacement + far - origin
    values = {
        "displacement": moved,
        "covariance": found.covariance,
        "peak": found.peak,
        "snr": found.snr,
        "reason": found.reason,
    }
    return {name: np.ascontiguousarray(np.asarray(array)[rows, cols]) for name, array in values.items()}


@dataclass(frozen=True, eq=False)
class _Local:
    """A model between windows of the two images, from and to their own first pixels."""

    model: Model
    origin: FloatArray
    far: FloatArray

    def __call__(self, xy: FloatArray) -> FloatArray:
        return np.asarray(self.model(xy + self.origin) - self.far)


def _secondary_window(job: _Job, seen: Window) -> Window | None:
    """The pixels of the secondary that a window of the reference may show; None for none."""
    if job.base is None:
        return seen.within(job.secondary.shape)
    x = np.linspace(seen.x, seen.x + seen.width - 1, 9)
    y = np.linspace(seen.y, seen.y + seen.height - 1, 9)
    mapped = job.base(np.stack(np.meshgrid(x, y), -1).reshape(-1, 2))
    if not np.isfinite(mapped).all():
        raise InputError("the initial model does not reach all of the reference; give one that does")
    margin = job.search + 8
    left, top = (int(n) for n in np.floor(mapped.min(axis=0) - margin))
    right, bottom = (int(n) for n in np.ceil(mapped.max(axis=0) + margin))
    return Window(left, top, right - left + 1, bottom - top + 1).within(job.secondary.shape)


def _known(initial: Any, reference: Source, secondary: Source) -> Model | None:
    """The model known beforehand; None where the images lie on one grid."""
    if isinstance(initial, str | Path):
        initial = Registration.from_json(initial, tie_points=False)
    if isinstance(initial, Registration):
        if isinstance(initial.model, FailedFit):
            raise InputError(f"initial has no model ({initial.model.reason})")
        if initial.status != "ok":
            logger.warning("initial is %s (%s); its best model is used", initial.status, initial.reason)
        initial = initial.model
    if isinstance(initial, Mapping):
        raise ParameterError("initial must be a model, a matrix, a Registration or its file, got a mapping")
    if initial is None:
        placed = [Placed(source.name, source.shape, source.geolocation) for source in (reference, secondary)]
        if not all(p.geolocation and p.geolocation.transform and not p.geolocation.rpcs for p in placed):
            return None
        initial = relation(*placed)
        if initial is None:
            return None
    model = as_model(initial)
    same = model.matrix is not None and np.array_equal(model.matrix, np.eye(3))
    return None if same else model


def _block_side(block: Any, step: int, *sources: Source) -> int:
    """Side of the blocks, a multiple of `step`; 0 for the whole images at once."""
    if block is None:
        block = max(s.shape[0] * s.shape[1] for s in sources) > MOST_PIXELS
    if isinstance(block, bool | np.bool_):
        block = BLOCK if block else 0
    elif not isinstance(block, int | np.integer) or block < 1:
        raise ParameterError(f"block must be a whole number of pixels >= 1 or False, got {block!r}")
    return -(-int(block) // step) * step


def _blocks(grid: CellGrid, side: int) -> list[CellBlock]:
    rows, cols = grid.cells
    across = side // grid.step or max(rows, cols)
    return [
        CellBlock(top, min(top + across, rows), left, min(left + across, cols))
        for top in range(0, rows, across)
        for left in range(0, cols, across)
    ]


def _empty(shape: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Columns of cells of which nothing is known."""
    return {
        "displacement": np.full((*shape, 2), np.nan),
        "covariance": np.full((*shape, 2, 2), np.nan),
        "peak": np.full(shape, np.nan),
        "snr": np.full(shape, np.nan),
        "reason": np.full(shape, Reason.OUTSIDE, np.uint8),
    }


def _put(columns: dict[str, NDArray[Any]], cells: CellBlock, found: Mapping[str, NDArray[Any]]) -> None:
    for name, values in columns.items():
        values[cells.top : cells.bottom, cells.left : cells.right] = found[name]
