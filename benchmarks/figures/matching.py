"""Figures 3 and 5 of the SAR-ORB paper (Wang et al. 2022): the overlap of two scenes, the matches of six methods."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from measuring import real_pairs, simulated_pairs
from scenes import simulated_scenes

import featreg
from featreg.geolocation import ConstantHeight, find_overlap, ground_level, sensor_of
from featreg.io import as_image
from featreg.io.raster_source import open_source
from featreg.pictures.panels import display
from featreg.scene.blocks import plan_blocks, proportional_part
from featreg.study.evaluation import stage_mask
from featreg.study.measures import match_errors
from figures.page import Figure, axes, ranked, show

PAPER = "Rapid Subpixel Matching Method for Spaceborne Synthetic Aperture Radar Images (Wang et al. 2022)"
SAID = (
    "Its images are not public: simulated scenes with RPCs, and real Sentinel-1 dates under a known warp, stand for "
    "them."
)
METHODS = ("sar-sift", "rift", "bfsift", "s-gof", "m-gof", "sar-orb")
#: Matches that are drawn, spread over all.
DRAWN = 150


def overlap(folder: Path, seed: int) -> Figure:
    """Figure 3: the overlap of two scenes in both of them, and the blocks."""
    (pair,) = simulated_scenes(folder, (1500, 1600), seed, 1)
    sources = [open_source(pair[role]) for role in ("reference", "secondary")]
    sensors = [sensor_of(source.geolocation, source.shape, source.name) for source in sources]
    heights = ConstantHeight(ground_level(*sensors)[0])
    found = find_overlap(sensors[0], sensors[1], sources[0].shape, sources[1].shape, heights)
    drawn, places = axes(1, 2, (12, 5.6))
    blocks = plan_blocks(found.reference)
    for place, source, window, name in zip(
        places[0], sources, (found.reference, found.secondary), ("reference", "secondary"), strict=True
    ):
        show(place, source.overview(2).amplitude, name)
        for block in blocks:
            part = proportional_part(block.window, found.reference, window)
            place.add_patch(_rectangle(part, "tab:cyan", 0.8))
        place.add_patch(_rectangle(window, "red", 2.0))
    share = found.reference.width * found.reference.height / np.prod(sources[0].shape)
    return Figure.of(
        "Figure 3", "Overlapping area of two SAR images",
        f"A simulated pair of incidence angles 48.02 and 48.83 degrees (3 m pixels, 1500 x 1600 px): in red the "
        f"largest "
        f"upright rectangle that both show by their RPCs ({100 * share:.0f} % of the reference), in blue its "
        f"{len(blocks)} blocks and the parts of the secondary that correspond in proportion.",
        "As in the paper, whose scenes are 10 024 x 11 458 px and divided into 195 to 295 blocks.", drawn,
    )  # fmt: skip


def _rectangle(window: Any, colour: str, width: float) -> Any:
    from matplotlib.patches import Rectangle

    # The overview shows every second pixel.
    at = (window.x / 2 - 0.5, window.y / 2 - 0.5)
    return Rectangle(at, window.width / 2, window.height / 2, fill=False, edgecolor=colour, linewidth=width)


def six_methods(seed: int, *, paper: bool) -> Figure:
    """Figure 5: the matches that GMS keeps on one small pair, correct and wrong ones."""
    rng = np.random.default_rng(seed)
    warp = 8.0, 0.03, 15.0
    pair = next(real_pairs(rng, *warp), None) or next(simulated_pairs(rng, 1, *warp))
    images = [as_image(image, nodata=pair.nodata) for image in (pair.reference, pair.secondary)]
    drawn, places = axes(3, 2, (12, 10.5))
    correct: dict[str, float] = {}
    for place, name, letter in zip(places.ravel(), METHODS, "abcdef", strict=True):
        made = featreg.match(
            *images, method=f"{name}-paper" if paper else name, filters=["gms", "fsc"], locate=False, refine=False,
            seed=seed,
        )  # fmt: skip
        rows = np.flatnonzero(stage_mask(made, "gms"))
        here, there = made.matches.reference_xy[rows], made.matches.secondary_xy[rows]
        good = match_errors(here, there, pair.truth) <= 1.5
        correct[name] = int(good.sum())
        both = np.hstack([display(image) for image in images])
        place.imshow(both, cmap="gray", interpolation="none")
        title = f"({letter}) {made.provenance['method']}: NM {len(rows)}, NCM {int(good.sum())}"
        place.set(xticks=[], yticks=[], title=title)
        some = np.unique(np.linspace(0, len(rows) - 1, min(DRAWN, len(rows))).astype(int))
        offset = np.array([images[0].shape[1], 0])
        for k in some:
            place.plot(*np.stack([here[k], there[k] + offset]).T, color="lime" if good[k] else "red", linewidth=0.4)
    return Figure.of(
        "Figure 5", f"Matches of six methods on a small pair, {'as published' if paper else 'our forms'}",
        f"{pair.name}, the second date warped by a known affine; 5000 features, GMS; {DRAWN} of the matches, those "
        "within 1.5 px of the truth green.",
        "The paper draws one block of Im1 and Im2, with NCM 69 (BFSIFT) to 102 (M-GOF) and 78 for its own: the order "
        f"of its rows can be compared, its numbers cannot. Here, NCM: {ranked(correct)}.",
        drawn,
    )  # fmt: skip


def figures(folder: Path, seed: int) -> list[Figure]:
    return [overlap(folder, seed), six_methods(seed, paper=True), six_methods(seed, paper=False)]
