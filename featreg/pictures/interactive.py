"""What notebooks show: a card of HTML and a figure for each type, chosen by the type.

A room adds its own types with ``html_of.register`` and ``figure_of.register`` in a module that stands here.
"""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.interfaces import FailedFit
from featreg.io.images import as_image, small_image
from featreg.pictures import charts, sketches
from featreg.pictures.cards import card, folded, picture, table
from featreg.pictures.drawing import registration_sheet
from featreg.pictures.panels import display, overlay, resized
from featreg.pictures.sheet import Sheet
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.results.summary import facts_of
from featreg.study.experiment_results import Study
from featreg.study.table import Table
from featreg.types import Features, Geolocation, Image, Matches

#: Pixels of an image file that is read to show a result, and side to which an image is reduced first.
MOST_PIXELS, SIDE = 4_000_000, 720
#: Rows of a table on a card.
MOST_ROWS = 60


@singledispatch
def html_of(shown: Any) -> str:
    """Return an object as a fragment of HTML below 500 kB, without a script.

    Raises
    ------
    ParameterError
        Nothing says how the type is shown.
    """
    raise ParameterError(f"how a {type(shown).__name__} is shown has not been registered")


@singledispatch
def figure_of(shown: Any, **options: Any) -> Any:
    """Return a `matplotlib.figure.Figure` of an object.

    Raises
    ------
    ParameterError
        Nothing says how the type is drawn.
    """
    raise ParameterError(f"how a {type(shown).__name__} is drawn has not been registered")


@html_of.register
def _(image: Image) -> str:
    height, width = image.shape
    facts = [
        ("size", f"{width} x {height} px"),
        ("samples", f"{image.scale}, {image.source_dtype} in the source"),
        ("valid", f"{100 * float(image.mask.mean()):.4g} %"),
        ("place", place_words(image.geolocation)),
    ]
    return card(image.name, facts, figures=[picture(display(_reduced(image)), "amplitude, 1 % to 99.5 %, logarithmic")])


def place_words(place: Geolocation | None) -> str:
    """Return what an image says of where it lies, in a few words."""
    if place is None:
        return "not georeferenced"
    if place.rpcs is not None:
        return "RPC coefficients"
    if place.transform is not None:
        x, y = np.hypot(place.transform[0], place.transform[3]), np.hypot(place.transform[1], place.transform[4])
        return f"geotransform, {x:.6g} x {y:.6g} per pixel, {_crs_words(place.crs)}"
    count = 0 if place.gcps is None else len(place.gcps)
    return f"{count} ground control points, {_crs_words(place.crs)}"


def _crs_words(crs: str | None) -> str:
    if not crs:
        return "no coordinate system"
    return crs if len(crs) < 40 else f"{crs.split(chr(34))[1] if chr(34) in crs else crs[:40]}"


def _reduced(image: Image) -> Image:
    factor = SIDE / max(image.shape)
    if factor >= 1:
        return image
    return Image(*resized(image.amplitude, image.mask, factor), None, image.name)


@html_of.register
def _(features: Features) -> str:
    if len(features):
        scale, score = (np.percentile(values, [0, 50, 100]) for values in (features.scale, features.score))
        spans = [
            ("scale", f"{scale[0]:.3g} to {scale[2]:.3g} px, median {scale[1]:.3g}"),
            ("score", f"{score[0]:.3g} to {score[2]:.3g}, median {score[1]:.3g}"),
        ]
    else:
        spans = []
    facts = [("points", str(len(features))), *spans, ("descriptors", features.described_as)]
    drawn = sketches.points(features.xy, features.score, None)
    return card("Features", facts, figures=[drawn] if len(features) else [])


@html_of.register
def _(matches: Matches) -> str:
    moved = matches.secondary_xy - matches.reference_xy
    facts = [("tie points", str(len(matches)))]
    if len(matches):
        middle, spread = np.median(moved, axis=0), np.ptp(moved, axis=0)
        facts += [
            (
                "displacement",
                f"median {middle[0]:+.2f}, {middle[1]:+.2f} px; range {spread[0]:.4g}, {spread[1]:.4g} px",
            ),
            ("refined", str(int((matches.origin >= 0).sum()))),
            ("covariance", "known" if matches.covariance is not None else "not known"),
        ]
    good = np.ones(len(matches), np.bool_)
    drawn = sketches.arrows(matches.reference_xy, matches.secondary_xy, matches.score, good, None)
    return card("Matches", facts, figures=[drawn] if len(matches) else [])


@html_of.register
def _(registration: Registration) -> str:
    images = _images(registration, None, None)
    figures = []
    if images is not None and registration.model:
        from featreg.products.resample import resample

        aligned = resample(images[1], registration.model, images[0].shape, resampling="bilinear")
        figures.append(picture(overlay(images[0], aligned), "reference magenta, aligned secondary green, both white"))
    matches, image = registration.matches, registration.reference
    if len(matches):
        drawn = sketches.arrows(
            matches.reference_xy,
            matches.secondary_xy,
            matches.score,
            registration.inliers,
            None if image is None else image.shape,
        )
        figures.append(f"<figure>{drawn}<figcaption>tie points: final green, others orange</figcaption></figure>")
    gates = registration.gates.items()
    rows = [
        (name, "passed" if g.passed else "failed", *(_number(v) for v in (g.value, g.low, g.high)), g.meaning)
        for name, g in gates
    ]
    kinds = [("", "ok" if g.passed else "failed", "number", "number", "number", "words") for _, g in gates]
    body = table(("gate", "", "value", "at least", "at most", "meaning"), rows, kinds) if rows else ""
    return card(
        "Registration", facts_of(registration), status=registration.status, reason=registration.reason, figures=figures,
        body=body,
    )  # fmt: skip


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


