"""The experiment: pairs, methods, parameters and seeds under one protocol; as an object, a file, a command line."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from featreg.errors import FeatregError, InputError, ParameterError
from featreg.runtime.watching import Canceller, Progress
from featreg.study.engine import Run, run_jobs
from featreg.study.experiment_results import Study
from featreg.study.jobs import Job, Method, Pair
from featreg.study.metrics import STANDARD, check_metrics, metric_of
from featreg.study.prediction_cache import PredictionCache
from featreg.study.protocol import Protocol

#: Most points of a grid of parameters.
MOST_POINTS = 1_000_000


@dataclass(frozen=True)
class Experiment:
    """Image pairs x methods x parameters x seeds under one protocol.

    Parameters
    ----------
    pairs : (reference, secondary), (reference, secondary, truth), or a dict with these keys and a "name"; images as
        `featreg.match` takes them, the truth as `featreg.study.truth.read_truth` does, None where it is not known
    methods : names, Pipeline or Matcher objects, (label, keywords of `featreg.match`), or dicts of such keywords with
        "method" and an optional "label"
    parameters : keywords of `featreg.match` for every method, which its own override
    grid : parameter -> values; every method is run with every combination
    seeds : of the repetitions, different whole numbers >= 0
    protocol : `Protocol`, or a dict of its parameters
    metrics : columns of the table, see `featreg.study.metrics`
    title : for the reader

    Raises
    ------
    InputError, ParameterError, UnknownNameError
        Something that cannot be understood; the text says where it stands and what would be right.

    Examples
    --------
    >>> from featreg import Experiment
    >>> experiment = Experiment([("a.tif", "b.tif", "truth.csv")], ["sar-orb", "orb"], protocol={"threshold": 2.0})
    >>> experiment.protocol.threshold
    2.0
    """

    pairs: Sequence[Any]
    methods: Sequence[Any]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    grid: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    seeds: Sequence[int] = (0,)
    protocol: Protocol = field(default_factory=Protocol)
    metrics: Sequence[str] = STANDARD
    title: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        if isinstance(self.protocol, Mapping):
            put(self, "protocol", Protocol.from_dict(self.protocol))
        for name in ("pairs", "methods"):
            given = getattr(self, name)
            put(self, name, (given,) if isinstance(given, str) else tuple(given))
        seeds = self.seeds
        good = isinstance(seeds, Sequence) and not isinstance(seeds, str) and len(seeds) > 0
        if not good or any(isinstance(s, bool) or not isinstance(s, int) or s < 0 for s in seeds):
            raise ParameterError(f"seeds must be a list of whole numbers >= 0, as in [0, 1, 2], got {seeds!r}")
        if len(set(seeds)) < len(seeds):
            raise ParameterError(f"seeds must differ, got {list(seeds)}")
        put(self, "seeds", tuple(seeds))
        for key, values in self.grid.items():
            if isinstance(values, str) or not isinstance(values, Sequence) or not values:
                raise ParameterError(f"grid: '{key}' needs a list of values, got {values!r}")
        put(self, "metrics", check_metrics(self.metrics))
        if not self.metrics:
            raise ParameterError("an experiment needs at least one metric")

    @classmethod
    def from_file(cls, path: str | Path) -> Self:
        """Read a YAML or TOML file; paths in it are taken from its own folder.

        Raises
        ------
        InputError
            The file cannot be read, or holds something that is not known; the text names the place.
        """
        from featreg.study.experiment_file import read_experiment

        return cls(**read_experiment(Path(path)))

    def to_file(self, path: str | Path) -> None:
        """Write a YAML or TOML file, which `from_file` reads back equal.

        Raises
        ------
        InputError
            The file cannot be written, or the experiment holds arrays or objects, which no such file can hold.
        """
        from featreg.study.experiment_file import write_experiment

        write_experiment(self.to_dict(), Path(path))

    def to_dict(self) -> dict[str, Any]:
        """What differs from the defaults, as the file has it."""
        whole = {
            "title": self.title,
            "pairs": list(self.pairs),
            "methods": list(self.methods),
            "parameters": dict(self.parameters),
            "grid": {key: list(values) for key, values in self.grid.items()},
            "seeds": list(self.seeds),
            "protocol": self.protocol.to_dict(),
            "metrics": list(self.metrics),
        }
        usual = {"title": "", "parameters": {}, "grid": {}, "seeds": [0], "protocol": {}, "metrics": list(STANDARD)}
        return {key: value for key, value in whole.items() if key not in usual or value != usual[key]}

    def check(self) -> None:
        """Build every method and read every truth, so that a mistake shows before anything is computed."""
        from featreg.matching import check_keywords

        for label, method in self.labelled().items():
            try:
                check_keywords(method.keywords)
            except FeatregError as error:
                raise type(error)(f"method '{label}': {error}" if label not in str(error) else str(error)) from error
        self.resolved()
        self._check_dems()

    def _check_dems(self) -> None:
        """Raise where an elevation model that all pairs share is no file; a pair's own is looked at with the pair."""
        for label, method in self.labelled().items():
            dem = method.keywords.get("dem")
            if isinstance(dem, str | Path) and not Path(dem).is_file():
                place = "protocol" if dem == self.protocol.dem else f"method '{label}'"
                raise InputError(f"{place}: no elevation model '{dem}'")

    def labelled(self) -> dict[str, Method]:
        """Label -> method, with every keyword it is run with."""
        found: dict[str, Method] = {}
        points = math.prod(len(values) for values in self.grid.values())
        if points > MOST_POINTS:
            raise ParameterError(
                f"the grid has {points} points, at most {MOST_POINTS} can be compared; take fewer values"
            )
        for label, own in _labelled(self.methods).items():
            common = {**self.protocol.keywords(), **self.parameters, **own}
            if "seed" in common or "seed" in self.grid:
                raise ParameterError(f"method '{label}': 'seed' is no parameter of a method; give a list of seeds")
            for values in itertools.product(*self.grid.values()):
                point = dict(zip(self.grid, values, strict=True))
                name = " ".join([label, *(f"{key}={value}" for key, value in point.items())])
                found[name] = Method(name, {**common, **point}, point, label)
        return found

    def resolved(self) -> list[Pair]:
        """The pairs, with names that differ and their truth read."""
        return list(self._resolved)

    @cached_property
    def _resolved(self) -> list[Pair]:
        from featreg.study.image_pairs import resolve

        return resolve(self.pairs)

    def run(
        self,
        *,
        executor: Executor | None = None,
        workers: int = 1,
        isolate: bool = True,
        resume: str | Path | None = None,
        progress: Progress | None = None,
        cancel: Canceller | None = None,
    ) -> Study:
        """Match what is not kept yet, and return the results, ready to be scored.

        Parameters
        ----------
        executor : any `concurrent.futures.Executor`, or a `dask.distributed.Client`, for the matching
        workers : processes that match where no executor is given; with more than one, times are measured in a serial
            pass afterwards
        isolate : every job in a process of its own, so that a method that raises, hangs past the protocol's
            ``time_limit`` or dies costs its own row only; False keeps a serial run in this process
        resume : folder in which results are kept as JSON, and found again by a digest of the images, the method, its
            parameters, the seed and the code; a truncated or foreign file is computed afresh
        progress : called with (steps done, steps in all)
        cancel : when set, the work stops between two steps with a `CancelledError`

        Returns
        -------
        Study
            ``.table()`` scores it.
        """
        self.check()
        how = Run(
            executor=executor,
            workers=workers,
            isolate=isolate,
            time_limit=self.protocol.time_limit,
            timing=self.protocol.timing,
            warm_up=self.protocol.warm_up,
            progress=progress,
            cancel=cancel,
        )
        return self.run_as(how, resume)

    def run_as(self, how: Run, resume: str | Path | None = None) -> Study:
        """Run without the checks before; a method that does not exist is then a failed row."""
        pairs, methods = self.resolved(), self.labelled()
        self._check_dems()
        jobs = [Job(i, label, seed) for i in range(len(pairs)) for label in methods for seed in self.seeds]
        how = dataclasses.replace(how, keypoints=any(metric_of(name).needs_keypoints for name in self.metrics))
        store = PredictionCache(None if resume is None else Path(resume))
        outcomes = run_jobs(pairs, methods, jobs, store, how)
        return Study(pairs, methods, self.seeds, outcomes, self.protocol, self.metrics, self.title)


def _labelled(methods: Sequence[Any]) -> dict[str, dict[str, Any]]:
    """Label -> keywords of `match`."""
    found: dict[str, dict[str, Any]] = {}
    for entry in methods:
        if isinstance(entry, tuple) and len(entry) == 2 and isinstance(entry[1], Mapping):
            label, own = str(entry[0]), {"method": entry[0], **entry[1]}
        elif isinstance(entry, Mapping) and "method" in entry:
            own = {key: value for key, value in entry.items() if key != "label"}
            label = str(entry.get("label") or _label(own["method"]))
        elif isinstance(entry, tuple | list | Mapping):
            raise ParameterError(f"a method must be a name, an object, (label, keywords) or a dict, got {entry!r}")
        else:
            label, own = _label(entry), {"method": entry}
        unique = next(n for n in (label, *(f"{label} #{k}" for k in range(2, len(found) + 3))) if n not in found)
        found[unique] = own
    if not found:
        raise ParameterError("a comparison needs at least one method")
    return found


def _label(method: Any) -> str:
    return method if isinstance(method, str) else str(getattr(method, "name", "") or type(method).__name__)
