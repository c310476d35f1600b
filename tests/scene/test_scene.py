"""Whole scenes in blocks: the truth is found, by whatever runs the blocks, and what is wrong is said."""

from __future__ import annotations

import pickle
import threading
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import CancelledError, InputError, NoOverlapError, ParameterError
from featreg.geometry import Affine
from featreg.interfaces import Filter, FilterContext, Matcher
from featreg.io import as_image
from featreg.io.raster_source import ImageSource, Window
from featreg.matching import keypoints_of
from featreg.pipeline.assembly import assemble
from featreg.results.registration import Registration
from featreg.sar.speckle import equivalent_looks
from featreg.scene.blocks import Block, middle_of, plan_blocks, spread_out, suitable_side
from featreg.scene.prior import Prior
from featreg.scene.samples import SIDE, SQUARES, sampled
from featreg.scene.task import (
    columns_of,
    from_columns,
    measured_model,
    refined_points,
    run_block,
    search_window,
    skip_reason,
)
from featreg.simulate import sar_pair
from featreg.types import BoolArray, Image, Matches

BLOCK: dict[str, Any] = {"block": 200, "workers": 1}


@pytest.fixture(scope="module")
def result(located_pair: Any) -> Registration:
    return featreg.match(located_pair.reference, located_pair.secondary, **BLOCK)


def grid(width: int = 800, height: int = 700) -> NDArray[np.float64]:
    x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
    return np.column_stack([x.ravel(), y.ravel()])


def error(result: Registration, truth: NDArray[np.float64]) -> float:
    """RMS distance in pixels of the model from the truth over the image."""
    assert result.model, result.reason
    wanted = np.column_stack([grid(), np.ones(81)]) @ truth.T
    return float(np.sqrt(np.mean(np.sum((result.model(grid()) - wanted) ** 2, axis=1))))


def same(a: Registration, b: Registration) -> bool:
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


# ---------------------------------------------------------------- plan


def test_blocks_own_every_pixel_once() -> None:
    area = Window(13, -5, 1234, 777)
    blocks = plan_blocks(area, 200)
    owned = np.zeros((777, 1234), np.int64)
    for block in blocks:
        w = block.window
        owned[w.y + 5 : w.y + 5 + w.height, w.x - 13 : w.x - 13 + w.width] += 1
    assert (owned == 1).all()
    sides = np.array([(b.window.width, b.window.height) for b in blocks])
    assert np.ptp(sides, axis=0).max() <= 1
    assert [b.index for b in blocks] == list(range(len(blocks)))
    assert 0.66 * 200 <= sides.min() <= sides.max() <= 1.34 * 200


def test_an_area_smaller_than_a_block_is_one_block() -> None:
    assert [b.window for b in plan_blocks(Window(3, 4, 50, 70), 600)] == [Window(3, 4, 50, 70)]


def test_large_scenes_have_larger_blocks_and_as_many_refined_points() -> None:
    refined, plain, dense = (
        assemble(name, blocks=True, refine=refine)
        for name, refine in (("sar-orb", True), ("sar-orb", False), ("sar-dense", None))
    )
    large, middling, small = (Window(0, 0, *size) for size in ((11_000, 10_000), (4400, 4000), (2500, 2750)))
    assert suitable_side(large, refined) == 1000
    assert suitable_side(middling, refined) == round(np.sqrt(4400 * 4000) / 5)
    assert suitable_side(small, refined) == 600
    # The matches of a block, so many a block, are the tie points; and the paper's blocks are those of the paper.
    assert suitable_side(large, plain) == suitable_side(large, dense) == 600
    # Of what compares no features nothing is known.
    patches = assemble("cls", blocks=True)
    assert patches.refine is not None
    assert suitable_side(large, patches) == 600
    assert suitable_side(large, refined, "proportional") == 600
    assert [refined_points(Window(0, 0, side, side)) for side in (200, 600, 1200)] == [64, 64, 256]


def test_a_pilot_block_is_the_middle_of_a_large_block() -> None:
    assert middle_of(Block(3, 1, 1, Window(1000, 2000, 900, 500))) == Block(3, 1, 1, Window(1150, 2000, 600, 500))


