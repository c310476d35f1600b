"""Many images to one stack, as a function."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.matching import PRIORS
from featreg.presets import DEFAULT_METHOD
from featreg.runtime.executors import check_executor
from featreg.runtime.parameters import check_seed
from featreg.runtime.threads import worker_count
from featreg.runtime.watching import Canceller, Progress, check_watch
from featreg.stacks.run import registered
from featreg.stacks.stack import Stack
from featreg.types import Image

#: Fewest images of a stack.
FEWEST = 2
#: Keywords of `featreg.match` that say something of one image of one pair.
OF_ONE_PAIR = ("reference_mask", "secondary_mask", "reference_band", "secondary_band")


def register_stack(
    images: Sequence[Any],
    *,
    reference: int | str = 0,
    pairs: Any = None,
    method: Any = DEFAULT_METHOD,
    model: Any = None,
    seed: int = 0,
    executor: Any = None,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: str | Path | None = None,
    progress: Progress | None = None,
    cancel: Canceller | None = None,
    dates: Sequence[Any] | None = None,
    coherence: Any = None,
    initial: Any = None,
    **keywords: Any,
) -> Stack:
    """Register many images of one place to one grid.

    Parameters
    ----------
    images : paths, 2-D arrays or `Image`, in the order of time
    reference : number of the image whose grid is taken, or "auto" for the one that its pairs determine best
    pairs : which pairs are matched: None for each image with the next two and with the reference, "chain" for each with
        the next, "all", or K for each with the next K. Where dates or `coherence` are known, the "next" are the later
        ones of which most is expected: short time spans first, of long ones those of one season
    dates : a day (YYYYMMDD, YYYY-MM-DD or `datetime.date`) for each image; None takes those in the files' names
    coherence : what is expected of two images in place of what their dates tell, 0 to 1: a function of their numbers
        or an (N, N) table; pairs of 0 are not matched
    initial : models known beforehand: a list of models from one grid, whichever, to each image (None where none is
        known), a dict {(i, k): model image i -> image k}, or the identity where the images lie on one grid.
        `search_radius` counts for the pairs that have one
    method, model, seed, keywords : as in `featreg.match`, for every pair; masks and bands of one of its images are
        none of them: give `band`, and `Image` with masks of their own; `prior` is no file of a result
    executor, workers, scheduler : what runs the pairs, or the blocks of each pair where the images are large; never
        changes the result
    resume : folder in which finished pairs are kept, and looked for; a longer stack finds those of a shorter one
    progress : called with (pairs done, pairs in all)
    cancel : an event; when set, the work stops between pairs with a `CancelledError`

    Returns
    -------
    Stack
        An image that no trusted pair leads to is left out with its reason, the rest goes on.

    Raises
    ------
    InputError, ParameterError
        Too few images, an unreadable one, an impossible parameter.
    CancelledError
        `cancel` was set.

    Notes
    -----
    All models are adjusted at once (`featreg.stacks.network.adjust`), weighted by what the tie points of each pair
    say of it; a pair that the others contradict is thrown out and named. `Stack.closure` is measured before that.
    """
    if isinstance(images, str | Path | Image) or not isinstance(images, Iterable):
        raise InputError(
            f"images must be a list of paths, arrays or Images, got {_shown(images)}; give [first, second]"
        )
    given = list(images)
    if len(given) < FEWEST:
        raise InputError(f"a stack needs at least {FEWEST} images, got {len(given)}")
    check_seed(seed)
    worker_count(workers)
    check_executor(executor)
    check_watch(progress, cancel)
    count = len(given)
    if reference != "auto" and (isinstance(reference, bool) or not isinstance(reference, int | np.integer)):
        raise ParameterError(f"reference must be the number of an image or 'auto', got {reference!r}")
    if reference != "auto" and not 0 <= int(reference) < count:
        raise ParameterError(f"reference must be a number from 0 to {count - 1}, got {reference}")
    wrong = [name for name in OF_ONE_PAIR if keywords.get(name) is not None]
    if wrong:
        raise ParameterError(
            f"{', '.join(wrong)} would mean another image in every pair of a stack; give band for all images, and "
            "masks with the images (featreg.as_image(file, mask=...))"
        )
    if keywords.get("search_radius") is not None and initial is None:
        raise ParameterError("search_radius needs initial, the models around which to search")
    prior = keywords.get("prior")
    if prior is not None and prior not in PRIORS:
        raise ParameterError(
            f"prior of a stack must be {' or '.join(map(repr, PRIORS))}, got {prior!r:.60}; what is known of one pair "
            "is given as initial={(i, k): model}"
        )
    options = {"method": method, "model": model, "seed": int(seed), "initial": initial, **keywords}
    how = {"executor": executor, "workers": workers, "scheduler": scheduler, "resume": resume, "cancel": cancel}
    return registered(Stack, given, reference, pairs, options, progress, how, dates, coherence)


def _shown(value: Any) -> str:
    return f"'{value}'" if isinstance(value, str | Path) else f"one {type(value).__name__}"
