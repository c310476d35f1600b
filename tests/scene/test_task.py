"""One block: where it is searched for, what counts as content, what comes back of it."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.geometry import Affine
from featreg.interfaces import Filter, FilterContext
from featreg.io import as_image
from featreg.io.raster_source import Window
from featreg.pipeline.assembly import assemble
from featreg.results.registration import Registration
from featreg.scene.blocks import Block
from featreg.scene.prior import Prior
from featreg.scene.task import (
    columns_of,
    from_columns,
    measured_model,
    run_block,
    search_window,
    skip_reason,
)
from featreg.types import BoolArray, Image, Matches
from made.scene_results import BLOCK


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
