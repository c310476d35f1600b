"""Compare methods over image pairs: predict once, score afterwards, one protocol, printed under the table."""

from __future__ import annotations

import dataclasses
import platform
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from featreg._version import __version__
from featreg.errors import CancelledError, InputError, ParameterError
from featreg.evaluation import computing_time, default_stage, evaluate, stage_mask
from featreg.interfaces import FailedFit
from featreg.opencv import single_threaded
from featreg.prediction_cache import PredictionCache
from featreg.result_file import plain
from featreg.table import COLUMNS, Table
from featreg.truth import Truth, read_truth
from featreg.types import Image, Registration


def compare(
    pairs: Sequence[Sequence[Any]],
    methods: Sequence[Any],
    *,
    executor: Executor | None = None,
    seed: int = 0,
    threshold: float = 1.5,
    warm_up: bool = True,
    timing: bool = True,
    cache: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    cancel: threading.Event | None = None,
    **overrides: Any,
) -> Table:
    """Match every pair with every method, score the results and put them in a table.

    Parameters
    ----------
    pairs : (reference, secondary) or (reference, secondary, truth); images as `featreg.match` takes them, the truth as
        `featreg.truth.read_truth` does, None where it is not known
    methods : preset names, Pipeline or Matcher objects, ``(label, keywords of match)``, or a dict of such keywords with
        an optional "label"
    executor : any `concurrent.futures.Executor` (a `dask.distributed.Client` too) for the matching. Times are then
        taken in a serial pass of its own on the calling process.
    seed : for every method
    threshold : px, greatest distance of a correct match from the truth
    warm_up : match once before the first measured call of each method, so that compiling does not count
    timing : measure times at all; without it `time_s` stays empty and no second pass is needed
    cache : folder in which the results are kept as JSON, found again by a digest of the images' bytes, the method, all
        parameters, the seed and the version of this package; a truncated or foreign file is computed afresh
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
    named = _pairs(pairs)
    entries = _methods(methods, {"seed": seed, **overrides})
    jobs = [(i, label) for i in range(len(named)) for label in entries]
    store = PredictionCache(None if cache is None else Path(cache))
    images = [(pair.reference, pair.secondary) for pair in named]
    keys = {(i, label): store.key(named[i].name, images[i], entries[label]) for i, label in jobs}
    results: dict[tuple[int, str], Registration | str] = {}
    seconds: dict[tuple[int, str], float] = {}
    for job in jobs:
        kept, time_s = store.read(keys[job])
        if kept is not None:
            results[job] = kept
        if kept is not None and time_s is not None and timing:
            seconds[job] = time_s

    def ready(job: tuple[int, str]) -> bool:
        return job in results and (not timing or job in seconds or isinstance(results[job], str))

    missing = [job for job in jobs if job not in results] if executor is not None else []
    total = len(missing) + len(jobs)
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)
        if cancel is not None and cancel.is_set():
            raise CancelledError(f"comparison cancelled after {done} of {total} steps")

    with single_threaded():
        if executor is not None:
            futures = {
                (i, label): executor.submit(_predict, named[i].reference, named[i].secondary, entries[label])
                for i, label in missing
            }
            try:
                for job, future in futures.items():
                    results[job] = _outcome(future.result)
                    store.write(keys[job], results[job], None)
                    step()
            finally:
                for future in futures.values():
                    future.cancel()
        for label, keywords in entries.items():
            warm = not (warm_up and timing)
            for i, pair in enumerate(named):
                job = (i, label)
                if not ready(job):
                    if not warm:
                        _predict(pair.reference, pair.secondary, keywords)
                        warm = True
                    made = _predict(pair.reference, pair.secondary, keywords)
                    results.setdefault(job, made)
                    if timing and not isinstance(made, str):
                        seconds[job] = computing_time(made)
                    store.write(keys[job], results[job], seconds.get(job))
                step()
    rows = [_row(named[i], label, results[i, label], seconds.get((i, label)), threshold) for i, label in jobs]
    how = "not measured"
    if timing:
        how = "sum of the stages, serial, one OpenCV thread" + (", first call of each method discarded" * warm_up)
    return Table(rows, _protocol(named, entries, results, threshold, seed, how))


@dataclass(frozen=True)
class _Pair:
    name: str
    reference: Any
    secondary: Any
    truth: Truth | None


def _pairs(pairs: Sequence[Sequence[Any]]) -> list[_Pair]:
    found = []
    for i, pair in enumerate(pairs, start=1):
        if isinstance(pair, str) or not 2 <= len(pair) <= 3:
            raise InputError(f"pair {i} must be (reference, secondary) or (reference, secondary, truth)")
        images = [Path(image) if isinstance(image, str) else image for image in pair[:2]]
        paths = [Path(p) for p in (getattr(image, "name", image) for image in images) if isinstance(p, str | Path)]
        name = " / ".join(p.stem for p in paths) if len(paths) == 2 and paths[0] != paths[1] else f"pair {i}"
        truth = None if len(pair) == 2 or pair[2] is None else read_truth(pair[2])
        found.append(_Pair(name, images[0], images[1], truth))
    if not found:
        raise InputError("a comparison needs at least one pair (reference, secondary)")
    if len({pair.name for pair in found}) < len(found):
        return [dataclasses.replace(pair, name=f"{i}: {pair.name}") for i, pair in enumerate(found, start=1)]
    return found


def _methods(methods: Sequence[Any], common: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Label -> keywords of `match`."""
    found: dict[str, dict[str, Any]] = {}
    for entry in [methods] if isinstance(methods, str) else methods:
        if isinstance(entry, tuple) and len(entry) == 2 and isinstance(entry[1], Mapping):
            label, own = str(entry[0]), {"method": entry[0], **entry[1]}
        elif isinstance(entry, Mapping) and "method" in entry:
            own = {key: value for key, value in entry.items() if key != "label"}
            label = str(entry.get("label") or _label(own["method"]))
        elif isinstance(entry, tuple | Mapping):
            raise ParameterError(f"a method must be a name, an object, (label, keywords) or a dict, got {entry!r}")
        else:
            label, own = _label(entry), {"method": entry}
        unique = next(n for n in (label, *(f"{label} #{k}" for k in range(2, len(found) + 3))) if n not in found)
        found[unique] = {**common, **own}
    if not found:
        raise ParameterError("a comparison needs at least one method")
    return found


