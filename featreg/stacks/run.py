"""Many images to one stack: the pairs matched, the network adjusted, loops closed, jumps found."""

from __future__ import annotations

import inspect
import json
import logging
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine
from featreg.interfaces import FailedFit, Model
from featreg.io import as_image
from featreg.io.raster_source import Source, open_source
from featreg.matching import MOST_PIXELS, match
from featreg.registry import KINDS, model_class
from featreg.runtime.cluster import dask_client
from featreg.runtime.digests import digest_value
from featreg.runtime.executors import check_executor, open_executor
from featreg.runtime.threads import worker_count
from featreg.runtime.versions import versions
from featreg.runtime.watching import Progress, check_watch
from featreg.scene.state import ArrayFiles, digest_of
from featreg.stacks.closure import closure_of, loops
from featreg.stacks.dense import measured_again
from featreg.stacks.expected import days_of_images, expected_coherence, in_order
from featreg.stacks.ground import SharedGround
from featreg.stacks.initial import initial_of, initials, with_one_more
from featreg.stacks.jumps import jumps
from featreg.stacks.network import adjust
from featreg.stacks.pairs import StackPair, planned, weighed
from featreg.stacks.stack_file import Unkept

if TYPE_CHECKING:
    from featreg.stacks.stack import Stack

#: Further neighbours that are tried for an image that no pair leads to.
SECOND_CHANCES = 3
#: Keywords that say how an image is read.
READING = ("nodata", "scale", "calibrate", "band")
#: Keywords that say what runs the blocks of a pair.
RUNNING = ("block", "executor", "workers", "cancel", "resume")

logger = logging.getLogger(__name__)


def registered(
    kind: type[Stack],
    given: list[Any],
    reference: int | str,
    pairs: Any,
    options: Mapping[str, Any],
    progress: Progress | None,
    how: Mapping[str, Any],
    dates: Sequence[Any] | None = None,
    coherence: Any = None,
) -> Stack:
    """Return what `featreg.register_stack` does, of arguments that were checked; `kind` is the class of it."""
    count = len(given)
    work = _Work(
        given, {**options, "initial": initials(options.get("initial"), count)}, progress, how, dates, coherence
    )
    if reference == "auto":
        work.match(work.planned(0, 2 if pairs is None else pairs))
        chosen = _best(work.found.values(), count)
    else:
        chosen = int(reference)
    work.match(work.planned(chosen, pairs))
    _second_chances(work, chosen, count)
    return _assembled(kind, work, chosen, pairs)


def added(stack: Stack, image: Any, **how: Any) -> Stack:
    """Return `Stack.add`."""
    known = {"executor", "workers", "scheduler", "resume", "cancel", "progress", "initial", "date", "coherence"}
    unknown = set(how) - known
    if unknown:
        raise ParameterError(
            "add knows how the work is run, date and initial of the image, and coherence, not "
            f"{', '.join(sorted(unknown))}"
        )
    options, pairs = dict(stack.provenance["options"]), stack.provenance["pairs"]
    lost = sorted(name for name, value in options.items() if isinstance(value, Unkept))
    if lost:
        raise InputError(
            f"the file of this stack keeps no more than the name of {', '.join(lost)}, an object of the program that "
            "made it; add to the stack in that program, or register it anew"
        )
    if len(stack.images) != len(stack.models):
        raise InputError("the images of this stack are not at hand; register it anew")
    progress = how.pop("progress", None)
    worker_count(how.get("workers"))
    check_executor(how.get("executor"))
    check_watch(progress, how.get("cancel"))
    dates = _dates_with(stack, image, how.pop("date", None))
    options["initial"] = with_one_more(options.get("initial"), how.pop("initial", None), len(stack.images) + 1)
    coherence = how.pop("coherence", None)
    work = _Work([*stack.images, image], options, progress, how, dates, coherence)
    work.found = {(pair.first, pair.second): pair for pair in stack.pairs}
    wanted = work.planned(stack.reference, pairs)
    work.match([pair for pair in wanted if len(stack.images) in pair])
    _second_chances(work, stack.reference, len(work.images), only=len(stack.images))
    return _assembled(type(stack), work, stack.reference, pairs)


