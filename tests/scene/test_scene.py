"""Whole scenes in blocks: the truth is found, by whatever runs the blocks."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import CancelledError, ParameterError
from featreg.io.raster_source import Window
from featreg.results.registration import Registration
from made.models import grid_of
from made.scene_results import BLOCK, same_bits, scene_error

# ---------------------------------------------------------------- result


def test_the_truth_is_found(result: Registration, located_pair: Any) -> None:
    assert result.status == "ok", result.reason
    assert scene_error(result, located_pair.truth) < 0.05
    there = np.column_stack([result.matches.reference_xy, np.ones(len(result.matches))]) @ located_pair.truth.T
    off = np.hypot(*(there - result.matches.secondary_xy).T)
    assert np.mean(off[result.inliers] <= 1.5) >= 0.995


def test_the_bias_of_the_geolocation_is_found_by_pilot_blocks(result: Registration, located_pair: Any) -> None:
    prior = result.provenance["prior"]
    assert "pilot" in prior["source"]
    assert prior["uncertainty_px"] <= 15
    np.testing.assert_allclose(np.array(prior["correction"])[:, 2], -np.array(located_pair.bias), atol=2.0)


def test_the_result_says_what_came_of_each_block(result: Registration) -> None:
    counts, table = result.provenance["blocks"], result.provenance["block_table"]
    assert counts["total"] == len(table["status"]) == counts["computed"]
    assert counts["skipped"] == table["status"].count("skipped") >= 1
    assert "no data in the reference" in table["reason"][table["status"].index("skipped")]
    assert sum(table["final"]) == result.inliers.sum()
    owners = result.provenance["tie_point_blocks"]
    assert len(owners) == len(result.matches)
    for k in np.unique(owners).tolist():
        window = Window(*(table[name][k] for name in ("x", "y", "width", "height")))
        assert window.holds(result.matches.reference_xy[owners == k]).all()


def test_the_result_has_scene_gates_and_an_accuracy_report(result: Registration) -> None:
    report = result.provenance["accuracy"]
    assert result.gates["blocks"].passed
    assert report["passed"]
    assert 0 < report["rmse_px"] < 0.5
    assert np.array(report["covariance_centre_px2"]).shape == (2, 2)
    assert result.gates["held_out_rmse"].value == pytest.approx(report["rmse_px"], rel=0.5)


def test_the_result_is_written_and_read_whole(result: Registration, tmp_path: Path) -> None:
    result.to_json(tmp_path / "r.json")
    back = Registration.from_json(tmp_path / "r.json")
    assert result.matches.covariance is not None
    assert back.matches.covariance is not None
    # Three numbers of each matrix are written; the fourth is equal up to rounding.
    np.testing.assert_allclose(back.matches.covariance, result.matches.covariance, rtol=1e-9, atol=1e-12)
    matches = replace(back.matches, covariance=result.matches.covariance)
    assert same_bits(result, replace(back, matches=matches, gates=result.gates))


def test_tie_points_of_a_block_are_capped(located_pair: Any) -> None:
    few = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, n_features=150)
    assert few.status == "ok"
    assert max(few.provenance["block_table"]["putative"]) <= 150


def test_other_models_are_fitted_over_all_blocks(located_pair: Any) -> None:
    for model in ("similarity", "polynomial2", "rpc-bias"):
        got = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, model=model)
        assert got.status == "ok", got.reason
        assert scene_error(got, located_pair.truth) < 0.1


def test_a_method_without_refinement_keeps_the_consensus(located_pair: Any) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, refine=False)
    assert got.status == "ok"
    assert "refine" not in got.stages
    assert scene_error(got, located_pair.truth) < 0.2


# ---------------------------------------------------------------- who runs it


class Backwards(ThreadPoolExecutor):
    """Runs what it has been given in the opposite order."""

    def __init__(self) -> None:
        super().__init__(1)
        self._held: list[tuple[Future[Any], Any]] = []
        self._max_workers = 10

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self._held.append((future, (fn, args, kwargs)))
        threading.Timer(0.2, self._flush).start()
        return future

    def _flush(self) -> None:
        held, self._held = self._held, []
        for future, (fn, args, kwargs) in reversed(held):
            if future.set_running_or_notify_cancel():
                future.set_result(fn(*args, **kwargs))


@pytest.mark.parametrize("executor", ["threads", "processes", "backwards", "pool", "map-only"])
def test_the_result_does_not_depend_on_who_runs_the_blocks(
    executor: str, located_pair: Any, result: Registration
) -> None:
    if executor == "map-only":
        with pytest.raises(ParameterError, match="executor must be"):
            featreg.match(located_pair.reference, located_pair.secondary, block=200, executor=object())
        return
    made: Any = {"backwards": Backwards, "pool": lambda: ProcessPoolExecutor(2)}.get(executor, lambda: executor)()
    got = featreg.match(located_pair.reference, located_pair.secondary, block=200, executor=made, workers=2)
    if not isinstance(made, str):
        made.shutdown()
    assert same_bits(got, result)


def test_the_size_of_the_blocks_hardly_changes_the_model(located_pair: Any, result: Registration) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, block=350, workers=1)
    assert got.model
    assert result.model
    # The corner without data is left to the models alone.
    places = grid_of((800, 700))
    shown = places[(places >= 280).any(axis=1)]
    assert np.abs(got.model(shown) - result.model(shown)).max() < 0.1


# ---------------------------------------------------------------- progress, cancel


def test_progress_counts_blocks_and_cancel_stops(located_pair: Any) -> None:
    seen: list[tuple[int, int]] = []
    stop = threading.Event()

    def tell(done: int, total: int) -> None:
        seen.append((done, total))
        if done == 3:
            stop.set()

    with pytest.raises(CancelledError):
        featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, progress=tell, cancel=stop)
    assert [done for done, _ in seen] == [0, 1, 2, 3]
    assert len({total for _, total in seen}) == 1