@html_of.register
def _(made: Table) -> str:
    return _table_card("Comparison", made)


@html_of.register
def _(study: Study) -> str:
    return _table_card(study.title or "Study", study.table())


def _table_card(title: str, made: Table) -> str:
    from featreg.study.layouts import best_of

    failed = made.failed
    facts = [
        ("pairs", str(len({row["pair"] for row in made.rows}))),
        ("methods", ", ".join(made.methods)),
        *([("failed rows", str(failed))] if failed else []),
    ]
    columns = [c for c in made.columns if c != "reason" or any(row["reason"] for row in made.rows)]
    rows, kinds = [], []
    for row in made.rows[:MOST_ROWS]:
        rivals = [other for other in made.rows if other["pair"] == row["pair"] and other["status"] == "ok"]
        rows.append([made.cell(row, name) for name in columns])
        kinds.append([_kind(made, row, name, rivals, best_of) for name in columns])
    left = len(made.rows) - len(rows)
    body = table(columns, rows, kinds) + (f"<p>{left} further rows are not shown</p>" if left > 0 else "")
    return card(title, facts, body=body + folded("How these numbers came about", made.protocol))


def _kind(made: Table, row: Any, name: str, rivals: Any, best_of: Any) -> str:
    if name == "status":
        return str(row[name])
    if name not in made.metrics:
        return ""
    best = row["status"] == "ok" and best_of(row, name, rivals)
    return "number best" if best else "number"


@figure_of.register
def _(image: Image, **options: Any) -> Any:
    none_but(options)
    return Sheet([[display(_reduced(image))]], [image.name]).figure()


@figure_of.register
def _(matches: Matches, **options: Any) -> Any:
    none_but(options, "reference", "secondary")
    known = [InputImage("array", _extent(xy)) for xy in (matches.reference_xy, matches.secondary_xy)]
    every = np.ones(len(matches), np.bool_)
    plain = Registration(
        matches, {}, every, FailedFit("none was fitted"), "unreliable", "not judged", reference=known[0],
        secondary=known[1],
    )  # fmt: skip
    images = _images(plain, options.get("reference"), options.get("secondary"))
    if images is None:
        return registration_sheet(*_blank(plain), plain, at_hand=False, verdict=False).figure()
    return registration_sheet(*images, plain, verdict=False).figure()


@figure_of.register
def _(registration: Registration, **options: Any) -> Any:
    none_but(options, "reference", "secondary", "truth")
    images = _images(registration, options.get("reference"), options.get("secondary"))
    if images is not None:
        return registration_sheet(*images, registration, options.get("truth")).figure()
    return registration_sheet(*_blank(registration), registration, options.get("truth"), at_hand=False).figure()


@figure_of.register
def _(made: Table, **options: Any) -> Any:
    none_but(options, "metrics")
    return charts.comparison(made, options.get("metrics"))


@figure_of.register
def _(study: Study, **options: Any) -> Any:
    none_but(options, "metrics")
    return charts.comparison(study.table(), options.get("metrics"))


def none_but(options: Any, *known: str) -> None:
    """Raise where an option is given that this figure does not know."""
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise ParameterError(f"unknown option '{unknown[0]}'; known: {', '.join(known) or 'none'}")


def _extent(xy: Any) -> tuple[int, int]:
    """(H, W) of an image that ends at the outermost points."""
    width, height = (np.ceil(xy.max(axis=0)).astype(int) + 1).tolist() if len(xy) else (1, 1)
    return max(height, 1), max(width, 1)


def _images(registration: Registration, *given: Any) -> tuple[Image, Image] | None:
    """Both images: those given, else their files, where these are at hand, unchanged in size and not large."""
    found: list[Image] = []
    for image, known in zip(given, (registration.reference, registration.secondary), strict=True):
        if image is not None:
            made = as_image(image)
            if known is not None and known.path != "array" and made.shape != known.shape:
                raise InputError(f"{made.name}: has the shape {made.shape}, that of the result was {known.shape}")
            found.append(made)
            continue
        if known is None or not Path(known.path).is_file():
            return None
        try:
            read = small_image(known.path, MOST_PIXELS, **known.reading)
        except InputError:
            return None
        if read is None or read.shape != known.shape:
            return None
        found.append(read)
    return found[0], found[1]


def _blank(registration: Registration) -> tuple[Image, Image]:
    """Frames without content, of images that are not at hand."""
    made = []
    points = registration.matches
    for known, xy in ((registration.reference, points.reference_xy), (registration.secondary, points.secondary_xy)):
        shape = _extent(xy) if known is None else known.shape
        factor = min(1.0, SIDE / max(shape))
        small = tuple(max(1, round(n * factor)) for n in shape)
        made.append(Image(np.zeros(small, np.float32), np.zeros(small, np.bool_), None, "not at hand"))
    return made[0], made[1]
