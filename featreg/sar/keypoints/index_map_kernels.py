"""Compiled loops of the maximum index map's descriptor: votes of blocks, cells gathered around points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]
I32 = NDArray[np.int32]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@compiled
def _vote_row(index: U8, weight: U8, vote: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = np.float32(weight[x]) * vote[index[x]]


@compiled
def _add_vote_row(index: U8, weight: U8, vote: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] += np.float32(weight[x]) * vote[index[x]]


@compiled
def _pair_sums(row: F32, out: F32) -> None:
    for x in range(row.shape[0] // 2):
        out[x] = row[2 * x] + row[2 * x + 1]
    if row.shape[0] % 2:
        out[out.shape[0] - 1] = row[row.shape[0] - 1]


@compiled
def block_votes(index: U8, weight: U8, votes: F32, blocks: F32) -> None:
    """Fill the (lanes, (H + 1) // 2, (W + 1) // 2) sums over blocks of 2 x 2 pixels of what `votes` makes of them.

    `votes` (lanes, steps) gives the share of each lane in a value of the (H, W) `index`, times its `weight`. Blocks
    are cut at the border.
    """
    height, width = index.shape
    row = np.empty(width, np.float32)
    for k in range(votes.shape[0]):
        for y in range(0, height, 2):
            _vote_row(index[y], weight[y], votes[k], row)
            if y + 1 < height:
                _add_vote_row(index[y + 1], weight[y + 1], votes[k], row)
            _pair_sums(row, blocks[k, y // 2])


@compiled
def _places(
    across: F32, down: F32, x: np.float32, y: np.float32, cosine: np.float32, sine: np.float32,
    width: np.int32, height: np.int32, place: I32,
) -> None:  # fmt: skip
    for c in range(place.shape[0]):
        column = np.int32(np.floor(x + cosine * across[c] + sine * down[c]))
        row = np.int32(np.floor(y - sine * across[c] + cosine * down[c]))
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        place[c] = row * width + column if inside else width * height


@compiled
def place_cells(xy: F64, angle: F64, across: F32, down: F32, shift: float, height: int, width: int, place: I32) -> None:
    """Fill (N, cells) with the row of a map's list that each cell of each point falls on, the last where it has none.

    The (height, width) map has a cell for every second pixel, the first for pixel `shift`, and one more for what lies
    outside. `across`, `down` (cells,) are offsets in pixels, turned by the points' (N,) angles, counter-clockwise as
    seen.
    """
    for i in range(xy.shape[0]):
        cosine, sine = np.float32(np.cos(angle[i]) / 2), np.float32(np.sin(angle[i]) / 2)
        # In units of the map, a half added so that the whole part is the nearest cell.
        x, y = np.float32((xy[i, 0] - shift + 1) / 2), np.float32((xy[i, 1] - shift + 1) / 2)
        _places(across, down, x, y, cosine, sine, np.int32(width), np.int32(height), place[i])


@compiled
def gather_turned(cells: F32, place: I32, angle: F64, out: F32, known: F32) -> None:
    """Fill (N, 3 * cells) with the cells' means, then the two halves of their harmonics, turned by the (N,) angle.

    `cells` is the flat list of (mean, even, odd, 1 or 0 for whether they are known), 0 where they are not; `known` (N,)
    becomes the share of known ones.
    """
    count = place.shape[1]
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    for i in range(place.shape[0]):
        cosine, sine = np.float32(np.cos(2 * angle[i])), np.float32(np.sin(2 * angle[i]))
        row, here, seen = out[i], place[i], np.float32(0)
        for c in range(count):
            k = np.uint64(4) * np.uint64(here[c])
            even, odd = cells[k + one], cells[k + two]
            row[c] = cells[k]
            row[count + c] = even * cosine - odd * sine
            row[2 * count + c] = even * sine + odd * cosine
            seen += cells[k + three]
        known[i] = seen / np.float32(count)


@compiled
def _squares(row: F32, lanes: F32) -> float:
    """The sum of squares, in as many partial sums as there are lanes."""
    lanes[:] = 0
    whole = row.shape[0] // lanes.shape[0] * lanes.shape[0]
    for start in range(0, whole, lanes.shape[0]):
        _add_squares(row[start : start + lanes.shape[0]], lanes)
    total = 0.0
    for lane in lanes:
        total += lane
    for x in range(whole, row.shape[0]):
        total += row[x] * row[x]
    return total


@compiled
def _add_squares(part: F32, lanes: F32) -> None:
    for x in range(lanes.shape[0]):
        lanes[x] += part[x] * part[x]


@compiled
def _above(row: F32, limit: np.float32, out: U8) -> None:
    for x in range(row.shape[0]):
        out[x] = np.uint8(row[x] > limit)


@compiled
def _packed(eights: U64, out: U8) -> None:
    """Bytes of 0 and 1, eight at a time, become the bits of one, the first the highest."""
    for x in range(out.shape[0]):
        out[x] = np.uint8((eights[x] * np.uint64(0x8040201008040201)) >> np.uint64(56))


@compiled
def level_bits(triples: F32, known: F32, limits: F32, bits: U8) -> None:
    """Fill `bits` (N, bytes) with whether the numbers (N, 3 * cells) lie above each of the (L,) `limits`.

    Limits are in units of the standard deviation around 0, one of the first third of a row, the means, and one of both
    halves of the harmonics, over the `known` (N,) share of the cells. Bits run through a row for each limit in turn.
    """
    cells = triples.shape[1] // 3
    lanes = np.empty(32, np.float32)
    ones = np.zeros(8 * bits.shape[1], np.uint8)
    eights = ones.view(np.uint64)
    for i in range(triples.shape[0]):
        row = triples[i]
        count = cells * max(known[i], np.float32(1e-6))
        mean = np.float32(np.sqrt(_squares(row[:cells], lanes) / count))
        harmonic = np.float32(np.sqrt(_squares(row[cells:], lanes) / (2 * count)))
        for k in range(limits.shape[0]):
            first = 3 * cells * k
            _above(row[:cells], limits[k] * mean, ones[first : first + cells])
            _above(row[cells:], limits[k] * harmonic, ones[first + cells : first + 3 * cells])
        _packed(eights, bits[i])
