"""Many images to one stack: the pairs matched, the network adjusted, loops closed, jumps found."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine
from featreg.interfaces import Model
from featreg.registry import model_class
from featreg.runtime.executors import check_executor
from featreg.runtime.threads import worker_count
from featreg.runtime.versions import versions
from featreg.runtime.watching import Progress, check_watch
from featreg.stacks.closure import closure_of, loops
from featreg.stacks.expected import days_of_images
from featreg.stacks.initial import initials, with_one_more
from featreg.stacks.jumps import jumps
from featreg.stacks.network import adjust
from featreg.stacks.pairs import StackPair
from featreg.stacks.stack_file import Unkept
from featreg.stacks.work import Work

if TYPE_CHECKING:
    from featreg.stacks.stack import Stack

#: Further neighbours that are tried for an image that no pair leads to.
SECOND_CHANCES = 3

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
    work = Work(given, {**options, "initial": initials(options.get("initial"), count)}, progress, how, dates, coherence)
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
    work = Work([*stack.images, image], options, progress, how, dates, coherence)
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


def _best(pairs: Any, count: int) -> int:
    """The image with the most trusted pairs; among equals, with the smallest median variance, then the most central."""
    trusted = [pair for pair in pairs if pair.model is not None]

    def rank(image: int) -> tuple[int, float, float]:
        own = [np.trace(p.covariance, axis1=1, axis2=2).mean() for p in trusted if image in (p.first, p.second)]
        return -len(own), float(np.median(own)) if own else np.inf, abs(image - (count - 1) / 2)

    return min(range(count), key=rank)


def _second_chances(work: Work, reference: int, count: int, only: int | None = None) -> None:
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


def _assembled(kind: type[Stack], work: Work, reference: int, pairs: Any) -> Stack:
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
