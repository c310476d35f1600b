"""The cells of a displacement field and what is said of each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from featreg.types import FloatArray, IntArray


class Reason(IntEnum):
    """Why a cell has no displacement that can be used; `GOOD` where it has."""

    GOOD = 0
    MASKED = 1
    NO_PEAK = 2
    AMBIGUOUS = 3
    OUTSIDE = 4
    OUTLIER = 5


#: What each reason means, in words.
MEANINGS = {
    Reason.GOOD: "good",
    Reason.MASKED: "the window holds pixels without data in one of the images",
    Reason.NO_PEAK: "no peak of the correlation that chance would not make",
    Reason.AMBIGUOUS: "two peaks of the correlation that cannot be told apart",
    Reason.OUTSIDE: "the window leaves one of the images, or the displacement the search range",
    Reason.OUTLIER: "the displacement disagrees with those of the neighbours",
}


@dataclass(frozen=True)
class CellGrid:
    """Cells of `step` x `step` pixels that cover an image, with a window about the middle of each.

    Parameters
    ----------
    shape : (H, W) of the image, or of a part of it that begins at a multiple of `step`
    step : side of a cell, px
    window : side of the windows, px
    """

    shape: tuple[int, int]
    step: int
    window: int

    @property
    def cells(self) -> tuple[int, int]:
        """(rows, cols) of the cells whose middle lies in the image."""
        rows, cols = ((2 * n - 1 + self.step) // (2 * self.step) for n in self.shape)
        return max(rows, 1), max(cols, 1)

    @property
    def first(self) -> int:
        """First row, and first column, of the window of the first cell."""
        return (self.step - self.window) // 2

    @property
    def tops(self) -> IntArray:
        """(rows,) first row of each window."""
        return self.first + self.step * np.arange(self.cells[0])

    @property
    def lefts(self) -> IntArray:
        """(cols,) first column of each window."""
        return self.first + self.step * np.arange(self.cells[1])

    @property
    def x(self) -> FloatArray:
        """(cols,) px, middle of the windows."""
        return np.asarray(self.lefts + (self.window - 1) / 2, np.float64)

    @property
    def y(self) -> FloatArray:
        """(rows,) px, middle of the windows."""
        return np.asarray(self.tops + (self.window - 1) / 2, np.float64)
