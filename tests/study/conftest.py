"""A folder of pairs, for experiments made in Python and by the command line."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from featreg import Experiment
from featreg.errors import UnknownNameError
from featreg.interfaces import FailedFit
from featreg.io.writers import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.simulate import sar_pair
from featreg.study.image_pairs import pairs_in
from featreg.types import Matches
from made.stand_ins import ERRORS, TRUTH, Calls


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small pairs, named in pairs, with their truth."""
    home = tmp_path_factory.mktemp("pairs")
    for name, ends, seed in (("port", "_1 _2", 1), ("city", "_before _after", 2)):
        pair = sar_pair((128, 128), rotation_deg=3.0, scale=1.0, shift=(3.0, -2.0), seed=seed)
        for end, image in zip(ends.split(), (pair.reference, pair.secondary), strict=True):
            write_geotiff(home / f"{name}{end}.tif", image)
        (home / f"{name}_truth.json").write_text(json.dumps({"matrix": pair.truth.tolist()}))
    return home


def _experiment(folder: Path, **changes: Any) -> Experiment:
    given: dict[str, Any] = {
        "pairs": pairs_in(folder),
        "methods": ["orb", {"method": "orb", "label": "few", "n_features": 500}],
        "protocol": {"timing": False, "threshold": 2.0},
    }
    return Experiment(**{**given, **changes})


@pytest.fixture
def experiment() -> Callable[..., Experiment]:
    """``experiment(folder, **changes)``: two forms of one method on the pairs of a folder."""
    return _experiment


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """In place of `featreg.match` stands what knows its errors; here are its calls."""
    made = Calls()

    def match(reference: Any, secondary: Any, *, method: Any = "sharp", seed: int = 0, **keywords: Any) -> Registration:
        import cv2

        name = method if isinstance(method, str) else "sharp"
        made.append((name, cv2.getNumThreads()))
        if name == "broken":
            raise ValueError("the plugin fell over\nand this is the second line")
        if name == "unknown":
            raise UnknownNameError("unknown method 'unknown', did you mean 'sharp'?")
        errors = np.array(ERRORS.get(name, []))
        xy = np.random.default_rng(seed).uniform(0, 90, (len(errors), 2))
        good = errors < 5
        return Registration(
            Matches(xy, TRUTH(xy) + np.stack([errors, 0 * errors], axis=1), np.ones(len(xy))),
            {"gms": np.ones(len(xy), dtype=bool), "fsc": good},
            good,
            TRUTH if len(errors) else FailedFit("no tie points"),
            "ok" if len(errors) else "unreliable",
            "" if len(errors) else "no tie points",
            timings={"detect": 0.25, "match": 0.25 * len(made)},
            provenance={"method": name, "parameters": {"n_features": 5000}},
            reference=InputImage("a", (80, 100)),
        )

    module = ModuleType("featreg.matching")
    module.match = match  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "featreg.matching", module)
    return made
