"""What is drawn on both scenes at one place, frames, labels, dead pixels, is no data for any block."""

from __future__ import annotations

import numpy as np

from featreg.io.excerpt import Excerpt, part_of, together
from featreg.io.raster_source import Source, Window
from featreg.pipeline.identical import identical_pixels, stands_still, without_identical
from featreg.types import BoolArray, Image, Matches


def without_drawn(
    reference: Source | Excerpt,
    secondary: Source | Excerpt,
    here: Window,
    there: Window,
    seen: Image,
    seen_there: Image,
) -> tuple[Image, Image, float | None]:
    """Return both windows of a block without what the scenes share at one place while the image around differs.

    Parameters
    ----------
    reference, secondary : the scenes
    here, there : the windows of the block
    seen, seen_there : their pixels

    Returns
    -------
    reference, secondary : the windows, those pixels invalid
    share : of a window's pixels that are shared, the larger of the two; 1 where a pattern over all of it is, which
        leaving it out would leave nothing of; None where there are none

    Notes
    -----
    What was drawn on a scene has its place in the scene, so that each window is compared with the same window of the
    other scene; both at once where one window holds both without being much larger. Scenes of two sizes have no common
    place.
    """
    if reference.shape != secondary.shape:
        return seen, seen_there, None
    around = together(here, there)
    if around is not None:
        same = identical_pixels(reference.read(around), secondary.read(around))
        parts = (None if same is None else part_of(same, window, around) for window in (here, there))
        first, second = (part if part is not None and part.any() else None for part in parts)
    else:
        first = identical_pixels(seen, secondary.read(here))
        second = identical_pixels(reference.read(there), seen_there)
    if first is None and second is None:
        return seen, seen_there, None
    if first is not None:
        seen, _ = without_identical(seen, seen, first)
    if second is not None:
        _, seen_there = without_identical(seen_there, seen_there, second)
    return seen, seen_there, max(float(found.mean()) for found in (first, second) if found is not None)


def moving(matches: Matches, here: Window, there: Window) -> BoolArray:
    """(M,) tie points between two windows that do not stand still in the scenes, as what is drawn does."""
    off = np.subtract(here.origin, there.origin).astype(np.float64)
    return np.asarray(~stands_still(Matches(matches.reference_xy + off, matches.secondary_xy, np.zeros(len(matches)))))


def words(share: float) -> str:
    """What a block says of it."""
    if share == 1:
        return "both scenes have one pattern here and nothing else in common: tie points that stand still were left out"
    return f"drawn on both scenes while the image around differs, and left out: {100 * share:.2g} % of the pixels"
