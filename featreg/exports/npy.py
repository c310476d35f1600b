"""NumPy array (``.npy``): (M, 4) reference x, y, secondary x, y in featreg's own pixels; only read."""

from __future__ import annotations

from pathlib import Path

from featreg.exports.columns import matches_of_array
from featreg.runtime.numpy_files import load_array
from featreg.types import Matches


def read(path: Path) -> Matches:
    """Read the array."""
    return matches_of_array(load_array(path))
