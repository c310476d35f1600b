"""Which range cells an autofocus method looks at: the strongest, or those with most feature points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.focusing.pulse_spectra import STRIP, energies, run
from featreg.types import BoolArray, FloatArray, IntArray

#: Energy under which a range cell holds nothing but the rounding of its samples, relative to the strongest cell.
EMPTY = 1e-9


def cell_energies(
    image: NDArray[Any], azimuth_axis: int, mask: BoolArray | None = None, *, workers: int = 1
) -> FloatArray:
    """(K,) float64 energy of every range cell; 0 where it is empty, or where most of its samples are not data."""
    lines = image.T if azimuth_axis == 0 else image
    valid = None if mask is None else (mask.T if azimuth_axis == 0 else mask)
    energy = np.empty(len(lines))
    most = max(1, STRIP // lines.shape[1])

    def task(top: int) -> None:
        rows = slice(top, top + most)
        energy[rows] = energies(lines[rows])
        if valid is not None:
            energy[rows] *= valid[rows].mean(axis=1) > 0.5

    run(task, range(0, len(lines), most), workers)
    return np.where(energy > EMPTY * energy.max(), energy, 0.0) if energy.size else energy


def choose_cells(energy: FloatArray, fraction: float, counts: IntArray | None = None) -> IntArray:
    """Return the ascending indices of the top ``ceil(fraction K)`` range cells that are not empty.

    Parameters
    ----------
    energy : (K,) energies; 0 marks an empty cell
    fraction : of all K cells, in (0, 1]
    counts : (K,) feature points per cell, which decide before the energy; None chooses by energy alone
    """
    rank = np.lexsort((-energy,) if counts is None else (-energy, -counts))
    rank = rank[energy[rank] > 0]
    return np.sort(rank[: math.ceil(fraction * len(energy) - 1e-9)])


def count_points(xy: FloatArray, azimuth_axis: int, cells: int) -> IntArray:
    """(cells,) int64 number of (N, 2) points (x, y) in every range cell."""
    cell = np.rint(xy[:, 0 if azimuth_axis == 0 else 1]).astype(np.int64)
    return np.bincount(np.clip(cell, 0, cells - 1), minlength=cells)
