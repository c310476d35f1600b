"""Images of unlike size or form in pieces: which parts of two images are searched against each other.

A search reduces the longer side to a few samples. Of a strip, or of a scene that holds a small image somewhere, too
little is left of what both show; squares that overlap by half are as good as images of their size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from featreg.sar.orientation.search import NEAR, Alignment
from featreg.sar.orientation.verification import Verified
from featreg.types import FloatArray, Image

#: Images are cut where a side is longer than the shortest side of both by more than this factor.
LONG = 2.2
#: Side of a piece as a multiple of that shortest side, the factor by which it grows where there would be too many pairs
#: of pieces, and how many are too many.
SIDE, LARGER, MOST_PAIRS = 2.0, 1.25, 100
#: Pixels around the part of an image that the other covers.
MARGIN = 32


@dataclass(frozen=True, eq=False)
class Piece:
    """A rectangle of an image; `corner` is the (x, y) of its first pixel there."""

    image: Image
    corner: tuple[int, int] = (0, 0)

    @property
    def middle(self) -> FloatArray:
        """(x, y) in the image."""
        return np.array(self.corner) + np.array(self.image.shape[::-1]) / 2


def pairs_of_pieces(reference: Image, secondary: Image) -> list[tuple[Piece, Piece]]:
    """Return what to search of two images beside the whole ones; empty where these are of like size and form.

    Those come first that lie alike in both.
    """
    shortest = min(*reference.shape, *secondary.shape)
    cut = [max(image.shape) > LONG * shortest for image in (reference, secondary)]
    if not any(cut):
        return []
    side = SIDE * shortest
    while True:
        corners = [
            list(_corners(image.shape, side)) if long else [(0, 0, *image.shape)]
            for image, long in zip((reference, secondary), cut, strict=True)
        ]
        if len(corners[0]) * len(corners[1]) <= MOST_PAIRS:
            break
        side *= LARGER
    first, second = (
        [_piece(image, *one) for one in some] for image, some in zip((reference, secondary), corners, strict=True)
    )
    pairs = [(one, other) for one in first for other in second]

    def away(pair: tuple[Piece, Piece]) -> float:
        here, there = (
            part.middle / image.shape[::-1] for part, image in zip(pair, (reference, secondary), strict=True)
        )
        return float(np.hypot(*(here - there)))

    return sorted(pairs, key=away)


def _corners(shape: tuple[int, int], side: float) -> Iterator[tuple[int, int, int, int]]:
    """(y, x, height, width) of pieces that overlap by half at least."""
    size = [min(n, round(side)) for n in shape]
    count = [1 + math.ceil((n - s) / (s / 2) - 1e-9) for n, s in zip(shape, size, strict=True)]
    down, across = (
        np.rint(np.linspace(0, n - s, k)).astype(int).tolist() for n, s, k in zip(shape, size, count, strict=True)
    )
    for y in down:
        for x in across:
            yield y, x, size[0], size[1]


def _piece(image: Image, y: int, x: int, height: int, width: int) -> Piece:
    if (height, width) == image.shape:
        return Piece(image)
    part = np.s_[y : y + height, x : x + width]
    filled = None if image.filled is None else image.filled[part]
    return Piece(
        replace(image, pixels=image.pixels[part], mask=image.mask[part], filled=filled, geolocation=None), (x, y)
    )


def in_whole(alignment: Alignment, first: Piece, second: Piece) -> Alignment:
    """The alignment of two pieces as one of the images from which they are."""
    linear = alignment.affine[:, :2]
    shift = alignment.affine[:, 2] + np.array(second.corner) - linear @ np.array(first.corner)
    return replace(alignment, affine=np.column_stack([linear, shift]))


def distinct_of_pieces(found: Sequence[tuple[Verified, Piece]]) -> list[Verified]:
    """Alignments of whole images that differ where they were found, best first.

    `found` holds each with the piece of the reference in which it was. Pieces overlap, so that one alignment found in
    several counts once.
    """
    kept: list[tuple[Verified, Piece]] = []
    for one, piece in sorted(found, key=lambda entry: entry[0].log10_chance):
        if not any(_alike(one.alignment, other.alignment, place) for other, where in kept for place in (piece, where)):
            kept.append((one, piece))
    return [one for one, _ in kept]


def settled(found: Sequence[tuple[Verified, Piece]], chance: float) -> bool:
    """Whether the best alignment is less likely by chance, as log10, and so again in a piece that does not overlap."""
    if not found:
        return False
    best, where = min(found, key=lambda entry: entry[0].answer)
    return best.answer <= chance and any(
        other.answer <= chance and _separate(where, piece) and _alike(best.alignment, other.alignment, where)
        for other, piece in found
    )


def _separate(one: Piece, other: Piece) -> bool:
    """Whether two pieces of an image, of one size, do not overlap."""
    apart = np.abs(np.array(one.corner) - np.array(other.corner))
    return bool((apart >= one.image.shape[::-1]).any())


def _alike(one: Alignment, other: Alignment, piece: Piece) -> bool:
    """Whether two alignments agree over a piece of the reference."""
    here = [replace(alignment, affine=in_part(alignment.affine, piece)) for alignment in (one, other)]
    return here[0].alike(here[1], piece.image.shape, NEAR)


def in_part(affine: FloatArray, piece: Piece) -> FloatArray:
    """The map (2, 3) of an image for points that are counted from a piece of it."""
    return np.column_stack([affine[:, :2], affine[:, 2] + affine[:, :2] @ np.array(piece.corner)])


def shared_part(reference: Image, secondary: Image, affine: FloatArray, around: float = 0.0) -> Piece:
    """The part of the reference onto which an affine map (2, 3) takes the secondary, and so many pixels around it.

    The whole reference where that is about as large.
    """
    height, width = secondary.shape
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], np.float64) - 0.5
    there = (corners - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T
    limit = np.array(reference.shape[::-1])
    low = np.clip(np.floor(there.min(axis=0) - around - MARGIN), 0, limit).astype(int)
    high = np.clip(np.ceil(there.max(axis=0) + around + MARGIN), 0, limit).astype(int)
    size = high - low
    if min(size) < 1 or np.prod(size) > 0.5 * np.prod(limit):
        return Piece(reference)
    return _piece(reference, int(low[1]), int(low[0]), int(size[1]), int(size[0]))