def test_pilot_blocks_lie_all_over() -> None:
    blocks = plan_blocks(Window(0, 0, 10_000, 11_000), 600)
    pilots = spread_out(blocks, 9)
    assert 8 <= len(pilots) <= 12
    rows, cols = {b.row for b in pilots}, {b.col for b in pilots}
    assert max(rows) - min(rows) >= 10
    assert max(cols) - min(cols) >= 10


# ---------------------------------------------------------------- result


def test_the_truth_is_found(result: Registration, located_pair: Any) -> None:
    assert result.status == "ok", result.reason
    assert error(result, located_pair.truth) < 0.05
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
    assert same(result, replace(back, matches=matches, gates=result.gates))


def test_tie_points_of_a_block_are_capped(located_pair: Any) -> None:
    few = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, n_features=150)
    assert few.status == "ok"
    assert max(few.provenance["block_table"]["putative"]) <= 150


def test_other_models_are_fitted_over_all_blocks(located_pair: Any) -> None:
    for model in ("similarity", "polynomial2", "rpc-bias"):
        got = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, model=model)
        assert got.status == "ok", got.reason
        assert error(got, located_pair.truth) < 0.1


def test_a_method_without_refinement_keeps_the_consensus(located_pair: Any) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, refine=False)
    assert got.status == "ok"
    assert "refine" not in got.stages
    assert error(got, located_pair.truth) < 0.2


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
    assert same(got, result)


def test_the_size_of_the_blocks_hardly_changes_the_model(located_pair: Any, result: Registration) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, block=350, workers=1)
    assert got.model
    assert result.model
    # The corner without data is left to the models alone.
    shown = grid()[(grid() >= 280).any(axis=1)]
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


# ---------------------------------------------------------------- what goes wrong


class Fragile(Matcher):
    """Fails on every image whose first pixel is brighter than the second."""

    def match(self, reference: Image, secondary: Image) -> Matches:
        if reference.amplitude[0, 0] > reference.amplitude[0, 1]:
            raise ValueError("the first pixel is too bright")
        return _sar_orb().match(reference, secondary)


def _sar_orb() -> Matcher:
    from featreg.pipeline.assembly import assemble

    matcher = assemble("sar-orb", n_features=500).matcher
    assert matcher is not None
    return matcher


def test_a_failing_block_is_a_row_and_not_the_end(located_pair: Any) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, method=Fragile(), filters=["fsc"], **BLOCK)
    counts, table = got.provenance["blocks"], got.provenance["block_table"]
    assert 0 < counts["failed"] < counts["total"]
    assert "ValueError: the first pixel is too bright" in table["reason"]
    assert got.status == "ok", got.reason
    assert error(got, located_pair.truth) < 0.2


class Broken(Matcher):
    """Never works."""

    def match(self, reference: Image, secondary: Image) -> Matches:
        raise RuntimeError("no")


def test_all_blocks_failing_is_an_unreliable_result(located_pair: Any) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, method=Broken(), **BLOCK)
    assert got.status == "unreliable"
    counts = got.provenance["blocks"]
    assert counts["failed"] == counts["total"] - counts["skipped"]
    assert not len(got.matches)


def test_unrelated_scenes_are_unreliable(located_pair: Any, tmp_path: Path) -> None:
    """The geolocation says that they show the same ground, and they do not."""
    import rasterio

    other = sar_pair((700, 800), seed=99).secondary
    with rasterio.open(located_pair.secondary) as source:
        profile = source.profile
    with rasterio.open(tmp_path / "other.tif", "w", **profile) as dataset:
        dataset.write(np.clip(other * 300, 1, 65535).astype(np.uint16), 1)
    got = featreg.match(located_pair.reference, tmp_path / "other.tif", **BLOCK)
    assert got.status == "unreliable"
    assert got.reason


