"""A choice of methods: the first whose result is trusted, and a record of what was tried and why."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from featreg.pipeline.pipeline import Pipeline
from featreg.results.registration import Registration


def first_trusted(
    name: str, pipelines: Iterable[Pipeline], attempt: Callable[[Pipeline], Registration]
) -> Registration:
    """Try methods in order, and stop at the first result that is trusted.

    Parameters
    ----------
    name : of the choice, for the record
    pipelines : the methods
    attempt : registers the images by one of them

    Returns
    -------
    Registration
        That result; where none is trusted, the one of the fewest failed gates (no model counts as if all failed), the
        earliest of equals, with a reason that names all. `provenance["tried"]` holds the ``method``, ``status``,
        ``reason`` and ``seconds`` of each, `provenance["choice"]` the name; the timings are those of all together.
    """
    results: list[Registration] = []
    for pipeline in pipelines:
        results.append(attempt(pipeline))
        if results[-1].status == "ok":
            break
    best = results[-1]
    if best.status != "ok":
        best = min(results, key=_failed)
        best = replace(best, reason=_why_none(best, results))
    tried = [_record(result) for result in results]
    return replace(
        best,
        timings=_together(result.timings for result in results),
        provenance={**best.provenance, "choice": name, "tried": tried},
    )


def _failed(result: Registration) -> float:
    """How many gates a result failed."""
    return sum(not gate.passed for gate in result.gates.values()) if result.model else float("inf")


def _why_none(best: Registration, results: list[Registration]) -> str:
    names = ", ".join(str(result.provenance["method"]) for result in results)
    return f"none of {names} is trusted; {best.provenance['method']}: {best.reason}"


def _record(result: Registration) -> dict[str, Any]:
    return {
        "method": result.provenance["method"],
        "status": result.status,
        "reason": result.reason,
        "seconds": round(sum(result.timings.values()), 3),
    }


def _together(timings: Iterable[Mapping[str, float]]) -> dict[str, float]:
    total: dict[str, float] = {}
    for one in timings:
        for name, seconds in one.items():
            total[name] = total.get(name, 0.0) + seconds
    return total
