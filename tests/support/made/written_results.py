"""A registration that has all that a result may have."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from featreg.geometry import Affine
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Gate, Matches


def registration(count: int = 60, refined: int = 15, seed: int = 3, **changes: Any) -> Registration:
    """A result as a pipeline makes it: two filters, then refinement, whose points are appended."""
    rng = np.random.default_rng(seed)
    model = Affine(np.array([[1.01, 0.02, 3.3], [-0.02, 0.99, -7.1]]))
    first = rng.uniform(0, 500, (count, 2))
    start = Matches(
        first,
        model(first) + rng.normal(0, 0.4, (count, 2)),
        rng.uniform(0, 1, count),
        rotation=rng.uniform(-1, 1, count),
        scale_ratio=rng.uniform(0.5, 2, count),
    )
    origin = np.arange(refined)
    again = Matches(
        first[origin] + 0.1,
        model(first[origin] + 0.1),
        rng.uniform(0, 1, refined),
        np.tile(np.array([[0.01, 0.002], [0.002, 0.03]]), (refined, 1, 1)) * rng.uniform(1, 2, (refined, 1, 1)),
        origin,
    )
    new = np.arange(count + refined) >= count
    gms = (rng.uniform(size=count + refined) < 0.7) & ~new
    fsc = gms & (rng.uniform(size=count + refined) < 0.8)
    refine = new & (rng.uniform(size=count + refined) < 0.9)
    made = Registration(
        start.appended(again),
        {"gms": gms, "fsc": fsc, "refine": refine},
        refine,
        model,
        "ok",
        gates={"count": Gate(15.0, low=8.0, meaning="tie points"), "spread": Gate(None)},
        timings={"detect": 0.125, "match": 0.5},
        provenance={
            "method": "sar-orb",
            "seed": 7,
            "parameters": {"n_features": 5000},
        },
        reference=InputImage("a.tif", (500, 512)),
        secondary=InputImage("b.tif", (499, 511)),
    )
    return replace(made, **changes)