def test_no_overlap_says_where_the_images_lie(located_pair: Any, tmp_path: Path) -> None:
    import rasterio
    from rasterio.transform import Affine

    with rasterio.open(located_pair.secondary) as source:
        profile = source.profile | {"transform": Affine(10.0, 0.0, 700_000.0, 0.0, -10.0, 4_000_000.0)}
        samples = source.read(1)
    with rasterio.open(tmp_path / "far.tif", "w", **profile) as dataset:
        dataset.write(samples, 1)
    with pytest.raises(NoOverlapError, match="km"):
        featreg.match(located_pair.reference, tmp_path / "far.tif", **BLOCK)


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({"block": 50}, "block must be"),
        ({"block": 200.5}, "block must be"),
        ({"block": 200, "workers": 0}, "workers must be"),
        ({"block": 200, "executor": "cluster"}, "executor must be"),
        ({"block": 200, "dem": "a.tif", "height": 3.0}, "not from both"),
        ({"block": False, "height": 20.0}, "is for blocks"),
        ({"block": False, "model": "rpc-bias"}, "is for blocks"),
    ],
)
def test_misuse_says_what_would_be_right(keywords: dict[str, Any], text: str, located_pair: Any) -> None:
    with pytest.raises(ParameterError, match=text):
        featreg.match(located_pair.reference, located_pair.secondary, **keywords)


def test_a_missing_elevation_model_is_named(located_pair: Any) -> None:
    with pytest.raises(InputError, match=r"nowhere\.tif"):
        featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, dem="nowhere.tif")


def test_rpc_bias_without_geolocation_is_an_error() -> None:
    noise = np.random.default_rng(0).random((300, 300), np.float32)
    with pytest.raises(InputError, match="nothing says where"):
        featreg.match(noise, noise, model="rpc-bias")


# ---------------------------------------------------------------- without geolocation


def test_without_geolocation_overviews_give_the_prior(located_pair: Any) -> None:
    a, b = as_image(located_pair.reference).pixels, as_image(located_pair.secondary).pixels
    got = featreg.match(a, b, **BLOCK, nodata=0)
    assert got.status == "ok", got.reason
    assert "overviews" in got.provenance["prior"]["source"]
    assert error(got, located_pair.truth) < 0.05
    again = featreg.match(a, b, block=200, nodata=0, executor="processes", workers=2)
    assert same(got, again)


def test_without_geolocation_unrelated_images_are_unreliable() -> None:
    a, b = (np.random.default_rng(k).gamma(1.0, 1.0, (500, 500)).astype(np.float32) for k in (0, 1))
    got = featreg.match(a, b, **BLOCK)
    assert got.status == "unreliable"
    assert "overviews" in got.reason


def test_a_known_model_is_the_prior(located_pair: Any) -> None:
    near = located_pair.truth + np.array([[0, 0, 5.0], [0, 0, -4.0]])
    got = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, initial=near, search_radius=12)
    assert got.status == "ok", got.reason
    assert got.provenance["prior"]["source"].startswith("initial model")
    assert error(got, located_pair.truth) < 0.05
    wrong = located_pair.truth + np.array([[0, 0, 60.0], [0, 0, 0]])
    lost = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, initial=wrong, search_radius=12)
    assert lost.status == "unreliable"


def test_large_images_are_worked_on_in_blocks_by_themselves(monkeypatch: pytest.MonkeyPatch, located_pair: Any) -> None:
    monkeypatch.setattr("featreg.matching.MOST_PIXELS", 500_000)
    assert "blocks" in featreg.match(located_pair.reference, located_pair.secondary, workers=1).provenance
    whole = featreg.match(located_pair.reference, located_pair.secondary, block=False)
    assert "blocks" not in whole.provenance


# ---------------------------------------------------------------- one block


def test_the_search_window_holds_where_the_prior_maps(located_pair: Any) -> None:
    from featreg.geometry import Affine

    prior = Prior(Affine(located_pair.truth), 7.0, "truth")
    here = Window(200, 150, 280, 260)
    there = search_window(prior, here, (700, 800))
    assert there is not None
    corners = np.array([[200, 150], [479, 150], [200, 409], [479, 409]], np.float64)
    at = prior(corners)
    assert (at >= there.origin).all()
    assert (at <= there.origin + np.array([there.width, there.height])).all()
    assert search_window(prior, Window(5000, 5000, 10, 10), (700, 800)) is None


