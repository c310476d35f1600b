"""A folder of pairs, for experiments made in Python and by the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from featreg import Experiment
from featreg.io.writers import write_geotiff
from featreg.simulate import sar_pair
from featreg.study.image_pairs import pairs_in


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
