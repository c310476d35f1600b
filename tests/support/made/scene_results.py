"""Results of the scene that the fixture `located_pair` writes, matched in blocks."""

from __future__ import annotations

from typing import Any

import numpy as np

from featreg.results.registration import Registration
from featreg.types import FloatArray
from made.models import grid_rmse

#: Keywords of `featreg.match`.
BLOCK: dict[str, Any] = {"block": 200, "workers": 1}
WIDTH, HEIGHT = 800, 700


def scene_error(result: Registration, truth: FloatArray) -> float:
    """RMS distance in pixels of the model from the truth over the image."""
    return grid_rmse(result, truth, (WIDTH, HEIGHT))


def same_bits(a: Registration, b: Registration) -> bool:
    """Whether two results are equal to the last bit, times aside."""
    assert a.model
    assert b.model
    pairs = [
        (getattr(a.matches, name), getattr(b.matches, name))
        for name in ("reference_xy", "secondary_xy", "score", "covariance", "origin", "rotation", "scale_ratio")
    ]
    pairs += [(a.inliers, b.inliers), *((a.stages[name], b.stages[name]) for name in a.stages)]
    pairs += [(a.provenance["tie_point_blocks"], b.provenance["tie_point_blocks"])]
    equal = all(x is y is None or np.array_equal(x, y, equal_nan=True) for x, y in pairs)
    tables = a.provenance["block_table"] == b.provenance["block_table"]
    return equal and tables and repr(a.model.parameters) == repr(b.model.parameters) and a.gates == b.gates
