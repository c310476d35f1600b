"""The pairs of a stack matched, each kept on disk as soon as it is finished where that is asked for."""

from __future__ import annotations

import inspect
import json
import logging
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.interfaces import FailedFit, Model
from featreg.io import as_image
from featreg.io.raster_source import Source, open_source
from featreg.matching import MOST_PIXELS, match
from featreg.registry import KINDS
from featreg.runtime.cluster import dask_client
from featreg.runtime.digests import digest_value
from featreg.runtime.executors import open_executor
from featreg.runtime.versions import versions
from featreg.runtime.watching import Progress
from featreg.scene.state import ArrayFiles, digest_of
from featreg.stacks.dense import measured_again
from featreg.stacks.expected import days_of_images, expected_coherence, in_order
from featreg.stacks.ground import SharedGround
from featreg.stacks.initial import initial_of
from featreg.stacks.pairs import StackPair, planned, weighed

#: Keywords that say how an image is read.
READING = ("nodata", "scale", "calibrate", "band")
#: Keywords that say what runs the blocks of a pair.
RUNNING = ("block", "executor", "workers", "cancel", "resume")

logger = logging.getLogger(__name__)


def reading_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords of `featreg.as_image` with which the images of a stack are read."""
    return {name: options[name] for name in READING if options.get(name) is not None}


class Work:
    """The images of a stack and the pairs matched so far."""

    def __init__(
        self,
        images: list[Any],
        options: Mapping[str, Any],
        progress: Progress | None,
        how: Mapping[str, Any],
        dates: Sequence[Any] | None = None,
        coherence: Any = None,
    ) -> None:
        self.options, self.progress, self.how = dict(options), progress, dict(how)
        reading = reading_of(options)
        self.sources: list[Source] = [open_source(image, **reading) for image in images]
        self.images = [str(image) if isinstance(image, str | Path) else as_image(image, **reading) for image in images]
        self.names = [str(image) if isinstance(image, str | Path) else f"image {i}" for i, image in enumerate(images)]
        self.shared = SharedGround(self.sources)
        self.found: dict[tuple[int, int], StackPair] = {}
        self.days = days_of_images(self.names, dates)
        self.order = in_order(len(images), self.days)
        self.expected = expected_coherence(len(images), self.days, coherence)
        if self.order != sorted(self.order):
            logger.warning(
                "the days of the images do not ascend: jumps are looked for in the order in which they are given"
            )
        self.done = self.wanted = 0

    def planned(self, reference: int, pairs: Any) -> list[tuple[int, int]]:
        """The pairs to match."""
        return planned(len(self.images), reference, pairs, self.shared, self.expected, self.order)

    def farness(self, i: int, image: int) -> tuple[float, int, int]:
        """What grows with how little is expected of two images."""
        return 0.0 if self.expected is None else -self.expected(i, image), abs(i - image), i

    def options_of(self, pair: tuple[int, int]) -> dict[str, Any]:
        """The keywords with which one pair is matched."""
        options, initial = dict(self.options), initial_of(self.options.get("initial"), *pair)
        if initial is not None:
            return {**options, "initial": initial}
        return {name: value for name, value in options.items() if name not in ("initial", "search_radius")}

    def match(self, wanted: Sequence[tuple[int, int]]) -> None:
        """Match what is not matched yet."""
        todo = [pair for pair in wanted if pair not in self.found]
        files: dict[tuple[int, int], ArrayFiles] = {}
        folder = self.how.get("resume")
        for pair in [] if folder is None else list(todo):
            files[pair] = ArrayFiles(str(folder), self._digest(pair), "pair")
            kept = _loaded(files[pair])
            if kept is not None:
                self.found[pair] = kept.numbered(*pair)
                todo.remove(pair)
        # Batches follow each other, and their number is not known before: what is counted never goes back.
        self.wanted += len(todo)
        for pair, result in self._run(todo):
            self.found[pair] = result
            if folder is not None:
                text = json.dumps(result.to_dict(), allow_nan=False)
                files[pair].save("result", {"pair": np.array(text)})
            self.done += 1
            if self.progress is not None:
                self.progress(self.done, self.wanted)

    def _digest(self, pair: tuple[int, int]) -> str:
        return digest_of(
            {
                "inputs": [self.sources[i].identity() for i in pair],
                "options": _options_digest(self.options_of(pair)),
                "versions": versions(),
            }
        )

    def _run(self, todo: Sequence[tuple[int, int]]) -> Any:
        large = any(
            self.sources[i].shape[0] * self.sources[i].shape[1] > MOST_PIXELS
            for i in {n for pair in todo for n in pair}
        ) or any(self.options.get(name) is not None for name in ("block", "dem", "height"))
        workers, cancel = self.how.get("workers"), self.how.get("cancel")
        with ExitStack() as stack:
            runner = stack.enter_context(dask_client(self.how.get("scheduler"), self.how.get("executor")))
            if large:
                folder = self.how.get("resume")
                for pair in todo:
                    blocks = {"executor": runner, "workers": workers, "cancel": cancel}
                    blocks["resume"] = None if folder is None else Path(folder) / "blocks"
                    yield (
                        pair,
                        match_pair((*pair, self.images[pair[0]], self.images[pair[1]], self.options_of(pair) | blocks)),
                    )
                return
            tasks = stack.enter_context(open_executor(runner, workers))
            items = [(*pair, *(self.images[i] for i in pair), self.options_of(pair)) for pair in todo]
            for position, result in tasks.run(match_pair, (), items, cancel):
                yield todo[position], result


def match_pair(item: tuple[int, int, Any, Any, Mapping[str, Any]]) -> StackPair:
    """Match one pair of a stack: its numbers, its images, and the keywords of `featreg.match`."""
    first, second, reference, secondary, options = item
    result = match(reference, secondary, **options)
    shape = result.reference.shape if result.reference is not None else open_source(reference).shape
    again = None
    if result.status == "ok" and not isinstance(result.model, FailedFit) and options.get("refine") is not False:
        how = {name: options[name] for name in RUNNING if options.get(name) is not None}
        again = measured_again(reference, secondary, result.model, shape, reading_of(options), how)
    return weighed(result, first, second, shape, again)


def _options_digest(options: Mapping[str, Any]) -> str:
    """Digest of what a pair is matched with: parameters of parts by their values, files by their content."""

    def parts(value: Any) -> dict[str, Any] | None:
        if isinstance(value, Model):
            return dict(value.parameters)
        if isinstance(value, tuple(KINDS.values())):
            return {name: getattr(value, name) for name in inspect.signature(type(value)).parameters}
        return None

    try:
        return digest_value(options, parts)
    except TypeError as error:
        raise ParameterError(
            f"finished pairs cannot be kept: what an option holds cannot be told for certain ({error}); leave resume "
            "out, or give names and numbers"
        ) from error


def _loaded(files: ArrayFiles) -> StackPair | None:
    columns = files.load("result")
    if columns is None:
        return None
    try:
        return StackPair.from_dict(json.loads(str(columns["pair"])))
    except (ValueError, KeyError, TypeError, InputError) as error:
        files.refuse("result", error)
        return None
