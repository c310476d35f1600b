"""Static pictures of a registration: tie points, checkerboard and two-colour overlay, as PNG files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from featreg.geometry import decompose, local_linear
from featreg.interfaces import FailedFit, Model
from featreg.pictures.panels import Gray, checkerboard, display, overlay, views_to_draw_on
from featreg.pictures.sheet import FAINT, INK, Colour, Lines, Note, Sheet, checked_target
from featreg.pictures.spread import spread_out
from featreg.results.registration import Registration
from featreg.results.stages import MEASURED
from featreg.study.truth import Truth, TruthLike, read_truth
from featreg.types import BoolArray, FloatArray, Image

__all__ = [
    "checkerboard",
    "display",
    "draw_checkerboard",
    "draw_matches",
    "draw_overlay",
    "draw_registration",
    "overlay",
]

#: Blue-green and vermillion, told apart by colour-blind eyes and on gray.
GOOD, BAD = (0, 205, 165), (255, 107, 26)
#: The same for text on white paper.
GOOD_INK, BAD_INK = (0, 130, 100), (200, 75, 0)
#: Most lines drawn between the images, of points that do not agree and that do; further points are dots only.
JOINED = (35, 80)
CHECKERBOARD = "checkerboard: reference and secondary in turn"
OVERLAY = "overlay: reference magenta, secondary green, both white"


def draw_matches(
    reference: Image,
    secondary: Image,
    registration: Registration,
    path: str | Path,
    *,
    truth: TruthLike | None = None,
    threshold: float = 1.5,
    max_lines: int = 400,
) -> None:
    """Write a PNG of both images side by side with their tie points.

    Parameters
    ----------
    reference, secondary : the images that were matched
    registration : the result; with `truth`, the tie points that its last filter kept are drawn as correct or false,
        without it, all tie points as accepted or rejected
    path : PNG file to write; its folder must exist
    truth : whatever `featreg.study.truth.read_truth` takes: a model, a (2, 3) or (3, 3) matrix, a flow, a file, ...
    threshold : pixels within which a tie point is correct
    max_lines : at most so many tie points are drawn, spread over the reference by a fixed rule, and the lines of
        about a hundred of them, so that they can be told apart

    Raises
    ------
    InputError
        The folder is missing, the file is no PNG, or the truth cannot be read as one.
    """
    checked_target(path)
    groups = _groups(registration, _known(truth), threshold)
    views = views_to_draw_on(reference, secondary)
    lines = _lines(registration, groups, views, (reference.shape, secondary.shape), max_lines)
    header = [_status(registration), [*_counts(registration, groups), *_drawn(groups, lines)]]
    Sheet([views], ["reference", "secondary"], header, lines).write(path)


def draw_checkerboard(reference: Image, aligned: Image | ArrayLike, path: str | Path, tiles: int = 8) -> None:
    """Write a PNG of alternating tiles of the reference and of the secondary on the reference grid.

    Parameters
    ----------
    reference : the reference image
    aligned : `Image`, or (H, W) amplitude or complex array with NaN where there is no data
    path : PNG file to write; its folder must exist
    tiles : number of tiles along the longer side

    Raises
    ------
    InputError
        The shapes differ, the folder is missing or the file is no PNG.
    """
    Sheet([[checkerboard(reference, aligned, tiles)]], [CHECKERBOARD]).write(path)


def draw_overlay(reference: Image, aligned: Image | ArrayLike, path: str | Path) -> None:
    """Write a PNG with the reference in magenta and the aligned secondary in green: what agrees is gray or white.

    Parameters and errors are those of `draw_checkerboard`.
    """
    Sheet([[overlay(reference, aligned)]], [OVERLAY]).write(path)


def draw_registration(
    reference: Image,
    secondary: Image,
    registration: Registration,
    path: str | Path,
    truth: TruthLike | None = None,
    *,
    factors: tuple[int, int] = (1, 1),
) -> None:
    """Write one PNG that shows a registration: tie points above, checkerboard and overlay below, the figures on top.

    An unreliable registration says so, with its reason; where it has no model, the lower panels are left out.
    Of large images, overviews will do: `factors` says how many pixels of the reference and of the secondary, along each
    side, are one pixel of theirs. The other parameters, and the errors, are those of `draw_matches`.
    """
    checked_target(path)
    registration_sheet(reference, secondary, registration, truth, factors=factors).write(path)


def registration_sheet(
    reference: Image,
    secondary: Image,
    registration: Registration,
    truth: TruthLike | None = None,
    *,
    factors: tuple[int, int] = (1, 1),
    at_hand: bool = True,
    verdict: bool = True,
) -> Sheet:
    """Return the sheet of `draw_registration`.

    Without images `at_hand` the two given are frames of any size to draw in, and the lower panels are left out; without
    a `verdict` so are status and figures, as of tie points that nobody judged.
    """
    known = _known(truth)
    groups = _groups(registration, known, 1.5)
    views = views_to_draw_on(reference, secondary)
    shapes = [(image.shape[0] * factor, image.shape[1] * factor) for image, factor in
              zip((reference, secondary), factors, strict=True)]  # fmt: skip
    rows: list[list[Gray]] = [views]
    labels = ["reference", "secondary"]
    if not at_hand:
        said = (registration.reference, registration.secondary)
        shapes = [shape if image is None else image.shape for shape, image in zip(shapes, said, strict=True)]
        labels = [f"{label}: its image is not at hand" for label in labels]
    elif registration.model:
        from featreg.products.resample import resample

        reduced = _reduced(registration.model, factors)
        aligned = resample(secondary, reduced, reference.shape, resampling="bilinear")
        rows.append([checkerboard(reference, aligned), overlay(reference, aligned)])
        labels += [CHECKERBOARD, OVERLAY]
    header: list[list[Note]] = []
    if verdict:
        header = [[*_status(registration), *_figures(registration, shapes[0], known)]]
    lines = _lines(registration, groups, views, (shapes[0], shapes[1]), 250)
    header.append([*_counts(registration, groups), *_drawn(groups, lines)])
    return Sheet(rows, labels, header, lines)


def _reduced(model: Model, factors: tuple[int, int]) -> Callable[[FloatArray], FloatArray]:
    """The model between the pixels of two overviews; the first of factor f lies at (f - 1) / 2."""
    if factors == (1, 1):
        return model
    here, there = factors

    def mapped(xy: FloatArray) -> FloatArray:
        return (model(here * xy + (here - 1) / 2) - (there - 1) / 2) / there

    return mapped


def _known(truth: TruthLike | None) -> Truth | None:
    return None if truth is None else read_truth(truth)


@dataclass(frozen=True, eq=False)
class _Group:
    """Tie points drawn in one colour: `rows` (M,) bool."""

    name: str
    colour: Colour
    ink: Colour
    rows: BoolArray


def _groups(registration: Registration, truth: Truth | None, threshold: float) -> list[_Group]:
    """The tie points in two groups, those to be drawn below first."""
    matches, accepted = registration.matches, registration.inliers
    if truth is None:
        rejected = registration.putative & ~accepted
        # the match that an accepted point was measured anew from lives on in it
        rejected[matches.origin[accepted & (matches.origin >= 0)]] = False
        if "refine" in registration.stages and not (matches.origin[accepted] >= 0).any():
            # refined points of their own, as those of blocks: what the filters kept was not rejected
            filters = [mask for name, mask in registration.stages.items() if name not in MEASURED]
            rejected &= ~filters[-1] if filters else False
        return [_Group("rejected", BAD, BAD_INK, rejected), _Group("accepted", GOOD, GOOD_INK, accepted)]
    kept = list(registration.stages.values())[-1] if registration.stages else np.ones(len(matches), bool)
    error = np.hypot(*(truth(matches.reference_xy) - matches.secondary_xy).T)
    right, wrong = error <= threshold, error > threshold  # neither, where the truth is not known
    return [
        _Group("false", BAD, BAD_INK, kept & wrong),
        _Group(f"correct (within {threshold:g} px)", GOOD, GOOD_INK, kept & right),
    ]


def _lines(
    registration: Registration,
    groups: list[_Group],
    views: list[Gray],
    shapes: tuple[tuple[int, int], tuple[int, int]],
    max_lines: int,
) -> list[Lines]:
    bad, good = (int(group.rows.sum()) for group in groups)
    # points that agree make lines side by side, which stay readable; those that do not agree cross: fewer will do
    bad = min(bad, max(max_lines // 5, min(max_lines - good, max_lines // 3)))
    counts = (bad, min(good, max_lines - bad))
    lines = []
    for group, count, joined in zip(groups, counts, JOINED, strict=True):
        chosen = registration.matches.take(np.flatnonzero(group.rows))
        chosen = chosen.take(spread_out(chosen.reference_xy, chosen.score, count))
        first = spread_out(chosen.reference_xy, chosen.score, joined)
        chosen = chosen.take(np.r_[first, np.setdiff1d(np.arange(len(chosen)), first)])
        ends = []
        for xy, view, shape in zip((chosen.reference_xy, chosen.secondary_xy), views, shapes, strict=True):
            factor = np.array(view.shape[1::-1]) / shape[::-1]
            ends.append((xy + 0.5) * factor - 0.5)
        lines.append(Lines(ends[0], ends[1], group.colour, len(first)))
    return lines


def _status(registration: Registration) -> list[Note]:
    method = str(registration.provenance.get("method", "registration"))
    if registration.status == "ok":
        return [Note(method, INK, bold=True), Note("ok", GOOD_INK, bold=True)]
    return [
        Note(method, INK, bold=True),
        Note("unreliable", BAD_INK, bold=True),
        Note(registration.reason, BAD_INK),
    ]


def _counts(registration: Registration, groups: list[_Group]) -> list[Note]:
    notes = [Note(f"{group.rows.sum()} {group.name}", group.ink, dot=True) for group in groups[::-1]]
    candidates = int(registration.putative.sum())
    chain = [f"{candidates} candidates", *(f"{mask.sum()} after {name}" for name, mask in registration.stages.items())]
    return [*notes, Note(", ".join(chain), FAINT)]


def _drawn(groups: list[_Group], lines: list[Lines]) -> list[Note]:
    """How many of the tie points are drawn, where that is not all of them."""
    shown, every = sum(len(one.start) for one in lines), sum(int(group.rows.sum()) for group in groups)
    return [Note(f"{shown} of these {every} drawn, spread over the image", FAINT)] if shown < every else []


def _figures(registration: Registration, shape: tuple[int, int], truth: Truth | None) -> list[Note]:
    """Tie points, rotation and scale of the model, and how well it fits."""
    model, accepted = registration.model, registration.inliers
    notes = [Note(f"{accepted.sum()} tie points")]
    if isinstance(model, FailedFit):
        return [*notes, Note(f"no model: {model.reason}")]
    y, x = np.indices((9, 9)).reshape(2, -1) / 8.0
    grid = np.column_stack([x, y]) * (np.array(shape[::-1]) - 1.0)
    linear = decompose(local_linear(model, (np.array(shape[::-1]) - 1.0) / 2))
    notes.append(Note(f"rotation {linear.rotation_deg:+.2f}°, scale {linear.scale:.4f}"))
    if accepted.any():
        notes.append(Note(f"RMSE {np.sqrt(np.mean(registration.residuals()[accepted] ** 2)):.2f} px"))
    if truth is not None:
        squared = np.sum((model(grid) - truth(grid)) ** 2, axis=1)
        error = np.sqrt(np.mean(squared[np.isfinite(squared)])) if np.isfinite(squared).any() else np.nan
        notes.append(Note(f"error against the truth {error:.2f} px"))
    return notes
