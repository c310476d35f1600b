"""A study turned into what the page's code reads: one JSON object and the base64 texts it names."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from featreg.errors import FeatregError
from featreg.geometry import decompose, local_linear
from featreg.interfaces import FailedFit
from featreg.report.data import ReportEntry, ReportPair, ReportStudy, ReportSweep, ReportTable
from featreg.report.pictures import BUDGET, Picture, picture
from featreg.report.tie_points import is_affine, lattice, tie_points
from featreg.results.json_file import plain
from featreg.results.registration import Registration
from featreg.study.evaluation import default_stage, stage_mask
from featreg.study.measures import CURVE, match_errors, matching_accuracy_curve
from featreg.study.truth import Truth
from featreg.types import FloatArray

#: Tie points of one result that are kept at most, and at least; base64 letters of all of them together.
MOST, LEAST, LETTERS = 8000, 200, 9_400_000


def content(study: ReportStudy) -> tuple[dict[str, Any], dict[str, str]]:
    """Return (what the page knows, name -> base64 text of a picture or of tie points).

    Pairs are read one at a time.

    Raises
    ------
    FeatregError
        A truth or a stage does not fit a result. An image that cannot be read is told on the page instead.
    """
    methods = list(dict.fromkeys(entry.method for entry in study.entries))
    blobs: dict[str, str] = {}
    pairs, made = [], {}
    allowance = BUDGET // max(1, 2 * len(study.pairs))
    errors: dict[int, FloatArray | None] = {}
    for number, pair in enumerate(study.pairs):
        images, problem = _pictures(pair, allowance)
        pairs.append(_pair(number, pair, images, problem, blobs))
        size = images[0].size if images else _size(pair, study.entries)
        for k, entry in enumerate(study.entries):
            if entry.pair == pair.name:
                errors[k] = _errors(entry, pair)
                made[k] = _entry(entry, number, methods, size)
    _pack(study, made, errors, blobs)
    whole = {
        "title": study.title,
        "threshold": study.threshold,
        "methods": methods,
        "pairs": pairs,
        "entries": [made[k] for k in range(len(study.entries))],
        "table": _table(study.table),
        "curves": _curves(study, methods, errors),
        "sweep": None if study.sweep is None else _sweep(study.sweep),
        "protocol": _lines(study.protocol),
        "machine": _lines(study.machine),
    }
    return whole, blobs


def _pictures(pair: ReportPair, allowance: int) -> tuple[tuple[Picture, Picture] | None, str]:
    try:
        return (picture(pair.reference, allowance), picture(pair.secondary, allowance)), ""
    except FeatregError as error:
        return None, str(error)


def _pair(
    number: int, pair: ReportPair, images: tuple[Picture, Picture] | None, problem: str, blobs: dict[str, str]
) -> dict[str, Any]:
    found: dict[str, Any] = {
        "name": pair.name,
        "truth": (pair.truth_text or "known") if pair.truth is not None else "",
        "problem": problem,
        "images": None,
        "lattice": None,
    }
    if images is None:
        return found
    found["images"] = []
    for role, made in zip("rs", images, strict=True):
        blobs[f"{role}{number}"] = base64.b64encode(made.webp).decode()
        found["images"].append({"blob": f"{role}{number}", "size": made.size, "extent": made.extent})
    if pair.truth is not None:
        mapping = pair.truth.mapping if isinstance(pair.truth, Truth) else pair.truth
        found["lattice"] = lattice(pair.truth, images[0].size, is_affine(getattr(mapping, "matrix", None)))
    return found


def _size(pair: ReportPair, entries: Sequence[ReportEntry]) -> tuple[int, int] | None:
    """(width, height) of the reference as a result says it."""
    for entry in entries:
        if entry.pair == pair.name and entry.registration is not None:
            image = entry.registration.reference
            if image is not None:
                return image.shape[1], image.shape[0]
    return None


def _errors(entry: ReportEntry, pair: ReportPair) -> FloatArray | None:
    if entry.registration is None or pair.truth is None:
        return None
    truth = pair.truth if isinstance(pair.truth, Truth) else Truth(pair.truth, "known")
    matches = entry.registration.matches
    return match_errors(matches.reference_xy, matches.secondary_xy, truth)


def _entry(entry: ReportEntry, pair: int, methods: list[str], size: tuple[int, int] | None) -> dict[str, Any]:
    made: dict[str, Any] = {
        "pair": pair,
        "method": methods.index(entry.method),
        "seed": entry.seed,
        "status": entry.status,
        "failure": entry.failure,
        "scores": [[name, plain(value)] for name, value in entry.scores.items()],
        "timings": _timings(entry),
        "points": None,
        "lattice": None,
    }
    registration = entry.registration
    if registration is None:
        return made
    model = registration.model
    made |= {
        "reason": registration.reason,
        "stage": entry.stage or default_stage(registration),
        "stages": list(registration.stages),
        "chain": [
            ["candidates", int(registration.putative.sum())],
            *([name, int(mask.sum())] for name, mask in registration.stages.items()),
            ["final", int(registration.inliers.sum())],
        ],
        "gates": [{"name": name, **plain(gate)} for name, gate in registration.gates.items()],
        "model": _model(registration, size),
    }
    if not isinstance(model, FailedFit) and size is not None:
        made["lattice"] = lattice(model, size, is_affine(model.matrix))
    return made


def _pack(
    study: ReportStudy,
    made: Mapping[int, dict[str, Any]],
    errors: Mapping[int, FloatArray | None],
    blobs: dict[str, str],
) -> None:
    """Add the tie points to what was made of each entry: as many of each result as the page has room for."""
    results = [k for k, entry in enumerate(study.entries) if entry.registration is not None]
    limit = MOST
    while True:
        letters = 0
        for k in results:
            entry = study.entries[k]
            points = tie_points(entry, errors[k], study.threshold, limit)
            blobs[f"p{k}"] = points.packed
            letters += len(points.packed)
            made[k]["points"] = {"blob": f"p{k}", **plain(points), "packed": None}
        if letters <= LETTERS or limit <= LEAST:
            return
        limit = max(LEAST, int(0.97 * limit * LETTERS / letters))


def _model(registration: Registration, size: tuple[int, int] | None) -> list[list[str]]:
    """What the model does, as (name, text)."""
    model = registration.model
    if isinstance(model, FailedFit):
        return [["model", f"none: {model.reason}"]]
    lines = [["model", type(model).__name__]]
    if size is not None:
        centre = (np.array(size, np.float64) - 1) / 2
        linear = decompose(local_linear(model, centre))
        dx, dy = (np.asarray(model(centre[None]))[0] - centre).tolist()
        lines += [
            ["rotation", f"{linear.rotation_deg:+.3f}°"],
            ["scale", f"{linear.scale:.5f}"],
            ["anisotropy", f"{linear.anisotropy:.4f}"],
            ["shift at the centre", f"{dx:+.2f}, {dy:+.2f} px"],
        ]
    if registration.inliers.any():
        rms = float(np.sqrt(np.mean(registration.residuals()[registration.inliers] ** 2)))
        lines.append(["RMS residual of final points", f"{rms:.3f} px"])
    return lines


def _timings(entry: ReportEntry) -> list[list[Any]]:
    given = entry.timings or ({} if entry.registration is None else entry.registration.timings)
    return [[name, plain(float(value))] for name, value in given.items() if name != "total"]


def _table(table: ReportTable) -> dict[str, Any]:
    def spreads(given: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        return {name: {column: plain(list(values)) for column, values in row.items()} for name, row in given.items()}

    return {
        "columns": [plain(column) for column in table.columns],
        "rows": [{column.name: _cell(row.get(column.name)) for column in table.columns} for row in table.rows],
        "intervals": spreads(table.intervals),
        "differences": spreads(table.differences),
        "baseline": table.baseline,
        "confidence": table.confidence,
        "texts": dict(table.texts),
    }


def _cell(value: Any) -> Any:
    made = plain(value)
    return made if made is None or isinstance(made, bool | int | float | str) else str(made)


def _curves(study: ReportStudy, methods: list[str], errors: Mapping[int, FloatArray | None]) -> dict[str, Any]:
    """Method -> shares within 1 to 10 px, the mean over its entries; a failed one counts as 0 everywhere."""
    if study.curves:
        return {name: plain(list(shares)) for name, shares in study.curves.items()}
    known = {pair.name for pair in study.pairs if pair.truth is not None}
    found: dict[str, Any] = {}
    for method in methods:
        curves = []
        for k, entry in enumerate(study.entries):
            if entry.method != method or entry.pair not in known:
                continue
            distance, registration = errors[k], entry.registration
            if registration is None or distance is None:
                curves.append(np.zeros(len(CURVE)))
            else:
                rows = stage_mask(registration, entry.stage or default_stage(registration))
                curves.append(matching_accuracy_curve(distance[rows]))
        if curves:
            found[method] = plain(np.mean(curves, axis=0).round(5))
    return found


def _sweep(sweep: ReportSweep) -> dict[str, Any]:
    return {
        "method": sweep.method,
        "parameters": [[name, [_label(value) for value in values]] for name, values in sweep.parameters.items()],
        "metrics": [
            [name, [v if math.isfinite(v) else None for v in np.asarray(array, np.float64).ravel().tolist()]]
            for name, array in sweep.metrics.items()
        ],
        "better": dict(sweep.better),
    }


def _label(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(plain(value))


def _lines(given: Mapping[str, Any]) -> list[list[Any]]:
    """(name, lines) of each item."""
    found = []
    for name, value in given.items():
        many = isinstance(value, Sequence) and not isinstance(value, str)
        found.append([str(name), [str(plain(line)) for line in (value if many else [value])]])
    return found
