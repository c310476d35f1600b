"""Results of the scene that the fixture `located_pair` writes, matched in blocks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import featreg
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


def undisturbed_text(result: Registration) -> str:
    """Everything that must not depend on how the work was interrupted, as text."""
    from featreg.results.json_file import registration_to_dict

    whole = registration_to_dict(result)
    provenance = {k: v for k, v in whole["provenance"].items() if k not in ("blocks", "block_seconds")}
    return json.dumps({**whole, "provenance": provenance, "blocks": None, "timings": None}, sort_keys=True)


def again(located_pair: Any, folder: Path, **keywords: Any) -> Registration:
    return featreg.match(located_pair.reference, located_pair.secondary, **{**BLOCK, **keywords}, resume=folder)


def copied(source: Path, target: Path) -> list[Path]:
    target.mkdir()
    for file in source.iterdir():
        (target / file.name).write_bytes(file.read_bytes())
    return sorted(target.iterdir())
