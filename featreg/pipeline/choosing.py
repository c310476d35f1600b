"""A choice of methods: the first whose result is trusted, and a record of what was tried and why."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from featreg.pipeline.pipeline import Pipeline
from featreg.presets import PRESETS
from featreg.results.registration import Registration
from featreg.runtime.timing import collecting, stage
from featreg.sar.speckle import equivalent_looks, unlike
from featreg.types import Image


def registered(
    method: Any,
    pipelines: Sequence[Pipeline],
    attempt: Callable[[Pipeline], Registration],
    views: Callable[[], tuple[Image, Image]],
) -> Registration:
    """The result of a method's only pipeline, or of those among which it chooses.

    Parameters
    ----------
    method : its name
    pipelines : `featreg.pipeline.assembly.assemble_all` of it
    attempt : registers the images by one of them
    views : the images, or squares of them at their full resolution
    """
    if len(pipelines) == 1:
        return attempt(pipelines[0])
    with collecting() as timings, stage("probe"):
        ordered, probe = in_order(pipelines, *views())
    result = first_trusted(str(method), ordered, attempt, probe)
    return replace(result, timings={**timings, **result.timings})


def in_order(
    pipelines: Sequence[Pipeline], reference: Image, secondary: Image
) -> tuple[list[Pipeline], dict[str, Any]]:
    """Order methods by what the images are.

    Parameters
    ----------
    pipelines : in the order for images of one kind
    reference, secondary : the images, or squares of them at their full resolution

    Returns
    -------
    pipelines, probe : those made for unlike images first where the images are; the ``looks`` of both, and ``unlike``
    """
    looks = equivalent_looks(reference), equivalent_looks(secondary)
    differ = unlike(reference, secondary)
    ordered = sorted(pipelines, key=lambda one: differ and not PRESETS[one.name].for_unlike)
    return ordered, {"looks": [round(one, 2) for one in looks], "unlike": differ}


def first_trusted(
    name: str,
    pipelines: Iterable[Pipeline],
    attempt: Callable[[Pipeline], Registration],
    probe: Mapping[str, Any] | None = None,
) -> Registration:
    """Try methods in order, and stop at the first result that is trusted.

    Parameters
    ----------
    name : of the choice, for the record
    pipelines : the methods
    attempt : registers the images by one of them
    probe : what decided the order, for the record

    Returns
    -------
    Registration
        That result; where none is trusted, the one of the fewest failed gates (no model counts as if all failed), the
        earliest of equals, with a reason that names all. `provenance["choice"]` holds the ``name``, the ``probe`` and
        what was ``tried``: ``method``, ``status`` and ``reason`` of each. The timings are those of all together.
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
    choice = {"name": name, "probe": dict(probe or {}), "tried": [_record(result) for result in results]}
    return replace(
        best,
        timings=_together(result.timings for result in results),
        provenance={**best.provenance, "choice": choice},
    )


def _failed(result: Registration) -> float:
    """How many gates a result failed."""
    return sum(not gate.passed for gate in result.gates.values()) if result.model else float("inf")


def _why_none(best: Registration, results: Sequence[Registration]) -> str:
    names = ", ".join(str(result.provenance["method"]) for result in results)
    return f"none of {names} is trusted; {best.provenance['method']}: {best.reason}"


def _record(result: Registration) -> dict[str, Any]:
    return {"method": result.provenance["method"], "status": result.status, "reason": result.reason}


def _together(timings: Iterable[Mapping[str, float]]) -> dict[str, float]:
    total: dict[str, float] = {}
    for one in timings:
        for name, seconds in one.items():
            total[name] = total.get(name, 0.0) + seconds
    return total