def _label(method: Any) -> str:
    return method if isinstance(method, str) else str(getattr(method, "name", "") or type(method).__name__)


def _predict(reference: Any, secondary: Any, keywords: Mapping[str, Any]) -> Registration | str:
    """One registration, or one line that says why there is none."""

    def run() -> Registration:
        from featreg.matching import match

        for image in (reference, secondary):
            if isinstance(image, Image):
                image.release()
        with single_threaded():
            made: Registration = match(reference, secondary, **keywords)
            return made

    return _outcome(run)


def _outcome(call: Callable[[], Registration | str]) -> Registration | str:
    """What `call` returns, or the first line of what it raises: one broken method must not end the comparison."""
    try:
        return call()
    except CancelledError:
        raise
    except Exception as error:
        line = (str(error).splitlines() or [""])[0]
        return f"{type(error).__name__}: {line}" if line else type(error).__name__


def _row(pair: _Pair, label: str, result: Registration | str, time_s: float | None, threshold: float) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys(COLUMNS) | {"pair": pair.name, "method": label, "reason": ""}
    if isinstance(result, str):
        nothing = {"nm": 0, "inliers": 0} | ({"ncm": 0, "precision": 0.0} if pair.truth is not None else {})
        return row | nothing | {"status": "failed", "reason": result}
    row |= {"status": result.status, "reason": result.reason, "inliers": int(result.inliers.sum()), "time_s": time_s}
    if not isinstance(result.model, FailedFit):
        row["rotation_deg"] = plain(result.model).get("rotation_deg")
    if pair.truth is None:
        return row | {"nm": int(stage_mask(result).sum())}
    try:
        scores = evaluate(result, pair.truth, threshold).as_dict()
    except InputError as error:
        return row | {"nm": 0, "ncm": 0, "precision": 0.0, "status": "failed", "reason": str(error)}
    return row | {name: plain(scores[name]) for name in ("nm", "ncm", "precision", "rmse", "grid_rmse")}


def _protocol(
    pairs: Sequence[_Pair],
    entries: Mapping[str, Mapping[str, Any]],
    results: Mapping[tuple[int, str], Registration | str],
    threshold: float,
    seed: int,
    how: str,
) -> list[str]:
    import cv2

    lines = [
        f"NCM: matches within {threshold:g} px of the truth; precision NCM / NM; RMSE over NCM; "
        "grid RMSE: model against truth on 9 x 9 points"
    ]
    for label in entries:
        made = next((r for i in range(len(pairs)) if isinstance(r := results[i, label], Registration)), None)
        if made is None:
            lines.append(f"{label}: no result")
            continue
        parameters = made.provenance.get("parameters")
        budget = (parameters if isinstance(parameters, Mapping) else {}).get(
            "n_features", made.provenance.get("n_features")
        )
        filters = ", ".join(made.stages) or "none"
        text = f"{label}: filters {filters}; NM counted at {default_stage(made)}; budget n_features "
        lines.append(text + str(entries[label].get("n_features", "not stated" if budget is None else budget)))
    truths = dict.fromkeys(str(pair.truth) for pair in pairs if pair.truth is not None)
    lines.append(f"truth: {'; '.join(truths) or 'none'}")
    lines.append(f"time: {how}; seed {seed}")
    versions = {"featreg": __version__, "OpenCV": cv2.__version__, "numpy": np.__version__}
    lines.append(", ".join(f"{k} {v}" for k, v in (versions | {"Python": platform.python_version()}).items()))
    return lines
