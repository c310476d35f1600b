"""Models known beforehand of the pairs of a stack: one an image, or one a pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import index
from typing import Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.geometry import as_model
from featreg.interfaces import Model
from featreg.stacks.network import composed

FORMS = "give a list of models from one grid to each image, None where unknown, or a dict {(i, k): model} of pairs"


def initials(given: Any, count: int) -> dict[str, Any] | None:
    """Return the models known beforehand in the one form that a stack keeps.

    Parameters
    ----------
    given : None; a sequence of `count` models or matrices from one grid, whichever, to each image, None where none is
        known; a mapping of pairs (i, k) to models image i -> image k; or the identity, where the images lie on one grid
    count : how many images

    Returns
    -------
    {"images": [model or None, ...]} or {"pairs": [[i, k, model], ...]} with i < k; None where nothing is given

    Raises
    ------
    ParameterError
        One model that is not the identity: it would say the same of every pair. Another number of models, a number that
        is no image's, a pair that is given twice.
    """
    if given is None:
        return None
    if isinstance(given, Mapping):
        made = [_pair(key, model, count) for key, model in given.items()]
        twice = [(i, k) for n, (i, k, _) in enumerate(made) if any(other[:2] == [i, k] for other in made[:n])]
        if twice:
            raise ParameterError(f"initial is given both ways round for the pair {twice[0]}; leave one of them out")
        return {"pairs": made}
    if isinstance(given, Model | np.ndarray) or _is_matrix(given):
        matrix = _model(given, "initial").matrix
        if matrix is None or not np.array_equal(matrix, np.eye(3)):
            raise ParameterError(f"one initial model would say the same of every pair of a stack; {FORMS}")
        return {"images": [_model(matrix, "initial") for _ in range(count)]}
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise ParameterError(f"initial of a stack cannot be {type(given).__name__}; {FORMS}")
    if len(given) != count:
        raise ParameterError(f"initial holds {len(given)} models for {count} images; {FORMS}")
    return {"images": [None if m is None else _model(m, f"initial of image {i}") for i, m in enumerate(given)]}


def initial_of(kept: Mapping[str, Any] | None, first: int, second: int) -> Model | None:
    """Return the model first -> second, as far as it is known beforehand."""
    if kept is None:
        return None
    if "pairs" in kept:
        return next((model for i, k, model in kept["pairs"] if (i, k) == (first, second)), None)
    here, there = kept["images"][first], kept["images"][second]
    return None if here is None or there is None else composed(here.inverse, there)


def with_one_more(kept: Mapping[str, Any] | Model | None, given: Any, count: int) -> dict[str, Any] | None:
    """Return what is known beforehand once an image stands at the end, `count` with it.

    Parameters
    ----------
    kept : of the images before it; a model where a file of earlier times holds one for all
    given : of the new one: a model from the grid of the others', or a mapping of its pairs; None where nothing is known
    count : how many images there are now
    """
    if isinstance(kept, Model):
        kept = initials(kept, count - 1)
    if isinstance(given, Mapping):
        if kept is not None and "images" in kept:
            raise ParameterError("initial of this stack is one model an image; give that of the new image")
        more = initials(given, count)
        return {"pairs": [*([] if kept is None else kept["pairs"]), *([] if more is None else more["pairs"])]}
    if given is None:
        return None if kept is None else dict(kept) if "pairs" in kept else {"images": [*kept["images"], None]}
    if kept is None or "pairs" in kept:
        raise ParameterError(
            f"initial of this stack is not one model an image; give a dict {{(i, {count - 1}): model}}"
        )
    return {"images": [*kept["images"], _model(given, "initial")]}


def _pair(key: Any, model: Any, count: int) -> list[Any]:
    try:
        first, second = (index(n) for n in key)
    except (TypeError, ValueError):
        raise ParameterError(f"initial is given for {key!r}, which is no pair (i, k) of numbers of images") from None
    if not (0 <= first < count and 0 <= second < count and first != second):
        raise ParameterError(f"initial is given for the pair ({first}, {second}); images are numbered 0 to {count - 1}")
    made = _model(model, f"initial of the pair ({first}, {second})")
    return [first, second, made] if first < second else [second, first, made.inverse]


def _model(given: Any, what: str) -> Model:
    try:
        return as_model(given)
    except InputError as error:
        raise ParameterError(f"{what}: {error}") from error


def _is_matrix(given: Any) -> bool:
    try:
        return np.ndim(given) == 2 and np.asarray(given).dtype.kind in "uif"
    except ValueError:
        return False
