"""Autofocus before registration: complex inputs are focused where that can be trusted, and left alone where not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from featreg.errors import InputError, ParameterError, suggest
from featreg.focusing.complex_image import METHODS, focus
from featreg.focusing.result import FocusResult
from featreg.types import Image

Focus = str | Callable[[Image], FocusResult]


def check_method(name: str) -> None:
    """Raise where no autofocus method has this name."""
    if name not in METHODS:
        raise ParameterError(f"unknown autofocus method '{name}', {suggest(name, METHODS)}")


def focused_inputs(reference: Image, secondary: Image, how: Focus) -> tuple[Image, Image, dict[str, Any]]:
    """Return both images, focused where they are complex and the focus can be trusted, and what was done.

    Parameters
    ----------
    reference, secondary : real images stay as they are
    how : a method of `featreg.focus` (azimuth down the columns), or a function from an image to a `FocusResult`, which
        may know another azimuth axis or the carrier of a back-projected image

    Returns
    -------
    reference, secondary, and role -> {"method", "status", "reason", "deviation", "iterations"} for the provenance

    Raises
    ------
    ParameterError, InputError
        An unknown method; both images are real.

    Notes
    -----
    Both images are focused, because it is not known which of them is blurred; on a sharp image the phase found is that
    of its own small errors. The linear phase that would shift an image in azimuth is taken out (`detrend`), so the
    model holds for the images as they were given.
    """
    if not reference.is_complex and not secondary.is_complex:
        raise InputError(f"{secondary.name}: focus needs complex samples, and both images are real; leave focus out")
    (first, done), (second, also) = (focused_input(image, how) for image in (reference, secondary))
    return first, second, {"reference": done, "secondary": also}


def focused_input(image: Image, how: Focus) -> tuple[Image, dict[str, Any]]:
    """Return one image, focused where it is complex and the focus can be trusted, and what was done."""
    if isinstance(how, str):
        check_method(how)
        run: Callable[[Image], FocusResult] = partial(focus, method=how, detrend=True)
    elif callable(how):
        run = how
    else:
        raise ParameterError(f"focus must be a method's name or a function of an image, got {type(how).__name__}")
    if not image.is_complex:
        return image, {"status": "not done", "reason": "the samples are real"}
    result = run(image)
    record = {
        "method": result.method,
        "status": result.status,
        "reason": result.reason,
        "deviation": result.deviation if np.isfinite(result.deviation) else None,
        "iterations": result.iterations,
    }
    if result.status != "ok":
        return image, {**record, "used": False}
    pixels = np.where(image.mask, result.image, np.complex64(0))
    return replace(image, pixels=pixels), {**record, "used": True}