def _dates_with(stack: Stack, image: Any, date: Any) -> list[Any] | None:
    """The days of a stack's images and of one more; None where they are not told, so that the names may tell them."""
    known = stack.provenance.get("dates")
    if known is None:
        if date is not None:
            raise ParameterError("the images of this stack have no dates, so that one of the new image says nothing")
        return None
    if date is not None:
        return [*known, date]
    named = days_of_images([str(image)], None) if isinstance(image, str | Path) else None
    if named is None:
        logger.warning(
            "the day of the new image is not known, so that those of the others are not kept and say nothing of its "
            "pairs; give date"
        )
        return None
    return [*known, *named]


def reading_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords of `featreg.as_image` with which the images of a stack are read."""
    return {name: options[name] for name in READING if options.get(name) is not None}


class _Work:
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


def _best(pairs: Any, count: int) -> int:
    """The image with the most trusted pairs; among equals, with the smallest median variance, then the most central."""
    trusted = [pair for pair in pairs if pair.model is not None]

    def rank(image: int) -> tuple[int, float, float]:
        own = [np.trace(p.covariance, axis1=1, axis2=2).mean() for p in trusted if image in (p.first, p.second)]
        return -len(own), float(np.median(own)) if own else np.inf, abs(image - (count - 1) / 2)

    return min(range(count), key=rank)


def _second_chances(work: _Work, reference: int, count: int, only: int | None = None) -> None:
    """Match images that no pair leads to with further ones that are reached."""
    for _ in range(SECOND_CHANCES):
        reached = _reached(work.found.values(), reference)
        lost = [i for i in range(count) if i not in reached and only in (None, i)]
        more = []
        for image in lost:
            open_ = [
                i
                for i in sorted(reached, key=lambda i: work.farness(i, image))
                if tuple(sorted((i, image))) not in work.found and work.shared(i, image) != 0
            ]
            more += [(min(open_[0], image), max(open_[0], image))] if open_ else []
        if not more:
            return
        work.match(more)


def _reached(pairs: Any, reference: int) -> set[int]:
    seen, grown = {reference}, True
    while grown:
        grown = False
        for pair in pairs:
            if pair.model is not None and (pair.first in seen) != (pair.second in seen):
                seen |= {pair.first, pair.second}
                grown = True
    return seen


def _kind(model: Any) -> type[Model]:
    if model is None:
        return Affine
    return model if isinstance(model, type) else model_class(str(model))


def _assembled(kind: type[Stack], work: _Work, reference: int, pairs: Any) -> Stack:
    count = len(work.images)
    shape = work.sources[reference].shape
    ordered = [work.found[key] for key in sorted(work.found)]
    made = adjust(ordered, count, reference, shape, _kind(work.options.get("model")))
    closed = loops(ordered)
    status = ["ok" if model is not None else "left out" for model in made.models]
    reasons = ["" if model is not None else _why(made.pairs, i) for i, model in enumerate(made.models)]
    dates = None if work.days is None else [day.isoformat() for day in work.days]
    provenance = {
        "options": work.options,
        "pairs": pairs,
        "dates": dates,
        "unit_variance": made.unit,
        "versions": versions(),
    }
    stack = kind(
        work.names, reference, shape, made.models, status, reasons, made.standard_errors,
        [closure_of(closed, i) for i in range(count)], closed, [], made.pairs, provenance, work.images,
    )  # fmt: skip
    found = jumps([stack.shift(i) for i in range(count)], np.nan_to_num(made.standard_errors).tolist())
    return replace(stack, jumps=found)


def _why(pairs: Sequence[StackPair], image: int) -> str:
    """Why no trusted pair leads to an image."""
    own = [pair for pair in pairs if image in (pair.first, pair.second)]
    if not own:
        return "it shares no ground with the others, as their files say where they lie"
    if any(pair.used for pair in own):
        return "its trusted pairs lead to images only that are left out as well, none of them to the reference"
    thrown = [pair for pair in own if pair.model is not None]
    if thrown:
        worst = max((p.misfit for p in thrown if np.isfinite(p.misfit)), default=float("nan"))
        told = f" (by {worst:.1f} px)" if np.isfinite(worst) else ""
        return f"none of its {len(own)} pairs agrees with the others{told}"
    return f"none of its {len(own)} pairs can be trusted; the last one: {own[-1].reason}"
