"""The page of one registration, without an experiment: swipe, flicker, tie points, gates."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.io.images import as_image
from featreg.report.data import ReportEntry, ReportPair, ReportStudy
from featreg.report.page import write_report
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.results.summary import facts_of
from featreg.study.truth import TruthLike, read_truth
from featreg.types import Image


def write_registration_report(
    path: str | Path,
    registration: Registration,
    *,
    reference: Any = None,
    secondary: Any = None,
    truth: TruthLike | None = None,
    threshold: float = 1.5,
) -> None:
    """Write the page of a result as one HTML file.

    Parameters
    ----------
    path : the file, named .html or .htm
    registration : the result
    reference, secondary : the images, where they are no longer where the result says; an image that cannot be read is
        told on the page, which then shows the tie points alone
    truth : as `featreg.evaluate` takes it; tie points are then correct or false
    threshold : px, greatest distance of a correct tie point from the truth

    Raises
    ------
    InputError
        The file cannot be written, the truth cannot be read, or an image that is given has another size.
    """
    first = _image("reference", reference, registration.reference)
    second = _image("secondary", secondary, registration.secondary)
    known = None if truth is None else read_truth(truth)
    name = " and ".join(_name(image, role) for image, role in (
        (registration.reference, "reference"), (registration.secondary, "secondary"),
    ))  # fmt: skip
    method = str(registration.provenance.get("method", "registration"))
    pair = ReportPair(name, first, second, known, "" if known is None else str(known))
    entry = ReportEntry(name, method, int(registration.provenance.get("seed") or 0), registration)
    facts: dict[str, Any] = {text: said for text, said in facts_of(registration) if text != "method"}
    versions = registration.provenance.get("versions") or {}
    machine = {"versions": ", ".join(f"{k} {v}" for k, v in dict(versions).items())} if versions else {}
    study = ReportStudy(f"{method}: {name}", [pair], [entry], threshold=threshold, protocol=facts, machine=machine)
    write_report(path, study)


def _name(image: InputImage | None, role: str) -> str:
    return role if image is None or image.path in ("array", "tie points") else Path(image.path).name


def _image(role: str, given: Any, known: InputImage | None) -> Callable[[], Image] | Any:
    """The image to show: as it is where it was given, else of the file by the result's own scale."""
    if given is not None:
        if known is not None and isinstance(given, np.ndarray | Image) and given.shape != known.shape:
            raise InputError(f"the {role} has the shape {given.shape}, that of the result was {known.shape}")
        return given
    if known is None or known.path in ("array", "tie points"):
        return partial(_missing, role)
    if all(value in (None, "amplitude") for value in known.reading.values()):
        return known.path
    return partial(as_image, known.path, **known.reading)


def _missing(role: str) -> Image:
    raise InputError(f"the {role} was an array, which a result does not keep; give its file (--{role})")
