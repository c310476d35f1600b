"""What a report is made of, as plain data: it knows of no experiment, cache or executor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from featreg.errors import InputError, ParameterError
from featreg.results.registration import Registration
from featreg.types import BoolArray, FloatArray, Image

Better = Literal["high", "low"]
#: Value and interval, the ends None where nothing can be said.
Spread = tuple[float | None, float | None, float | None]


@dataclass(frozen=True, eq=False)
class ReportPair:
    """Two images, what they are called together, and where the points of one lie in the other.

    Parameters
    ----------
    name : unique in the study
    reference, secondary : `Image`, a path or an array as `featreg.io.as_image` takes them, or a function without
        arguments that returns an `Image`; paths and functions are read one pair at a time, so that a study of many
        scenes needs the memory of one
    truth : (N, 2) reference points -> (N, 2) secondary points, NaN where unknown; None where there is none
    truth_text : what the truth is, for the reader
    """

    name: str
    reference: Image | Any
    secondary: Image | Any
    truth: Callable[[FloatArray], FloatArray] | None = None
    truth_text: str = ""


@dataclass(frozen=True, eq=False)
class ReportEntry:
    """What one method gave on one pair with one seed.

    Parameters
    ----------
    pair : name of a `ReportPair`
    method : label
    seed : of the run
    registration : the result; None where the method raised, hung or died
    failure : why there is none, one line; "" otherwise
    correct : (M,) bool, whether each match lies within `ReportStudy.threshold` of the truth; None to have it computed
        from the pair's truth, and where there is no truth
    stage : whose matches were scored; "" for that of `featreg.study.evaluation.default_stage`
    scores : metric -> value, None where there is none; shown beside the pictures in the order given
    timings : stage -> seconds; by default those of the registration
    """

    pair: str
    method: str
    seed: int = 0
    registration: Registration | None = None
    failure: str = ""
    correct: BoolArray | None = None
    stage: str = ""
    scores: Mapping[str, float | None] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.registration is None) == (not self.failure):
            raise InputError(f"{self.method} on '{self.pair}' must have either a registration or a failure")
        if self.registration is not None and self.correct is not None:
            wanted = (len(self.registration.matches),)
            if self.correct.shape != wanted:
                raise InputError(f"correct must have shape {wanted}, got {self.correct.shape}")

    @property
    def status(self) -> str:
        """ "ok", "unreliable" or "failed"."""
        return "failed" if self.registration is None else self.registration.status


@dataclass(frozen=True)
class ReportColumn:
    """One column of the table: its key in the rows, whether more or less is better, unit and meaning.

    `digits` behind the point are shown, None for as many as needed.
    """

    name: str
    better: Better | None = None
    unit: str = ""
    description: str = ""
    digits: int | None = 3
    title: str = ""


@dataclass(frozen=True, eq=False)
class ReportTable:
    """The table as plain data.

    Parameters
    ----------
    columns : in order; "pair", "method", "seed", "status" and "reason" are known to the page
    rows : column -> text, number, bool or None
    intervals : method -> column -> (mean, low, high)
    differences : method -> column -> (mean difference from `baseline`, low, high)
    baseline : label of the method that the differences are from
    confidence : of the intervals
    texts : "table.csv" and "table.tex" -> the table as such a file, for the reader to take along
    """

    columns: Sequence[ReportColumn] = ()
    rows: Sequence[Mapping[str, Any]] = ()
    intervals: Mapping[str, Mapping[str, Spread]] = field(default_factory=dict)
    differences: Mapping[str, Mapping[str, Spread]] = field(default_factory=dict)
    baseline: str = ""
    confidence: float = 0.95
    texts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ReportSweep:
    """The grid of a sweep for the heat maps.

    Parameters
    ----------
    parameters : name -> its values, in order; one or more
    metrics : name -> array of the parameters' lengths, NaN where there is no value
    better : metric -> "high" or "low"
    method : label of the method that was swept
    """

    parameters: Mapping[str, Sequence[Any]]
    metrics: Mapping[str, FloatArray]
    better: Mapping[str, Better] = field(default_factory=dict)
    method: str = ""

    def __post_init__(self) -> None:
        wanted = tuple(len(values) for values in self.parameters.values())
        if not wanted or 0 in wanted:
            raise ParameterError("a sweep needs at least one parameter with at least one value")
        for name, array in self.metrics.items():
            if array.shape != wanted:
                raise InputError(f"sweep: metric '{name}' must have shape {wanted}, got {array.shape}")


@dataclass(frozen=True, eq=False)
class ReportStudy:
    """Everything a report shows.

    Parameters
    ----------
    title : of the page
    pairs : with different names
    entries : what came of each pair, method and seed
    table : the table on top
    threshold : px, greatest distance of a correct match
    protocol : name -> text or list of lines, how the numbers came about; printed underneath
    machine : name -> text: processor, versions
    sweep : for the heat maps, where there was one
    curves : method -> shares of matches within 1, 2, ... px (mean matching accuracy); computed from the entries where
        it is empty and there is a truth

    Raises
    ------
    InputError
        Names that stand twice, or an entry of an unknown pair.
    """

    title: str
    pairs: Sequence[ReportPair]
    entries: Sequence[ReportEntry]
    table: ReportTable = field(default_factory=ReportTable)
    threshold: float = 1.5
    protocol: Mapping[str, Any] = field(default_factory=dict)
    machine: Mapping[str, Any] = field(default_factory=dict)
    sweep: ReportSweep | None = None
    curves: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [pair.name for pair in self.pairs]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"the pairs of a report need different names, '{twice[0]}' stands twice")
        unknown = sorted({entry.pair for entry in self.entries} - set(names))
        if unknown:
            raise InputError(
                f"the report has entries of '{unknown[0]}', which is none of its pairs: {', '.join(names)}"
            )
