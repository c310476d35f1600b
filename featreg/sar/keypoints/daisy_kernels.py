"""Compiled loops of DAISY descriptors: harmonics of a gradient field in blocks, and what Gaussians gather of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, inlined
from featreg.sar.keypoints.unit_kernels import LANES, unit_lanes

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

#: Numbers of a cell: the length, and cosine and sine of the direction and of its double.
PARTS = 5


@compiled
def _add_harmonics(gx: F32, gy: F32, length: F32, along: F32, up: F32, cosine: F32, sine: F32) -> None:
    for i in range(gx.shape[0]):
        x, y = gx[i], -gy[i]
        size = np.sqrt(x * x + y * y)
        inverse = np.float32(1) / (size if size > np.float32(1e-30) else np.float32(1e-30))
        length[i] += size
        along[i] += x
        up[i] += y
        cosine[i] += (x * x - y * y) * inverse
        sine[i] += np.float32(2) * x * y * inverse


@compiled
def _halved(row: F32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] = row[2 * i] + row[2 * i + 1]


@compiled
def _copied(row: F32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] = row[i]


@compiled
def _added(row: F32, weight: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] += weight * row[i]


@compiled
def _in_blocks(sums: F32, block: int, weight: np.float32, half: F32, out: F32, row: int) -> None:
    """Add sums of `block` neighbours of rows (5, W), of which nothing stays, to a row of `out`."""
    for n in range(PARTS):
        side, wide = block, sums.shape[1]
        while side > 1:
            wide //= 2
            _halved(sums[n, : 2 * wide], half[:wide])
            _copied(half[:wide], sums[n, :wide])
            side //= 2
        _added(sums[n, :wide], weight, out[n, row])


@compiled
def add_binned(gx: F32, gy: F32, block: int, corners: I64, weight: np.float32, out: F32) -> None:
    """Add weighted sums over blocks of a gradient field (H, W), y down, to `out` (5, M * R, C): windows on each other.

    They are of its length, and of its length times cosine and sine of its direction (counter-clockwise as seen) and of
    twice that, over `block` x `block` pixels, a power of two. Each window begins with the block (x, y) named by
    `corners` (M, 2), which may lie outside of the field, where there is no gradient.
    """
    height, width = gx.shape
    rows, wide = out.shape[1] // corners.shape[0], out.shape[2] * block
    sums, half = np.empty((PARTS, wide), np.float32), np.empty(max(wide // 2, 1), np.float32)
    for m in range(corners.shape[0]):
        left, top = corners[m, 0] * block, corners[m, 1] * block
        start, stop = min(max(left, 0), width), min(max(left + wide, 0), width)
        i, j = start - left, stop - left
        for row in range(rows if stop > start else 0):
            first, last = max(top + row * block, 0), min(top + (row + 1) * block, height)
            if last <= first:
                continue
            for n in range(PARTS):
                sums[n] = np.float32(0)
            for y in range(first, last):
                _add_harmonics(
                    gx[y, start:stop], gy[y, start:stop],
                    sums[0, i:j], sums[1, i:j], sums[2, i:j], sums[3, i:j], sums[4, i:j],
                )  # fmt: skip
            _in_blocks(sums, block, weight, half, out, m * rows + row)


@compiled
def _places(
    x0: np.float32, y0: np.float32, along: np.float32, up: np.float32, right: np.float32, bottom: np.float32,
    width: np.int32, cells: F32, place: I32, u: F32, v: F32,
) -> None:  # fmt: skip
    """Where the turned cells lie in a map: the flat place before each, and how far it lies beyond along x and y."""
    zero, one = np.float32(0), np.float32(1)
    for k in range(place.shape[0]):
        x = x0 + along * cells[0, k] - up * cells[1, k]
        y = y0 - up * cells[0, k] - along * cells[1, k]
        x, y = x if x > zero else zero, y if y > zero else zero
        x, y = x if x < right else right, y if y < bottom else bottom
        left, top = np.floor(x), np.floor(y)
        left, top = left if left < right - one else right - one, top if top < bottom - one else bottom - one
        u[k], v[k] = x - left, y - top
        place[k] = np.int32(top) * width + np.int32(left)


@inlined
def _between(
    pool: F32, k: np.uint64, below: np.uint64, a: np.float32, b: np.float32, c: np.float32, d: np.float32
) -> np.float32:
    return np.float32((a * pool[k] + b * pool[k + np.uint64(1)]) + (c * pool[below] + d * pool[below + np.uint64(1)]))


@compiled
def _looked_up(
    pool: F32, size: np.uint64, width: np.uint64, place: I32, u: F32, v: F32, c1: np.float32, s1: np.float32,
    c2: np.float32, s2: np.float32, weight: F32, vectors: F32, lane: int,
) -> None:  # fmt: skip
    """Read five maps of a size linearly at each cell; (c1, s1), (c2, s2) are the angle that is taken off, and twice it.

    The cells are the columns of what fills one column of `vectors`.
    """
    count, i = np.uint64(place.shape[0]), np.uint64(lane)
    one = np.float32(1)
    w0, w1, w2 = weight[0], weight[1], weight[3]
    for j in range(place.shape[0]):
        at = np.uint64(j)
        p, q = u[at], v[at]
        a, b, c, d = (one - p) * (one - q), p * (one - q), (one - p) * q, p * q
        k = np.uint64(place[at])
        length = _between(pool, k, k + width, a, b, c, d)
        k += size
        along = _between(pool, k, k + width, a, b, c, d)
        k += size
        up = _between(pool, k, k + width, a, b, c, d)
        k += size
        cosine = _between(pool, k, k + width, a, b, c, d)
        k += size
        sine = _between(pool, k, k + width, a, b, c, d)
        vectors[at, i] = w0 * length
        vectors[at + count, i] = w1 * (c1 * along + s1 * up)
        vectors[at + np.uint64(2) * count, i] = w1 * (c1 * up - s1 * along)
        vectors[at + np.uint64(3) * count, i] = w2 * (c2 * cosine + s2 * sine)
        vectors[at + np.uint64(4) * count, i] = w2 * (c2 * sine - s2 * cosine)


@compiled
def sampled(
    pool: F32, height: int, width: int, rows: I64, xy: F64, radius: F64, angle: F64, cells: F32, weight: F32,
    clip: np.float32, out: F32,
) -> None:  # fmt: skip
    """Write unit vectors of what is pooled at K cells around each of M points to rows `rows` (M,) of `out` (N, 5 * K).

    Parameters
    ----------
    pool : (5 * height * width,) what `add_binned` gives, smoothed, read linearly between four places
    xy : (M, 2) points, and `radius` (M,), in blocks from the middle of the first one on
    angle : (M,) by which the cells turn, and from which directions count
    cells : (2, K) in units of the radius, y up
    weight : (5,) of the numbers of a cell
    clip : as of `unit_kernels.unit_cells`
    """
    count = cells.shape[1]
    place, u, v = np.empty(count, np.int32), np.empty(count, np.float32), np.empty(count, np.float32)
    vectors, squares = np.zeros((PARTS * count, LANES), np.float32), np.empty((count, LANES), np.float32)
    total, inverse = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    for start in range(0, xy.shape[0], LANES):
        lanes = min(LANES, xy.shape[0] - start)
        for lane in range(lanes):
            i = start + lane
            turn = angle[i] % (2 * np.pi)
            c1, s1 = np.float32(np.cos(turn)), np.float32(np.sin(turn))
            c2, s2 = c1 * c1 - s1 * s1, np.float32(2) * c1 * s1
            along, up = np.float32(radius[i]) * c1, np.float32(radius[i]) * s1
            x0, y0 = np.float32(xy[i, 0]), np.float32(xy[i, 1])
            _places(x0, y0, along, up, right, bottom, np.int32(width), cells, place, u, v)
            _looked_up(
                pool, np.uint64(height * width), np.uint64(width), place, u, v, c1, s1, c2, s2, weight, vectors, lane
            )
        unit_lanes(vectors, squares, total, inverse, clip)
        for lane in range(lanes):
            row = rows[start + lane]
            for k in range(vectors.shape[0]):
                out[row, k] = vectors[k, lane]
