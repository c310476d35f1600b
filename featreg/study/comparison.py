"""Compare methods over image pairs: predict once, score afterwards, one protocol, printed under the table."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from featreg.runtime.threads import worker_count
from featreg.runtime.watching import Canceller, Progress
from featreg.study.engine import Run
from featreg.study.experiment import Experiment
from featreg.study.metrics import STANDARD
from featreg.study.protocol import Protocol
from featreg.study.table import Table


def compare(
    pairs: Sequence[Sequence[Any]],
    methods: Sequence[Any],
    *,
    executor: Executor | None = None,
    seed: int | Sequence[int] = 0,
    threshold: float = 1.5,
    metrics: Sequence[str] = STANDARD,
    warm_up: bool = True,
    timing: bool = True,
    workers: int = 1,
    time_limit: float | None = None,
    isolate: bool | None = None,
    cache: str | Path | None = None,
    progress: Progress | None = None,
    cancel: Canceller | None = None,
    **overrides: Any,
) -> Table:
    """Match every pair with every method, score the results and put them in a table.

    The same as running a `featreg.Experiment` and asking for its table, but that a method which does not exist is a
    failed row.

    Parameters
    ----------
    pairs : (reference, secondary) or (reference, secondary, truth); images as `featreg.match` takes them, the truth as
        `featreg.study.truth.read_truth` does, None where it is not known
    methods : preset names, Pipeline or Matcher objects, ``(label, keywords of match)``, or a dict of such keywords with
        an optional "label"
    executor : any `concurrent.futures.Executor` (a `dask.distributed.Client` too) for the matching. Times are then
        taken in a serial pass of its own.
    seed : for every method; several seeds are repetitions
    threshold : px, greatest distance of a correct match from the truth
    metrics : columns of the table, see `featreg.study.metrics`
    warm_up : match once before the first measured call of each method, so that compiling does not count
    timing : measure times at all; without it `time_s` stays empty and no second pass is needed
    workers : processes of our own that match where no executor is given
    time_limit : s, after which a job in a process of its own is stopped and its row is a failed one
    isolate : run every job in a process of its own, so that a method that hangs or dies costs its own row only; by
        default where `workers` or `time_limit` is given
    cache : folder in which the results are kept as JSON, found again by a digest of the images' bytes, the method, all
        parameters, the seed and the code; a truncated or foreign file is computed afresh
    progress : called with (steps done, steps in all)
    cancel : when set, the work stops between two steps with a `CancelledError`
    overrides : further keywords of `featreg.match`, for every method

    Returns
    -------
    Table
        A method that raises an error gives a row with status "failed" and the reason.

    Raises
    ------
    InputError, ParameterError
        A pair, a truth or a method entry that cannot be understood; nothing has been computed then.
    CancelledError
        `cancel` was set.

    Notes
    -----
    A time is the sum of the pipeline's stages with one OpenCV thread. Maps that an `Image` keeps are released before
    each run, so that no method profits from what another one computed.
    """
    protocol = Protocol(threshold=threshold, time_limit=time_limit, timing=timing, warm_up=warm_up)
    seeds = (seed,) if isinstance(seed, int) else tuple(seed)
    experiment = Experiment(pairs, methods, overrides, {}, seeds, protocol, metrics)
    apart = (worker_count(workers) > 1 or time_limit is not None) if isolate is None else isolate
    how = Run(executor, apart, workers, time_limit, timing, warm_up, progress=progress, cancel=cancel)
    return experiment.run_as(how, cache).table()
