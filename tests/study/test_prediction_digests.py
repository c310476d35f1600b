"""What a cached prediction is known by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import ParameterError
from featreg.matching import keypoints_of
from featreg.simulate import SimulatedPair
from featreg.study.prediction_cache import AFTERWARDS, PredictionCache, _modules, core_files
from featreg.study.protocol import Protocol


def key(cache: PredictionCache, **keywords: Any) -> str | None:
    return cache.key("pair", (np.zeros(3),), keywords)


def test_the_digest_knows_what_decides_and_nothing_else(tmp_path: Path) -> None:
    cache = PredictionCache(tmp_path)
    plain = key(cache, method="sar-orb", seed=0)
    assert plain is not None
    same = {"workers": 3, "executor": "threads", "threads": 1, "resume": "kept", "progress": print, "scheduler": None}
    assert key(cache, method="sar-orb", seed=0, **same) == plain
    for other in ({"seed": 1}, {"block": 300}, {"height": 2.0}, {"focus": "auto"}, {"nodata": 0}, {"alpha": 2.5}):
        assert key(cache, **{"method": "sar-orb", "seed": 0, **other}) != plain
    assert cache.key("pair", (np.zeros(3),), {"method": "sar-orb", "seed": 0}, "keypoints") != plain


def test_the_digest_knows_the_core_and_not_what_looks_at_results() -> None:
    package = Path(featreg.__file__).parent
    files = {path.relative_to(package).as_posix() for path in core_files()}
    assert {"matching.py", "pipeline/refine.py", "pipeline/trust.py", "geometry/robust.py", "interfaces.py"} <= files
    assert "sar/gradients/ratio_kernels.py" in files
    assert not [file for file in files if file.split("/")[0] in AFTERWARDS]


def test_keypoints_are_found_whatever_else_the_method_is_told(pair: SimulatedPair) -> None:
    experiment = featreg.Experiment(
        [(pair.reference, pair.secondary, pair.truth)],
        [
            ("filters", {"method": "sar-orb", "filters": ["ransac"], "ransac.threshold": 2.0}),
            ("refined", {"method": "sar-orb-paper", "refine": True, "half": 20}),
            ("blocks", {"method": "sar-orb", "block": 200, "block_share": 0.05}),
        ],
        metrics=["repeatability"],
        protocol=Protocol(timing=False),
    )
    rows = experiment.run(isolate=False).table().rows
    assert all(row["repeatability"] > 0.05 for row in rows), rows


def test_the_digest_knows_the_code_of_parts_that_a_matcher_names() -> None:
    found = _modules({"method": "optical-sar"})
    wanted = {"matchers.scale_search", "detectors.rift", "descriptors.max_index_map", "matchers.brute_force"}
    assert {f"featreg.{name}" for name in wanted} <= found
    changed = _modules({"method": "optical-sar", "detector": "sar-harris"})
    assert "featreg.detectors.sar_harris" in changed
    assert "featreg.detectors.rift" not in changed


def test_keypoints_are_those_that_the_method_looks_at(pair: SimulatedPair) -> None:
    found = keypoints_of(pair.reference, method="sar-orb", n_features=50)
    assert found is not None
    assert found.shape == (50, 2)
    assert keypoints_of(pair.reference, method="rc-obcls") is None


def test_keypoints_of_focused_images_are_those_after_focusing(pair: SimulatedPair) -> None:
    image = pair.reference.astype(np.complex64)
    moved = np.roll(image, 10, axis=0)

    def focused(given: featreg.Image) -> featreg.FocusResult:
        return replace(featreg.focus(given, "mea"), image=moved, status="ok", reason="")

    found = keypoints_of(image, method="orb", n_features=40, focus=focused)
    wanted = keypoints_of(moved, method="orb", n_features=40)
    assert found is not None
    np.testing.assert_array_equal(found, wanted)
    in_blocks: list[dict[str, Any]] = [{"block": 200}, {"block": True}, {"split": "proportional"}]
    for asked in in_blocks:
        with pytest.raises(ParameterError, match="focus works on whole images, not on blocks"):
            keypoints_of(image, method="orb", n_features=40, focus=focused, **asked)
