"""Refinement: a known affine recovered, honest covariances, masks, budgets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.geometry import Affine, Homography, Similarity
from featreg.interfaces import Model
from featreg.io import as_image
from featreg.pipeline.aligned import halved
from featreg.pipeline.refine import Refine, Refined
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Image, Matches
from made.models import grid_rmse


def near(truth: NDArray[np.float64], by: float = 1.5) -> Affine:
    """The truth, off by `by` pixels and a little bent."""
    return Affine(truth + np.array([[0.002, 0.001, by], [-0.001, 0.002, -by]]))


def refined(pair: SimulatedPair, matches: Matches | None = None, n: int = 2000, **parameters: Any) -> Refined:
    images = as_image(pair.reference), as_image(pair.secondary)
    return Refine(**parameters).run(*images, near(pair.truth), Matches.empty() if matches is None else matches, n)


def test_a_known_affine_is_recovered_to_a_tenth_of_a_pixel() -> None:
    pair = sar_pair((600, 600), seed=1)
    found = refined(pair)
    assert grid_rmse(found.model, pair.truth, 600) < 0.1
    assert len(found.matches) > 500
    assert len(found.matches) <= found.correlated <= found.candidates


@pytest.mark.parametrize("kind", [Similarity, Homography])
def test_other_models_are_refined_in_their_own_kind(pair: SimulatedPair, kind: type[Model]) -> None:
    points = np.random.default_rng(0).uniform(0, 299, (50, 2))
    start = kind.from_estimate(points, near(pair.truth)(points))
    assert isinstance(start, Model)
    found = Refine().run(as_image(pair.reference), as_image(pair.secondary), start, Matches.empty(), 2000)
    assert type(found.model) is kind
    assert grid_rmse(found.model, pair.truth) < 0.2


@pytest.mark.parametrize("seed", [1, 5])
def test_errors_are_as_large_as_their_covariances_say(seed: int) -> None:
    made = sar_pair((400, 400), seed=seed)
    matches = refined(made).matches
    assert matches.covariance is not None
    assert (np.linalg.eigvalsh(matches.covariance) > 0).all()
    error = matches.secondary_xy - (matches.reference_xy @ made.truth[:, :2].T + made.truth[:, 2])
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(matches.covariance), error)
    assert 1.0 < squared.mean() < 4.0  # 2 for two Gaussian errors


@pytest.mark.parametrize("kind", [Affine, Homography])
def test_windows_around_few_points_say_what_the_whole_images_do(
    pair: SimulatedPair, kind: type[Model], monkeypatch: pytest.MonkeyPatch
) -> None:
    points = np.random.default_rng(0).uniform(0, 299, (50, 2))
    start = kind.from_estimate(points, near(pair.truth)(points))
    assert isinstance(start, Model)
    images = as_image(pair.reference), as_image(pair.secondary)
    found = []
    for windows in (False, True):
        monkeypatch.setattr("featreg.pipeline.refine.few", lambda *_, windows=windows: windows)
        found.append(Refine().run(*images, start, Matches.empty(), 200))
    whole, around = found
    np.testing.assert_allclose(around.measured.score[:20], whole.measured.score[:20], atol=0.02)
    assert isinstance(whole.model, Model)
    assert isinstance(around.model, Model)
    assert np.abs(whole.model(points) - around.model(points)).max() < 0.02
    assert abs(len(around.matches) - len(whole.matches)) < 10


def test_squares_that_a_model_stretches_too_much_are_left_out_of_the_filter() -> None:
    class Stretched:
        """A shift of 150 px along x, to the left of x = 100 an enlargement."""

        matrix = None

        def __call__(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
            x = np.where(xy[:, 0] > 100, xy[:, 0] + 150, 250 - 2.4 * (100 - xy[:, 0]))
            return np.column_stack([x, xy[:, 1]])

    pixels = np.random.default_rng(0).gamma(4.0, 0.25, (200, 600)).astype(np.float32)
    model: Any = Stretched()
    found = Refine()._filter(as_image(pixels[:, 150:]), as_image(pixels), model)
    assert found is not None
    assert found.coherence[1:16].min() > 0.9


def test_tie_points_are_distinct_whole_pixels_within_the_limit(pair: SimulatedPair) -> None:
    found = refined(pair)
    xy = found.matches.reference_xy
    assert len(np.unique(xy, axis=0)) == len(xy)
    np.testing.assert_array_equal(xy, np.rint(xy))
    assert isinstance(found.model, Model)
    assert found.model.residuals(xy, found.matches.secondary_xy).max() <= 1.0
    assert found.matches.score.min() >= 0.35


@pytest.mark.parametrize("n", [40, 300, 5000])
def test_never_more_points_than_asked_for(pair: SimulatedPair, n: int) -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(30, 270, (400, 2))
    found = refined(pair, Matches(xy, xy, np.ones(400)), n)
    assert 0 < len(found.matches) <= n
    assert found.candidates <= n


def test_points_fill_all_of_the_image_where_cells_are_more_than_the_budget(pair: SimulatedPair) -> None:
    y = refined(pair, n=1000).matches.reference_xy[:, 1]
    upper, lower = (y < 150).sum(), (y > 149).sum()
    assert upper > 200
    assert lower == pytest.approx(upper, rel=0.25)


def test_a_strip_in_a_frame_is_filled_up_as_it_is_alone() -> None:
    made = sar_pair((600, 300), rotation_deg=0, scale=1, shift=(1.3, 0.6), seed=3)
    strip = np.zeros((600, 300), np.bool_)
    strip[200:380] = True
    framed = Refine().run(
        as_image(made.reference, mask=strip), as_image(made.secondary), near(made.truth), Matches.empty(), 600
    )
    here, there = (as_image(image[200:380]) for image in (made.reference, made.secondary))
    alone = Refine().run(here, there, near(made.truth), Matches.empty(), 600)
    assert len(alone.matches) > 300
    assert len(framed.matches) > 0.9 * len(alone.matches)


def test_origin_names_the_match_that_a_point_came_from(pair: SimulatedPair) -> None:
    xy = np.random.default_rng(0).uniform(40, 260, (100, 2))
    found = refined(pair, Matches(xy, xy, np.ones(100))).matches
    came = found.origin >= 0
    assert 20 < came.sum() <= 100
    assert (~came).any()
    assert np.abs(xy[found.origin[came]] - found.reference_xy[came]).max() <= 0.5


@pytest.mark.parametrize("which", ["reference", "secondary"])
def test_windows_keep_clear_of_a_masked_half(pair: SimulatedPair, which: str) -> None:
    mask = np.ones((300, 300), np.bool_)
    mask[:, :150] = False
    masks = {"reference": None, "secondary": None} | {which: mask}
    first, second = (as_image(getattr(pair, role), mask=masks[role]) for role in ("reference", "secondary"))
    found = Refine().run(first, second, near(pair.truth), Matches.empty(), 2000)
    xy = found.matches.reference_xy if which == "reference" else found.matches.secondary_xy
    assert len(xy) > 100
    assert xy[:, 0].min() >= 150 + 24 - 2
    assert grid_rmse(found.model, pair.truth) < 0.3


def test_a_hole_in_the_secondary_is_seen_through_a_turned_model(turned_pair: SimulatedPair) -> None:
    mask = np.ones((300, 300), np.bool_)
    mask[140:160, 140:160] = False
    second = as_image(turned_pair.secondary, mask=mask)
    found = Refine().run(as_image(turned_pair.reference), second, Affine(turned_pair.truth), Matches.empty(), 3000)
    xy = found.matches.secondary_xy
    assert len(xy) > 100
    away = np.maximum(np.abs(xy - 149.5).max(axis=1) - 10, 0)
    assert away.min() > 20  # a window reaches 24 px along the reference's axes


def test_what_lies_under_the_mask_has_no_influence(pair: SimulatedPair) -> None:
    mask = np.ones((300, 300), np.bool_)
    mask[100:140, 100:200] = False
    second = as_image(pair.secondary)
    found = [
        Refine().run(
            as_image(np.where(mask, pair.reference, v), mask=mask), second, near(pair.truth), Matches.empty(), 999
        )
        for v in (0.0, 99.0)
    ]
    np.testing.assert_array_equal(found[0].matches.secondary_xy, found[1].matches.secondary_xy)


def test_unrelated_images_do_not_correlate(pair: SimulatedPair) -> None:
    other = sar_pair((300, 300), seed=99)
    found = Refine().run(as_image(pair.reference), as_image(other.secondary), Affine(pair.truth), Matches.empty(), 2000)
    assert len(found.matches) < Refine().least(max(found.candidates, 1))


@pytest.mark.parametrize("shape", [(16, 16), (40, 300), (57, 57), (96, 96)])
def test_images_too_small_for_a_window_give_nothing(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    small = Image(rng.uniform(1, 2, shape).astype(np.float32), np.ones(shape, np.bool_))
    found = Refine().run(small, small, Affine(np.eye(3)[:2]), Matches.empty(), 100)
    assert not found.model or len(found.matches) > 0
    assert len(found.matches) <= 100


def test_a_model_that_maps_outside_gives_nothing(pair: SimulatedPair) -> None:
    away = Affine(np.array([[1.0, 0, 5000], [0, 1, 0]]))
    found = Refine().run(as_image(pair.reference), as_image(pair.secondary), away, Matches.empty(), 500)
    assert not found.model
    assert len(found.matches) == 0


def test_halving_averages_two_by_two() -> None:
    view = np.arange(35, dtype=np.float32).reshape(5, 7)
    wanted = view[:4, :6].reshape(2, 2, 3, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(halved(view), wanted)


@pytest.mark.parametrize(
    "parameters",
    [
        {"half": 2}, {"search": 1}, {"min_correlation": 0.0}, {"min_correlation": 1.0}, {"max_residual": 0.0},
        {"sigma": -1.0}, {"sigma": float("nan")}, {"max_residual": float("nan")}, {"least_share": -0.1},
    ],
    ids=str,
)  # fmt: skip
def test_impossible_parameters_are_refused(parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        Refine(**parameters)
