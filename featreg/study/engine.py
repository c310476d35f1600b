"""Run the jobs of a comparison: predict once, in any executor; measure times in a serial pass of its own."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from featreg.errors import CancelledError
from featreg.results.registration import Registration
from featreg.runtime.executors import InProcessExecutor
from featreg.runtime.isolation import IsolatedExecutor
from featreg.runtime.threads import single_threaded, worker_count
from featreg.runtime.watching import Canceller, Progress
from featreg.study.jobs import (
    ROLES,
    Job,
    Method,
    Outcome,
    Pair,
    detection,
    find_keypoints,
    load_methods,
    outcome,
    predict,
    times_of,
)
from featreg.study.prediction_cache import PredictionCache
from featreg.types import FloatArray


@dataclass(frozen=True)
class Run:
    """How jobs are run.

    Parameters
    ----------
    executor : any executor (a `dask.distributed.Client` too) for the matching, or None
    isolate : run every job in a process of its own that may hang or die; without it a serial run stays in this process
    workers : isolated processes that match where `executor` is None
    time_limit : s, of one job in an isolated process
    timing : measure times, in a serial pass where the matching is not serial itself
    warm_up : match once before the first measured call of each method, so that compiling does not count
    keypoints : keep the keypoints too
    progress : called with (steps done, steps in all)
    cancel : when set, the work stops between two steps with a `CancelledError`
    """

    executor: Executor | None = None
    isolate: bool = True
    workers: int = 1
    time_limit: float | None = None
    timing: bool = True
    warm_up: bool = True
    keypoints: bool = False
    progress: Progress | None = None
    cancel: Canceller | None = None

    def __post_init__(self) -> None:
        worker_count(self.workers)


def run_jobs(
    pairs: Sequence[Pair], methods: Mapping[str, Method], jobs: Sequence[Job], store: PredictionCache, run: Run
) -> dict[Job, Outcome]:
    """Return what came of every job; what `store` holds is taken from there.

    Raises
    ------
    CancelledError
        `run.cancel` was set. What was finished until then is in the store.
    """
    return _Engine(pairs, methods, jobs, store, run).outcomes()


class _Engine:
    def __init__(
        self,
        pairs: Sequence[Pair],
        methods: Mapping[str, Method],
        jobs: Sequence[Job],
        store: PredictionCache,
        run: Run,
    ) -> None:
        self.pairs, self.methods, self.jobs, self.store, self.how = pairs, methods, jobs, store, run
        self.results: dict[Job, Registration | str] = {}
        self.act: dict[Job, dict[str, float]] = {}
        self.keys: dict[Job, str | None] = {}
        self.done, self.total = 0, 0
        for job in jobs:
            pair, method = pairs[job.pair], methods[job.method]
            key = store.key(pair.name, (pair.reference, pair.secondary), pair.keywords(method.with_seed(job.seed)))
            kept, act = store.read(key)
            self.keys[job] = key
            if kept is not None:
                self.results[job] = kept
            if kept is not None and act is not None:
                self.act[job] = act

    def outcomes(self) -> dict[Job, Outcome]:
        how = self.how
        apart = how.executor is not None or how.workers > 1
        missing = [job for job in self.jobs if job not in self.results] if apart else []
        points = self._keypoint_calls() if how.keypoints else {}
        # A parallel run that measures nothing has no serial pass.
        serial = self.jobs if how.timing or not apart else []
        self.total = len(missing) + len(self.jobs) + len(points)
        with single_threaded():
            found: dict[str, FloatArray | None] = {}
            if missing or points:
                with self._pool() as pool:
                    self._predict_all(pool, missing)
                    found = self._detect_all(pool, points)
            if any(not self._ready(job) for job in serial):
                with self._serial() as executor:
                    self._measure_all(executor, serial)
            else:
                for _ in self.jobs:
                    self._step()
        return {
            job: Outcome(
                self.results[job],
                self.act.get(job) if how.timing else None,
                self._keypoints_of(job, found) if how.keypoints else None,
            )
            for job in self.jobs
        }

    def _ready(self, job: Job) -> bool:
        made = self.results.get(job)
        return made is not None and (not self.how.timing or job in self.act or isinstance(made, str))

    def _step(self) -> None:
        self.done += 1
        if self.how.progress is not None:
            self.how.progress(self.done, self.total)
        if self.how.cancel is not None and self.how.cancel.is_set():
            raise CancelledError(f"comparison cancelled after {self.done} of {self.total} steps")

    @contextmanager
    def _pool(self) -> Iterator[Executor]:
        if self.how.executor is not None:
            yield self.how.executor
        elif self.how.isolate:
            with _isolated(self.how.workers, self.how.time_limit) as executor:
                yield executor
        else:
            yield InProcessExecutor()

    @contextmanager
    def _serial(self) -> Iterator[Executor]:
        if self.how.isolate:
            with _isolated(1, self.how.time_limit) as executor:
                yield executor
        else:
            yield InProcessExecutor()

    def _predict_all(self, pool: Executor, missing: Sequence[Job]) -> None:
        """Predict in whatever order the executor finishes; each result is kept as soon as it is there."""
        finished: queue.SimpleQueue[Job] = queue.SimpleQueue()
        futures: dict[Job, Future[Registration | str]] = {}
        try:
            for job in missing:
                futures[job] = self._submit(pool, job)
            for job, future in futures.items():
                future.add_done_callback(lambda _, job=job: finished.put(job))  # type: ignore[misc]  # a default in a lambda
            for _ in missing:
                job = finished.get()
                self.results[job] = outcome(futures[job].result)
                self.store.write(self.keys[job], self.results[job], None)
                self._step()
        finally:
            for future in futures.values():
                future.cancel()

    def _measure_all(self, executor: Executor, jobs: Sequence[Job]) -> None:
        """Run serially, method by method, what is not there or was not measured."""
        warm: tuple[str, int] | None = None
        for label in self.methods:
            for job in (job for job in jobs if job.method == label):
                if not self._ready(job):
                    made: Registration | str | None = None
                    # A process that had to be replaced is cold again.
                    if self.how.timing and self.how.warm_up and warm != (label, getattr(executor, "starts", 0)):
                        made = outcome(self._submit(executor, job).result)
                        warm = (label, getattr(executor, "starts", 0))
                    if not isinstance(made, str):
                        made = outcome(self._submit(executor, job).result)
                    self.results.setdefault(job, made)
                    if self.how.timing and not isinstance(made, str):
                        self.act[job] = times_of(made)
                    self.store.write(self.keys[job], self.results[job], self.act.get(job))
                self._step()

    def _submit(self, executor: Executor, job: Job) -> Future[Registration | str]:
        pair = self.pairs[job.pair]
        keywords = pair.keywords(self.methods[job.method].with_seed(job.seed))
        return executor.submit(predict, pair.reference, pair.secondary, keywords)

    def _keypoint_calls(self) -> dict[str, tuple[Any, dict[str, Any], str | None]]:
        """Name -> (image, keywords, key in the store) of every detection that is needed, each once."""
        calls: dict[str, tuple[Any, dict[str, Any], str | None]] = {}
        for job in self.jobs:
            for role in ROLES:
                name, keywords = self._detection(job, role)
                if name not in calls:
                    image = getattr(self.pairs[job.pair], role)
                    method = {name: value for name, value in keywords.items() if name != "mask"}
                    also = ["keypoints", keywords.get("mask")]
                    key = self.store.key(self._image_name(job, role), (image,), method, also)
                    calls[name] = (image, keywords, key)
        return calls

    def _detection(self, job: Job, role: str) -> tuple[str, dict[str, Any]]:
        """Name and keywords of a detection; a method has the same keypoints in an image whatever the pair."""
        keywords = detection(self.methods[job.method].keywords, role)
        own = f" as {role}" if "mask" in keywords else ""
        own += f" band {keywords['band']}" if "band" in keywords else ""
        return f"{job.method}: {self._image_name(job, role)}{own}", keywords

    def _image_name(self, job: Job, role: str) -> str:
        pair = self.pairs[job.pair]
        image = getattr(pair, role)
        return f"image {image}" if isinstance(image, str | Path) else f"{role} of {pair.name}"

    def _detect_all(
        self, pool: Executor, calls: Mapping[str, tuple[Any, dict[str, Any], str | None]]
    ) -> dict[str, FloatArray | None]:
        found: dict[str, FloatArray | None] = {}
        futures = {}
        for name, (image, keywords, key) in calls.items():
            found[name] = self.store.read_points(key)
            if found[name] is None:
                futures[name] = pool.submit(find_keypoints, image, keywords)
        try:
            for name, (_, _, key) in calls.items():
                if name in futures:
                    try:
                        found[name] = futures[name].result()
                    except CancelledError:
                        raise
                    except Exception:
                        # The method failed on this image; its row says why.
                        found[name] = None
                    kept = found[name]
                    if kept is not None:
                        self.store.write_points(key, kept)
                self._step()
        finally:
            for future in futures.values():
                future.cancel()
        return found

    def _keypoints_of(self, job: Job, found: Mapping[str, FloatArray | None]) -> tuple[FloatArray, FloatArray] | None:
        reference, secondary = (found.get(self._detection(job, role)[0]) for role in ROLES)
        return None if reference is None or secondary is None else (reference, secondary)


@contextmanager
def _isolated(workers: int, time_limit: float | None) -> Iterator[IsolatedExecutor]:
    executor = IsolatedExecutor(workers, time_limit, load_methods)
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)
