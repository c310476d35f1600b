"""What is the same for all methods of a comparison, and the lines under its table that say so."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from featreg._version import __version__
from featreg.errors import ParameterError, suggest
from featreg.results.registration import Registration
from featreg.results.stages import MEASURED
from featreg.study.evaluation import default_stage
from featreg.study.jobs import Job, Method, Outcome, Pair
from featreg.study.metrics import STANDARD, metric_of


def _number(value: Any, low: float | None = None, high: float = float("inf")) -> bool:
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return number and (low is None or low < value < high)


_NAME = (lambda value: isinstance(value, str), "a name")
_TEXT = (lambda value: isinstance(value, str | Path), "the name of a file")
_BAND = (lambda value: _number(value, 0) or isinstance(value, str), "a name or a number from 1")
_SWITCH = (lambda value: isinstance(value, bool), "true or false")
#: Field of a protocol -> whether a value is possible, and what is; those that are None by default may be None.
VALUES: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "threshold": (lambda value: _number(value, 0), "a number of pixels > 0"),
    "stage": _NAME,
    "n_features": (lambda value: _number(value, 0) and isinstance(value, int | np.integer), "a whole number >= 1"),
    "filters": (lambda value: all(isinstance(name, str) for name in value), "a list of names"),
    "model": _NAME,
    "locate": _SWITCH,
    "refine": _SWITCH,
    "scale": _NAME,
    "calibrate": _NAME,
    "nodata": (_number, "a number"),
    "band": _BAND,
    "reference_band": _BAND,
    "secondary_band": _BAND,
    "block": (
        lambda value: isinstance(value, bool) or (_number(value, 0) and isinstance(value, int | np.integer)),
        "a whole number of pixels >= 1, true or false",
    ),
    "dem": _TEXT,
    "height": (lambda value: _number(value, -float("inf")), "a number of metres"),
    "split": _NAME,
    "time_limit": (lambda value: _number(value, 0), "a number of seconds > 0"),
    "timing": _SWITCH,
    "warm_up": _SWITCH,
    "confidence": (lambda value: _number(value, 0, 1), "a number between 0 and 1"),
}


@dataclass(frozen=True)
class Protocol:
    """One protocol for every method and pair.

    Parameters
    ----------
    threshold : px, greatest distance of a correct match from the truth
    stage : at which NM is counted; None for each method's own: the located matches where it locates, else those of the
        last filter that looks at neighbourhoods
    n_features : budget: most features per image and most final tie points; None for the package's default
    filters : one chain of filters for all; None leaves each method its own
    model : geometric model; None for each method's own
    locate, refine : measuring the matches again, and refinement, on or off for all; None for each method's own
    scale, calibrate, nodata, band, reference_band, secondary_band : what the samples are, as `featreg.match` takes
        them
    block, dem, height, split : of scenes, as `featreg.match` takes them; a pair's own heights come first
    time_limit : s, of one job in its own process; None for no limit
    timing : measure times in a serial pass
    warm_up : discard the first call of each method when times are measured
    confidence : of the intervals
    """

    threshold: float = 1.5
    stage: str | None = None
    n_features: int | None = None
    filters: tuple[str, ...] | None = None
    model: str | None = None
    locate: bool | None = None
    refine: bool | None = None
    scale: str | None = None
    calibrate: str | None = None
    nodata: float | None = None
    band: str | int | None = None
    reference_band: str | int | None = None
    secondary_band: str | int | None = None
    block: int | bool | None = None
    dem: str | Path | None = None
    height: float | None = None
    split: str | None = None
    time_limit: float | None = None
    timing: bool = True
    warm_up: bool = True
    confidence: float = 0.95

    def __post_init__(self) -> None:
        if self.filters is not None:
            names = (self.filters,) if isinstance(self.filters, str) else tuple(self.filters)
            object.__setattr__(self, "filters", names)
        for f in fields(self):
            value, (possible, words) = getattr(self, f.name), VALUES[f.name]
            if not (possible(value) if value is not None else f.default is None):
                raise ParameterError(f"{f.name} must be {words}, got {value!r}")
        if self.dem is not None and self.height is not None:
            raise ParameterError("heights come from 'dem' or from 'height', not from both")

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> Self:
        """Make a protocol of a mapping.

        Raises
        ------
        ParameterError
            An unknown key (the text suggests the nearest) or an impossible value.
        """
        known = [f.name for f in fields(cls)]
        for key in given:
            if key not in known:
                raise ParameterError(f"protocol: unknown key '{key}', {suggest(str(key), known)}")
        try:
            return cls(**given)
        except ParameterError as error:
            raise ParameterError(f"protocol: {error}") from error

    def keywords(self) -> dict[str, Any]:
        """The part that decides what is matched, as keywords of `featreg.match`."""
        method = ("n_features", "filters", "model", "locate", "refine")
        reading = ("scale", "calibrate", "nodata", "band", "reference_band", "secondary_band")
        given = {name: getattr(self, name) for name in (*method, *reading, "block", "dem", "height", "split")}
        return {name: list(v) if name == "filters" else v for name, v in given.items() if v is not None}

    def to_dict(self) -> dict[str, Any]:
        """What differs from the defaults."""
        found = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in found.items()}


def describe(
    pairs: Sequence[Pair],
    methods: Mapping[str, Method],
    outcomes: Mapping[Job, Outcome],
    seeds: Sequence[int],
    protocol: Protocol,
    metrics: Sequence[str],
) -> list[str]:
    """Return the lines that stand under the table."""
    import cv2

    lines = [
        f"NCM: matches within {protocol.threshold:g} px of the truth; precision NCM / NM; RMSE over NCM; "
        "grid RMSE: model against truth on 9 x 9 points"
    ]
    more = [f"{name}: {metric_of(name).meaning}" for name in metrics if name not in STANDARD]
    lines += ["; ".join(more)] if more else []
    chains: set[tuple[str, ...]] = set()
    budgets: set[str] = set()
    for label in methods:
        results = (outcomes[job].result for job in outcomes if job.method == label)
        made = next((result for result in results if isinstance(result, Registration)), None)
        if made is None:
            lines.append(f"{label}: no result")
            continue
        budget = _budget(made, methods[label])
        filters = ", ".join(made.stages) or "none"
        counted = protocol.stage or default_stage(made)
        swept = methods[label].point
        budget_text = "swept" if "n_features" in swept else budget
        line = f"{methods[label].base}: filters {filters}; NM counted at {counted}; budget n_features {budget_text}"
        lines += [] if line in lines else [line]
        chains |= set() if "filters" in swept else {tuple(name for name in made.stages if name not in MEASURED)}
        budgets |= set() if "n_features" in swept else {budget}
    for what, differ in (("filters", len(chains) > 1), ("budget", len(budgets) > 1)):
        if differ:
            lines.append(f"the methods differ in their {what}: differences between them are not the method's alone")
    truths = dict.fromkeys(str(pair.truth) for pair in pairs if pair.truth is not None)
    lines.append(f"truth: {'; '.join(truths) or 'none'}")
    how = "not measured"
    if protocol.timing:
        how = "sum of the stages, serial, one OpenCV thread"
        how += ", first call of each method discarded" * protocol.warm_up
    lines.append(f"time: {how}; seed{'s' * (len(seeds) > 1)} {', '.join(str(seed) for seed in seeds)}")
    versions = {"featreg": __version__, "OpenCV": cv2.__version__, "numpy": np.__version__}
    lines.append(", ".join(f"{k} {v}" for k, v in (versions | {"Python": platform.python_version()}).items()))
    lines.append(f"machine: {machine()}")
    return lines


def machine() -> str:
    """Processor, cores and system in one line."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8", errors="replace").splitlines()
        name = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), name)
    return f"{name}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def _budget(made: Registration, method: Method) -> str:
    parameters = made.provenance.get("parameters")
    said = parameters if isinstance(parameters, Mapping) else {}
    budget = said.get("n_features", made.provenance.get("n_features"))
    return str(method.keywords.get("n_features", "not stated" if budget is None else budget))
