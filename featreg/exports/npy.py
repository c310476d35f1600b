"""NumPy array (``.npy``): (M, 4) reference x, y, secondary x, y in featreg's own pixels; only read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from featreg.exports.columns import matches_of_array
from featreg.types import Matches


def read(path: Path) -> Matches:
    """Read the array."""
    return matches_of_array(np.load(path, allow_pickle=False))