def test_speckle_alone_is_no_content_and_structure_is(sar_texture: Any) -> None:
    rng = np.random.default_rng(0)
    for looks in (1.0, 4.0):
        sea = np.sqrt(rng.gamma(looks, 1 / looks, (300, 300))).astype(np.float32)
        assert "nothing but speckle" in skip_reason(as_image(sea), "reference")
    assert skip_reason(as_image(sar_texture(300, 300, seed=1, looks=1.0)), "reference") == ""
    land = sar_texture(300, 300)
    assert "no data" in skip_reason(as_image(land, mask=np.arange(300) * np.ones((300, 1)) < 9), "secondary")


@pytest.mark.parametrize("value", [0.3, 1.7, 123.4567, 33000.0])
@pytest.mark.parametrize("missing", [0, 77, 100])
def test_one_value_is_no_structure_whatever_rounding_makes_of_it(value: float, missing: int) -> None:
    mask = np.ones((256, 256), np.bool_)
    mask[:missing] = False
    pixels = np.where(mask, np.float32(value), np.float32(0))
    assert "no structure" in skip_reason(Image(pixels, mask), "reference")


class Half(Filter):
    """Keeps the better half, as a random draw would, to see that each block draws from its own seed."""

    local = True

    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        return context.rng.random(len(matches)) < 0.5


def test_local_filters_draw_from_the_seed_and_the_block(located_pair: Any, result: Registration) -> None:
    def kept(seed: int) -> BoolArray:
        got = featreg.match(
            located_pair.reference, located_pair.secondary, **BLOCK, seed=seed, refine=False, filters=[Half(), "fsc"]
        )
        return np.asarray(got.stages["half"])

    assert np.array_equal(kept(0), kept(0))
    assert not np.array_equal(kept(0), kept(1))


def test_a_job_is_small_and_a_block_result_survives_its_columns(located_pair: Any) -> None:
    from featreg.geometry import Affine
    from featreg.io.raster_source import open_source
    from featreg.pipeline.assembly import assemble
    from featreg.scene.task import Job

    pipeline = assemble("sar-orb", n_features=400)
    assert pipeline.matcher is not None
    sources = open_source(located_pair.reference), open_source(located_pair.secondary)
    job = Job(*sources, pipeline.matcher, (), pipeline.model, pipeline.refine, 0, 400, 40)
    prior = Prior(Affine(located_pair.truth), 5.0, "truth")
    assert len(pickle.dumps((job, prior))) < 20_000
    got = run_block(job, prior, Block(7, 1, 2, Window(300, 300, 200, 200)))
    assert got.status == "done", got.reason
    assert len(got.refined) > 10
    back = from_columns(columns_of(got))
    assert back.index == 7
    assert back.window == got.window
    assert np.array_equal(back.matches.secondary_xy, got.matches.secondary_xy)
    assert np.array_equal(back.refined.covariance, got.refined.covariance)  # type: ignore[arg-type]


def test_the_model_of_a_block_is_measured_where_located_points_are_many() -> None:
    rng = np.random.default_rng(5)
    matrix = np.array([[1.01, 0.02, 5.0], [-0.02, 0.99, -3.0]])
    truth, rough = Affine(matrix), Affine(matrix + np.array([[0, 0, 0.8], [0, 0, -0.6]]))
    here = rng.uniform(0, 600, (200, 2))
    there = truth(here) + rng.normal(0, 0.1, here.shape)
    there[:40] += rng.uniform(5, 50, (40, 2))  # wrong matches stay wrong
    covariance = np.tile(0.01 * np.eye(2), (200, 1, 1))
    located = Matches(here, there, np.ones(200), covariance)
    measured = measured_model(rough, located, 200, (600, 600))
    assert measured is not None
    assert np.abs(measured(here) - truth(here)).max() < 0.05
    # Few near the first model, or of unknown covariance, measure none.
    assert measured_model(rough, located.take(np.arange(60)), 200, (600, 600)) is None
    assert measured_model(rough, replace(located, covariance=None), 200, (600, 600)) is None


