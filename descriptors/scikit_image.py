"""Descriptors of scikit-image, one row of a table each: BRIEF and DAISY, upright, of any detector's points.

Names and defaults of the parameters are scikit-image's, with one exception: its dense DAISY is computed in strips of
the image at every pixel, and read at the pixel nearest to each point, so that `step` has no use. Points whose patch
leaves the image are dropped, by scikit-image's own rule (BRIEF) or where the circle of `radius` does (DAISY).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from annotated_types import Ge, Interval

from featreg.interfaces import Descriptor
from featreg.interop.family import Member, option, register_table
from featreg.interop.opencv import MIN_SIDE, inside
from featreg.interop.scikit_image import SkimageRow, picture, to_rows
from featreg.types import Features, FloatArray, Image, IntArray

# Pixels described at once by DAISY, so that memory stays bounded: 200 numbers each.
STRIP = 40_000


def _brief(image: FloatArray, xy: FloatArray, values: Mapping[str, Any]) -> tuple[IntArray, Any]:
    from skimage.feature import BRIEF

    brief = BRIEF(
        descriptor_size=values["descriptor_size"],
        patch_size=values["patch_size"],
        mode=values["mode"],
        sigma=values["sigma"],
        rng=values["seed"],
    )
    brief.extract(image, to_rows(np.rint(xy)))
    return np.flatnonzero(brief.mask), np.packbits(np.asarray(brief.descriptors, np.bool_), axis=1)


def _daisy(image: FloatArray, xy: FloatArray, values: Mapping[str, Any]) -> tuple[IntArray, Any]:
    from skimage.feature import daisy

    names = ("radius", "rings", "histograms", "orientations", "normalization")
    keywords = {key: values[key] for key in names}
    height, width = image.shape
    radius = values["radius"]
    rim = _daisy_reach(radius)
    strip = max(STRIP // width, 8)
    column, row = np.rint(xy).astype(np.int64).T
    within = (column >= radius) & (column < width - radius) & (row >= radius) & (row < height - radius)
    length = (values["rings"] * values["histograms"] + 1) * values["orientations"]
    table = np.zeros((len(xy), length), np.float32)
    pixels = image.astype(np.float32)
    for top in range(radius, height - radius, strip):
        at = np.flatnonzero(within & (row >= top) & (row < top + strip))
        if len(at):
            first, last = max(top - rim, 0), min(top + strip + rim, height)
            dense = daisy(pixels[first:last], step=1, **keywords)
            table[at] = dense[row[at] - first - radius, column[at] - radius]
    return np.flatnonzero(within), table[within]


def _daisy_reach(radius: int) -> int:
    """Beyond the outermost ring its Gaussian, of half the radius, reaches four sigmas; a pixel more for differences."""
    return 3 * radius + 2


TABLE: dict[str, SkimageRow] = {
    "skimage-brief": SkimageRow(
        "BRIEF",
        "BRIEF bits, upright, by scikit-image",
        {
            "descriptor_size": option(256, choices=(128, 256, 512), keyword="descriptor_size"),
            "patch_size": option(49, Ge(3), keyword="patch_size"),
            "mode": option("normal", choices=("normal", "uniform"), keyword="mode"),
            "sigma": option(1.0, Ge(0), keyword="sigma", meaning="of the smoothing before the comparisons, px"),
            "seed": option(1, Ge(0), meaning="of the pattern of comparisons"),
        },
        run=_brief,
    ),
    "skimage-daisy": SkimageRow(
        "daisy",
        "DAISY: gradient histograms on rings around the point, upright, by scikit-image",
        {
            "radius": option(15, Interval(ge=1, le=100), keyword="radius", meaning="of the outermost ring, px"),
            "rings": option(3, Ge(1), keyword="rings"),
            "histograms": option(8, Ge(1), keyword="histograms", meaning="on each ring"),
            "orientations": option(8, Ge(1), keyword="orientations", meaning="of each histogram"),
            "normalization": option("l1", choices=("l1", "l2", "daisy", "off"), keyword="normalization"),
        },
        run=_daisy,
    ),
}


@register_table
class SkimageDescriptor(Member, Descriptor):
    """One descriptor of scikit-image: a row of the table by name, and its parameters."""

    table = TABLE
    compiled = False

    def reach_of(self, scale: float) -> float:
        """Half the patch of BRIEF, or the radius of DAISY with its Gaussians."""
        if self.name == "skimage-daisy":
            return float(_daisy_reach(self.parameters["radius"]))
        return float(self.parameters["patch_size"])

    def describe_features(self, image: Image, features: Features) -> Features:
        """Return the features with descriptors, in the order given, without those too near the border."""
        values = self.parameters
        rows = np.flatnonzero(inside(features.xy, image.shape))
        table: Any = None
        if len(rows) and min(image.shape) >= MIN_SIDE:
            kept, table = TABLE[self.name].run(picture(image, values["normalise"]), features.xy[rows], values)
            rows = rows[kept]
        if table is None or not len(rows):
            none = features.take(np.zeros(0, np.int64))
            return replace(none, descriptors=None, index=np.zeros(0, np.int64) if len(features) else None)
        return replace(
            features.take(rows),
            descriptors=np.ascontiguousarray(table),
            norm="hamming" if table.dtype == np.uint8 else "l2",
            index=None if len(rows) == len(features) else rows,
        )
