"""The results of an experiment, from which every table, interval and page is made without matching again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from featreg.errors import InputError, ParameterError
from featreg.results.registration import Registration
from featreg.runtime.showing import Shown, figure_of
from featreg.study.case import Case
from featreg.study.jobs import Job, Method, Outcome, Pair
from featreg.study.metrics import STANDARD, check_metrics, measured, metric_of, of_failure
from featreg.study.protocol import Protocol, describe
from featreg.study.table import Table


@dataclass(frozen=True, eq=False)
class Study(Shown):
    """What came of every job, and the protocol by which it is scored.

    Parameters
    ----------
    pairs : the image pairs, with their truth
    methods : label -> method
    seeds : of the repetitions
    outcomes : job -> what came of it
    protocol : thresholds, filters, budget
    metrics : shown unless asked otherwise
    title : of the experiment
    """

    pairs: Sequence[Pair]
    methods: Mapping[str, Method]
    seeds: Sequence[int]
    outcomes: Mapping[Job, Outcome]
    protocol: Protocol
    metrics: Sequence[str] = STANDARD
    title: str = ""

    def __repr__(self) -> str:
        title = f"{self.title[:120]!r}, " if self.title else ""
        return f"Study({title}{len(self.pairs)} pairs by {len(self.methods)} methods, {len(self.outcomes)} results)"

    def plot(self, metrics: Sequence[str] | None = None) -> Any:
        """Return a `matplotlib.figure.Figure` of the table; see `featreg.study.table.Table.plot`."""
        return figure_of(self, metrics=metrics)

    def to_dataframe(self) -> Any:
        """Return the rows of the table as a `pandas.DataFrame`."""
        return self.table().to_dataframe()

    def case(self, job: Job, threshold: float | None = None) -> Case | None:
        """What a metric looks at; None where the method failed."""
        made = self.outcomes[job]
        if not isinstance(made.result, Registration):
            return None
        limit = self.protocol.threshold if threshold is None else threshold
        return Case(made.result, self.pairs[job.pair].truth, limit, self.protocol.stage, made.act, made.keypoints)

    def table(self, metrics: Sequence[str] | None = None) -> Table:
        """Score the predictions; nothing is matched again.

        Parameters
        ----------
        metrics : names (see `featreg.study.metrics`), by default those of the experiment

        Raises
        ------
        ParameterError, UnknownNameError
            A metric that is not known, or that needs keypoints which were not kept.
        """
        names = check_metrics(self.metrics if metrics is None else metrics)
        missing = [name for name in names if metric_of(name).needs_keypoints and name not in self.metrics]
        if missing and not any(metric_of(name).needs_keypoints for name in self.metrics):
            raise ParameterError(f"metric '{missing[0]}' needs keypoints: name it when the experiment is run")
        rows = [self._row(job, names) for job in self.outcomes]
        protocol = describe(self.pairs, self.methods, self.outcomes, self.seeds, self.protocol, names)
        return Table(rows, protocol, self.protocol.confidence)

    def _row(self, job: Job, names: Sequence[str]) -> dict[str, Any]:
        pair, method = self.pairs[job.pair], self.methods[job.method]
        head: dict[str, Any] = {"pair": pair.name, "method": job.method}
        head |= {"seed": job.seed} if len(self.seeds) > 1 else {}
        head |= method.point
        result = self.outcomes[job].result
        case = self.case(job)
        if case is None or not isinstance(result, Registration):
            values = of_failure(names, truth=pair.truth is not None)
            return head | {"status": "failed"} | values | {"reason": str(result)}
        try:
            values = measured(names, case)
        except InputError as error:
            values = of_failure(names, truth=pair.truth is not None)
            return head | {"status": "failed"} | values | {"reason": str(error)}
        return head | {"status": result.status} | values | {"reason": result.reason}
