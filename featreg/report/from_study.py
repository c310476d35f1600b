"""From a study to the plain data of its page."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from featreg.io import as_image
from featreg.pipeline.keywords import bands_of
from featreg.report.data import Better, ReportColumn, ReportEntry, ReportPair, ReportStudy, ReportSweep, ReportTable
from featreg.report.page import write_report
from featreg.results.registration import Registration
from featreg.study.experiment_results import Study
from featreg.study.intervals import Interval
from featreg.study.jobs import Job
from featreg.study.metrics import metric_of
from featreg.study.table import Table
from featreg.types import Image

BETTER: Mapping[str, Better] = {"higher": "high", "lower": "low"}


def write_study_report(path: str | Path, study: Study) -> None:
    """Write the page of a study as one HTML file.

    Raises
    ------
    InputError
        The file cannot be written, or an image cannot be read.
    """
    write_report(Path(path), report_of(study))


def report_of(study: Study) -> ReportStudy:
    """Return what the page of a study shows."""
    table = study.table()
    protocol, machine = _notes(table)
    pairs = [
        ReportPair(
            pair.name,
            _reader(study, pair.reference, bands_of(study.protocol.keywords())[0]),
            _reader(study, pair.secondary, bands_of(study.protocol.keywords())[1]),
            pair.truth,
            "" if pair.truth is None else str(pair.truth),
        )
        for pair in study.pairs
    ]
    rows = zip(study.outcomes, table.rows, strict=True)
    return ReportStudy(
        title=study.title or f"{_many(len(study.methods), 'method')} on {_many(len(study.pairs), 'pair')}",
        pairs=pairs,
        entries=[_entry(study, job, row, table) for job, row in rows],
        table=_table(table),
        threshold=study.protocol.threshold,
        protocol=protocol,
        machine=machine,
        sweep=_sweep(table),
    )


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _reader(study: Study, source: Any, band: Any) -> Any:
    """The image or its path, of which a large one need not be read whole; where its samples must be told first, a
    function that reads it as it was read for the matching.
    """
    protocol = study.protocol
    if isinstance(source, Image) or (protocol.nodata, protocol.scale, protocol.calibrate, band) == (None,) * 4:
        return source
    return partial(
        as_image, source, nodata=protocol.nodata, scale=protocol.scale, calibrate=protocol.calibrate, band=band
    )


def _entry(study: Study, job: Job, row: Mapping[str, Any], table: Table) -> ReportEntry:
    outcome = study.outcomes[job]
    scores = {name: row[name] for name in table.metrics}
    made = outcome.result
    failed = not isinstance(made, Registration) or row["status"] == "failed"
    return ReportEntry(
        pair=study.pairs[job.pair].name,
        method=job.method,
        seed=job.seed,
        registration=None if failed or not isinstance(made, Registration) else made,
        failure=str(row["reason"]) if failed else "",
        stage=study.protocol.stage or "",
        scores=scores,
        timings=dict(outcome.act or {}),
    )


def _table(table: Table) -> ReportTable:
    columns = []
    for name in table.columns:
        if name not in table.metrics:
            columns.append(ReportColumn(name, digits=None))
            continue
        metric = metric_of(name)
        digits = 0 if metric.count else 3
        columns.append(ReportColumn(name, BETTER.get(metric.better), description=metric.meaning, digits=digits))
    baseline = table.methods[0] if table.methods else ""
    return ReportTable(
        columns,
        list(table.rows),
        _spreads(table.intervals()),
        _differences(table),
        baseline,
        table.confidence,
        {"table.csv": table.to_csv(), "table.tex": table.to_latex()},
    )


def _differences(table: Table) -> dict[str, dict[str, Any]]:
    if len(table.methods) < 2:
        return {}
    return {m: {n: (i.mean, *_told(i)) for n, i in row.items()} for m, row in table.differences().items()}


def _spreads(found: Mapping[str, Mapping[str, Interval]]) -> dict[str, dict[str, Any]]:
    """The page marks the best mean, so one that leaves out the pairs a method gave up is not among them."""

    def spread(name: str, i: Interval) -> tuple[float | None, float | None, float | None]:
        flattering = i.missing > 0 and metric_of(name).better == "lower"
        return (None, None, None) if flattering else (i.mean, *_told(i))

    return {method: {name: spread(name, i) for name, i in row.items()} for method, row in found.items()}


def _sweep(table: Table) -> ReportSweep | None:
    """The grid of a sweep of one method: the mean over pairs and seeds at every point."""
    if not table.grid:
        return None
    # By their text: 1 and True are equal as keys.
    values = {key: list({repr(row[key]): row[key] for row in table.rows}.values()) for key in table.grid}
    points = list(itertools.product(*([repr(v) for v in listed] for listed in values.values())))
    rows: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in table.rows:
        rows.setdefault(tuple(repr(row[key]) for key in table.grid), []).append(row)
    shape = tuple(len(listed) for listed in values.values())
    metrics = {}
    for name in table.metrics:
        cells = np.full(len(points), np.nan)
        for i, point in enumerate(points):
            there = [float(row[name]) for row in rows.get(point, ()) if row[name] is not None]
            cells[i] = np.mean(there) if there else np.nan
        if np.isfinite(cells).any():
            metrics[name] = cells.reshape(shape)
    better = {name: BETTER[metric_of(name).better] for name in metrics if metric_of(name).better}
    return ReportSweep(values, metrics, better, table.methods[0].split(" ")[0])


def _notes(table: Table) -> tuple[dict[str, Any], dict[str, Any]]:
    """The protocol's lines, by what stands before their colon; machine and versions apart."""
    protocol: dict[str, Any] = {}
    machine: dict[str, Any] = {}
    for line in table.protocol:
        name, sign, text = line.partition(": ")
        if name == "machine":
            machine[name] = text
        elif not sign and line.startswith("featreg "):
            machine["versions"] = line
        elif not sign:
            protocol.setdefault("note", []).append(line)
        else:
            protocol[name] = text
    return protocol, machine


def _told(found: Interval) -> tuple[float | None, float | None]:
    """The bounds of an interval, none where too few pairs stand behind it, as in every printed table."""
    return (found.low, found.high) if found.told else (None, None)
