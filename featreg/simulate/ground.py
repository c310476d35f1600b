"""The ground of a simulated scene: a plane of blocks, each a landscape of its own, made when it is looked at."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.simulate.pairs import gamma_field, painted
from featreg.types import FloatArray

#: Ground pixels along each side of a block.
SIDE = 768


@dataclass(frozen=True, eq=False)
class Block:
    """Mean backscatter (SIDE, SIDE) float32, and the point targets on it: places in ground pixels, amplitudes."""

    backscatter: NDArray[np.float32]
    targets: FloatArray
    amplitude: NDArray[np.complex128]


class Ground:
    """An endless plane of ground pixels (u, v), the centre of one at (0, 0); the last `kept` blocks stay in memory.

    Parameters
    ----------
    seed : of the landscapes
    date : 0 or 1; some fields, houses and targets differ between the dates
    change : share of those that differ
    kept : blocks
    """

    def __init__(self, seed: int, date: int, change: float, kept: int) -> None:
        self.seed, self.date, self.change, self.kept = seed, date, change, kept
        self._blocks: OrderedDict[tuple[int, int], Block] = OrderedDict()

    def canvas(self, u0: int, v0: int, width: int, height: int) -> NDArray[np.float32]:
        """Return the backscatter (height, width) of the ground pixels from (u0, v0) on."""
        out = np.empty((height, width), np.float32)
        for i in range(u0 // SIDE, (u0 + width - 1) // SIDE + 1):
            for j in range(v0 // SIDE, (v0 + height - 1) // SIDE + 1):
                left, top = max(u0, i * SIDE), max(v0, j * SIDE)
                right, bottom = min(u0 + width, (i + 1) * SIDE), min(v0 + height, (j + 1) * SIDE)
                part = self.block(i, j).backscatter[
                    top - j * SIDE : bottom - j * SIDE, left - i * SIDE : right - i * SIDE
                ]
                out[top - v0 : bottom - v0, left - u0 : right - u0] = part
        return out

    def targets(self, u0: int, v0: int, width: int, height: int) -> tuple[FloatArray, NDArray[np.complex128]]:
        """Return the places (N, 2) and complex amplitudes (N,) of the point targets of every block touched."""
        found = [
            self.block(i, j)
            for i in range(u0 // SIDE, (u0 + width - 1) // SIDE + 1)
            for j in range(v0 // SIDE, (v0 + height - 1) // SIDE + 1)
        ]
        return np.concatenate([b.targets for b in found]), np.concatenate([b.amplitude for b in found])

    def block(self, i: int, j: int) -> Block:
        """Return the block whose first ground pixel is (i * SIDE, j * SIDE)."""
        found = self._blocks.pop((i, j), None)
        if found is None:
            found = self._made(i, j)
        self._blocks[i, j] = found
        while len(self._blocks) > self.kept:
            self._blocks.popitem(last=False)
        return found

    def _made(self, i: int, j: int) -> Block:
        from featreg.simulate.scenery import countryside

        # Block numbers may be negative, seeds may not.
        layout, texture = np.random.default_rng([self.seed, i + (1 << 20), j + (1 << 20)]).spawn(2)
        shape = (SIDE, SIDE)
        land = countryside(shape, SIDE / 2, self.change, layout)
        seen = [(s.outline, s) for s in land.surfaces if not math.isnan(s.backscatter[self.date])]
        paint = painted(seen, shape, self.date)
        coarse, fine = gamma_field(SIDE, 5.0, 3, texture), gamma_field(SIDE, 1.2, 2, texture)
        backscatter = paint[..., 0] * (1 + paint[..., 1] * (coarse - 1)) * (1 + paint[..., 2] * (fine - 1))
        there = (land.amplitude[:, self.date] > 0) & ((land.xy > 0) & (land.xy < SIDE - 1)).all(axis=1)
        amplitude = land.amplitude[there, self.date] * np.exp(1j * land.phase[there])
        return Block(backscatter, land.xy[there] + [i * SIDE, j * SIDE], amplitude)
