"""Tie points of which a part is good, and what the gates say of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from featreg.geometry import Affine
from featreg.interfaces import FailedFit, Model
from featreg.pipeline.trust import Evidence, Limits, assess
from featreg.types import BoolArray, Gate, Matches

SHAPE = (600, 500)
MATRIX = np.array([[1.02, 0.05, 7.0], [-0.05, 1.01, -4.0]])


def tie_points(good: int = 300, bad: int = 300, noise: float = 0.3, matrix: Any = MATRIX) -> tuple[Matches, BoolArray]:
    rng = np.random.default_rng(0)
    here = rng.uniform(0, 1, (good + bad, 2)) * (SHAPE[1], SHAPE[0])
    there = here @ np.asarray(matrix)[:, :2].T + np.asarray(matrix)[:, 2] + rng.normal(0, noise, here.shape)
    there[good:] = rng.uniform(0, 1, (bad, 2)) * (SHAPE[1], SHAPE[0])
    return Matches(here, there, np.ones(good + bad)), np.arange(good + bad) < good


def judge(
    matches: Matches, inliers: BoolArray, limits: Limits | None = None, **more: Any
) -> tuple[str, str, Mapping[str, Gate]]:
    fitted = Affine.from_estimate(matches.reference_xy[inliers], matches.secondary_xy[inliers])
    model: Model | FailedFit = more.pop("model", fitted)
    every = np.ones(len(matches), np.bool_)
    return assess(Evidence(matches, every, inliers, inliers, model, SHAPE, SHAPE, **more), limits or Limits())