def test_located_points_in_one_corner_do_not_measure_the_model_of_a_block() -> None:
    rng = np.random.default_rng(6)
    truth = Affine(np.array([[1.01, 0.02, 5.0], [-0.02, 0.99, -3.0]]))
    covariance = np.tile(0.01 * np.eye(2), (200, 1, 1))

    def measured(here: NDArray[np.float64]) -> Affine | None:
        there = truth(here) + rng.normal(0, 0.3, here.shape)
        return measured_model(truth, Matches(here, there, np.ones(200), covariance), 200, (600, 600))

    everywhere = rng.uniform(0, 600, (200, 2))
    corners = np.array([[0, 0], [599, 0], [0, 599], [599, 599]], np.float64)
    for here in (everywhere, everywhere * [0.5, 1]):  # half of a block is enough
        found = measured(here)
        assert found is not None
        assert np.abs(found(corners) - truth(corners)).max() < 0.5
    assert measured(everywhere * 0.4) is None
    line = np.column_stack([everywhere[:, 0], everywhere[:, 0] + everywhere[:, 1] / 30])
    assert measured(line) is None
    assert measured(np.column_stack([everywhere[:, 0], everywhere[:, 0]])) is None


# ---------------------------------------------------------------- what is looked at


def test_keypoints_of_a_scene_are_those_of_its_blocks(located_pair: Any) -> None:
    got = featreg.match(
        located_pair.reference, located_pair.secondary, **BLOCK, initial=located_pair.truth, search_radius=12
    )
    found = keypoints_of(located_pair.reference, method="sar-orb", block=200)
    assert found is not None
    own = {tuple(point) for point in found}
    assert len(own) > len(got.matches) > 500
    # The overlap, whose blocks the scene has, lacks a rim of the reference: features of the same windows only.
    blocks = plan_blocks(Window(0, 0, 800, 700), 200)
    assert len(blocks) * 1000 >= len(found)
    assert found.min() >= -0.5
    shared = np.mean([tuple(point) in own for point in got.matches.reference_xy])
    assert shared > 0.9
    assert keypoints_of(located_pair.reference, method="rc-obcls", block=200) is None


def test_keypoints_of_proportional_blocks_rest_on_no_halo(located_pair: Any) -> None:
    whole, alone = (
        keypoints_of(located_pair.reference, method="sar-orb", block=200, split=s) for s in ("prior", "proportional")
    )
    assert whole is not None
    assert alone is not None
    # Columns of blocks are 200 px wide; 5 px at either side of a rim.
    rim = [np.abs((xy[:, 0] + 0.5) % 200 - 100) > 95 for xy in (whole, alone)]
    assert rim[0].any()
    assert not rim[1].any()


def test_a_scene_is_probed_by_squares_of_its_own_pixels() -> None:
    rng = np.random.default_rng(3)
    speckle = np.sqrt(rng.gamma(4.0, 0.25, (1500, 1400))).astype(np.float32)
    speckle[:590] = np.nan
    source = ImageSource(as_image(speckle))
    seen = sampled(source)
    assert seen.shape == ((SQUARES**2 - 10) * SIDE, SIDE)  # two rows of squares hold no data
    assert seen.all_valid
    assert equivalent_looks(seen) == pytest.approx(equivalent_looks(as_image(speckle[590:])), rel=0.05)
    small = ImageSource(as_image(speckle[600:700, :90]))
    assert sampled(small).shape == (100, 90)


def test_a_narrow_strip_of_data_is_probed_too() -> None:
    speckle = np.sqrt(np.random.default_rng(3).gamma(4.0, 0.25, (2000, 2000))).astype(np.float32)
    y, x = np.mgrid[:2000, :2000]
    whole = equivalent_looks(as_image(speckle[:500, :500]))
    for width in (200, 100):
        strip = sampled(ImageSource(as_image(speckle, mask=np.abs(x - y - 290) < width / 2)))
        assert len(strip.pixels) <= SQUARES**2 * SIDE
        assert equivalent_looks(strip) == pytest.approx(whole, rel=0.25)
    nothing = sampled(ImageSource(Image(speckle, np.zeros(speckle.shape, np.bool_))))
    assert nothing.shape == (SIDE, SIDE)
    assert not nothing.mask.any()
