"""A registration of which every third match is false."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from featreg.geometry import Affine
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Matches

TRUTH = Affine(np.array([[1.0, -0.03, 5.0], [0.04, 1.01, -3.0]]))


def registration(count: int = 60, seed: int = 0, size: tuple[int, int] = (120, 100), **change: Any) -> Registration:
    """Every third match is false; the filter "gms" drops every second of those, "ransac" all of them."""
    rng = np.random.default_rng(seed)
    reference = rng.uniform(0, np.array(size) - 1, (count, 2))
    secondary = TRUTH(reference) + rng.normal(0, 0.2, (count, 2))
    row = np.arange(count)
    false = row % 3 == 2
    secondary[false] += 30
    stages = {"gms": ~(row % 6 == 5), "ransac": ~false}
    matches = Matches(reference, secondary, rng.random(count))
    image = InputImage("array", size[::-1])
    made = Registration(matches, stages, ~false, TRUTH, "ok", timings={"detect": 0.1, "match": 0.2}, reference=image)
    return replace(made, **change)
