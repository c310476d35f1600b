"""The models: exact recovery, the least-squares optimum, signs, failures and inverses."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import geometry
from featreg.errors import InputError
from featreg.geometry import (
    Affine,
    Homography,
    InverseModel,
    Polynomial2,
    Polynomial3,
    Rigid,
    Similarity,
    Translation,
    model_to_dict,
)
from featreg.interfaces import FailedFit, Model
from featreg.registry import available, model_class, model_name
from featreg.types import FloatArray
from made.models import fitted, scattered

FOUR_DEGREES = math.radians(4.0)
BENT = Polynomial2([[0, 1, 0, 0.01, 0, 0], [0, 0, 1, 0, 0, 0]])  # type: ignore[arg-type]


def why(result: Model | FailedFit) -> str:
    assert isinstance(result, FailedFit)
    assert not result
    return result.reason


def test_registered_names() -> None:
    assert set(available("model")) >= {
        "translation", "rigid", "similarity", "affine", "homography", "polynomial2", "polynomial3",
    }  # fmt: skip
    assert model_class("rigid") is Rigid
    assert model_name(Polynomial3) == "polynomial3"
    assert all(hasattr(geometry, name) for name in geometry.__all__)


def test_known_model_is_recovered_exactly(model: Model) -> None:
    xy = scattered()
    again = fitted(type(model), xy, model(xy))
    np.testing.assert_allclose(again(xy), model(xy), atol=1e-9)
    np.testing.assert_allclose(again.residuals(xy, model(xy)), 0, atol=1e-9)
    np.testing.assert_allclose(model.residuals(xy[:1], xy), np.hypot(*(model(xy[:1]) - xy).T), rtol=1e-12)


def test_fewest_points_suffice(model: Model) -> None:
    xy = np.array([[0, 0], [900, 80], [100, 950], [880, 870], [450, 10], [20, 500], [940, 430], [480, 520], [250, 700],
                   [700, 300]], float)[: model.minimum]  # fmt: skip
    np.testing.assert_allclose(fitted(type(model), xy, model(xy))(xy), model(xy), atol=1e-7)


def test_large_coordinates_keep_their_precision(model: Model) -> None:
    # A full scene of 30 000 px, and a small part of it far from the origin.
    for size, corner in ((30_000.0, 0.0), (500.0, 29_500.0)):
        local = scattered(size=1000.0) * 1.0
        xy = local * (size / 1000.0) + corner
        target = model(local) * (size / 1000.0) + corner
        if isinstance(model, Translation | Rigid):  # these cannot follow the change of scale
            target = model(xy)
        np.testing.assert_allclose(fitted(type(model), xy, target)(xy), target, atol=1e-6)


def test_error_shrinks_with_the_number_of_points(cls: type[Model], example: Model) -> None:
    grid = np.stack(np.meshgrid(*[np.linspace(100, 900, 9)] * 2), -1).reshape(-1, 2)
    rms = {}
    for count in (100, 1600):
        errors = []
        for seed in range(40):
            xy = scattered(count, seed=seed)
            noisy = example(xy) + np.random.default_rng(1000 + seed).normal(0, 0.5, xy.shape)
            errors.append(np.mean(fitted(cls, xy, noisy).residuals(grid, example(grid)) ** 2))
        rms[count] = math.sqrt(np.mean(errors))
    assert rms[100] < 0.5 * math.sqrt(example.minimum / 100) * 2
    assert rms[100] / rms[1600] == pytest.approx(4.0, rel=0.25)


def test_fit_is_the_least_squares_optimum(cls: type[Model], example: Model) -> None:
    """No small change of any parameter lowers the weighted sum of squares."""
    rng = np.random.default_rng(5)
    xy, weights = scattered(30), rng.uniform(0.1, 5, 30)
    noisy = example(xy) + rng.normal(0, 3, xy.shape)
    best = fitted(cls, xy, noisy, weights)

    def cost(parameters: dict[str, Any]) -> float:
        return float(weights @ cls(**parameters).residuals(xy, noisy) ** 2)

    lowest = cost(dict(best.parameters))
    fixed = {"centre", "scale"} if isinstance(best, Polynomial2 | Polynomial3) else set()
    for name, value in best.parameters.items():
        if name in fixed:
            continue
        flat = np.array(value, float)
        for i in range(flat.size):
            for sign in (-1, 1):
                changed = flat.copy()
                changed.flat[i] += sign * 1e-6 * max(abs(changed.flat[i]), 1e-6)
                given = changed.tolist() if flat.ndim else float(changed)
                assert cost({**best.parameters, name: given}) >= lowest * (1 - 1e-12)


def test_weights_count_like_repeated_points(cls: type[Model], example: Model) -> None:
    rng = np.random.default_rng(2)
    xy = scattered(30)
    noisy = example(xy) + rng.normal(0, 1, xy.shape)
    times = rng.integers(0, 4, 30)
    weighted = fitted(cls, xy, noisy, times.astype(float))
    repeated = fitted(cls, np.repeat(xy, times, axis=0), np.repeat(noisy, times, axis=0))
    np.testing.assert_allclose(weighted(xy), repeated(xy), atol=1e-6)
    np.testing.assert_allclose(fitted(cls, xy, noisy, np.full(30, 1e-200))(xy), fitted(cls, xy, noisy)(xy), atol=1e-9)


def test_rigid_agrees_with_kabsch_and_brute_force() -> None:
    rng = np.random.default_rng(3)
    xy, weights = scattered(25), rng.uniform(0.2, 3, 25)
    noisy = Rigid(20.0, 5, 6)(xy) * 1.05 + rng.normal(0, 4, xy.shape)
    model = Rigid.from_estimate(xy, noisy, weights)
    assert model
    # Kabsch: the rotation from the singular vectors of the cross-covariance.
    centre, target = (np.average(p, axis=0, weights=weights) for p in (xy, noisy))
    left, _, right = np.linalg.svd(((xy - centre) * weights[:, None]).T @ (noisy - target))
    kabsch = (left @ np.diag([1.0, np.linalg.det(left @ right)]) @ right).T
    np.testing.assert_allclose(model.matrix[:2, :2], kabsch, atol=1e-12)
    np.testing.assert_allclose(model.shift_at(centre), target - centre, atol=1e-9)
    # Brute force over the angle, the best shift of each angle being known.
    angles = np.arange(-180, 180, 0.01)
    costs = []
    for angle in angles:
        turned = Rigid(angle)(xy)
        r = noisy - turned - np.average(noisy - turned, axis=0, weights=weights)
        costs.append(weights @ (r * r).sum(axis=1))
    assert model.rotation_deg == pytest.approx(angles[np.argmin(costs)], abs=0.0051)


def test_rigid_never_zooms() -> None:
    xy = scattered(50)
    model = Rigid.from_estimate(xy, 1.2 * xy)
    assert model
    assert np.linalg.det(model.matrix[:2, :2]) == pytest.approx(1.0, abs=1e-15)
    assert model.rotation_deg == pytest.approx(0.0, abs=1e-12)
    assert model.scale == model.anisotropy == 1.0


def test_rotation_is_counter_clockwise_as_seen() -> None:
    """`np.rot90` turns the displayed image counter-clockwise, and its pixels go where the model says."""
    image = np.arange(5 * 7).reshape(5, 7)
    turned = np.rot90(image)
    y, x = np.mgrid[:5, :7]
    xy = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    target = np.column_stack([np.nonzero(turned == value)[::-1] for value in image.ravel()]).T.astype(float)
    for cls in (Rigid, Similarity, Affine, Homography):
        model = fitted(cls, xy, target)
        assert getattr(model, "rotation_deg") == pytest.approx(90.0, abs=1e-6)  # noqa: B009
        at = np.rint(model(xy)).astype(int)
        assert (turned[at[:, 1], at[:, 0]] == image[xy[:, 1].astype(int), xy[:, 0].astype(int)]).all()
    # By four degrees: a point to the right of the centre rises, so its y falls.
    assert Rigid(4.0)(np.array([[100.0, 0.0]]))[0] == pytest.approx(
        [100 * math.cos(FOUR_DEGREES), -100 * math.sin(FOUR_DEGREES)]
    )


def test_linear_part_is_read_off() -> None:
    turn = Similarity(12.0, 1.1).matrix[:2, :2]
    for model in (Similarity(12.0, 1.1, 5, 6), Affine(np.column_stack([turn, [5, 6]]))):
        assert model.rotation_deg == pytest.approx(12.0)
        assert model.scale == pytest.approx(1.1)
        assert model.anisotropy == pytest.approx(1.0)
        assert model.shear_deg == pytest.approx(0.0, abs=1e-9)
    stretched = Affine(np.column_stack([turn @ np.diag([1.2, 1.0]), [0, 0]]))
    assert stretched.anisotropy == pytest.approx(1.2)
    assert stretched.scale == pytest.approx(1.1 * math.sqrt(1.2))
    assert stretched.rotation_deg == pytest.approx(12.0)
    sheared = Affine(np.array([[1, math.tan(math.radians(5)), 0], [0, 1, 0]]))
    assert sheared.shear_deg == pytest.approx(5.0)
    mirrored = Affine(np.array([[-1.0, 0, 99], [0, 1, 0]]))
    assert math.isnan(mirrored.rotation_deg)
    assert "rotation_deg" not in model_to_dict(mirrored)


def test_inverse_goes_there_and_back(model: Model) -> None:
    xy = scattered()
    np.testing.assert_allclose(model.inverse(model(xy)), xy, atol=1e-8)
    np.testing.assert_allclose(model.inverse.inverse(xy), model(xy), atol=1e-8)
    if model.matrix is not None:
        product = model.matrix @ np.asarray(model.inverse.matrix)
        np.testing.assert_allclose(product / product[2, 2], np.eye(3), atol=1e-9)


def test_inverse_of_a_homography_far_from_the_origin() -> None:
    model = Homography(np.array([[1.01, 0.03, 20_000.0], [-0.02, 0.98, -9000.0], [3e-7, -2e-7, 1.0]]))
    xy = scattered(size=30_000.0)
    np.testing.assert_allclose(model.inverse(model(xy)), xy, atol=1e-6)


def test_inverse_of_a_polynomial_says_where_there_is_none() -> None:
    folded = BENT
    back = folded.inverse(np.array([[10.0, 3.0], [-1000.0, 3.0]]))
    np.testing.assert_allclose(folded(back[:1]), [[10.0, 3.0]], atol=1e-9)
    assert np.isnan(back[1]).all()  # x + 0.01 x^2 never falls below -25
    assert isinstance(folded.inverse, InverseModel)
    assert folded.inverse.inverse is folded
    with pytest.raises(InputError, match="not fitted"):
        InverseModel.from_estimate(np.zeros((0, 2)), np.zeros((0, 2)))


@pytest.mark.parametrize(
    "make",
    [
        lambda: Translation(math.nan, 0),
        lambda: Rigid(math.inf),
        lambda: Similarity(1.0, 0.0),
        lambda: Affine(np.eye(3)),
        lambda: Polynomial2(np.zeros((2, 10))),
        lambda: Polynomial3(np.zeros((2, 10)), (0.0, 0.0), -1.0),
    ],
)
def test_impossible_parameters_are_refused(make: Callable[[], Model]) -> None:
    with pytest.raises(InputError):
        make()


def _line(count: int) -> FloatArray:
    t = np.linspace(0, 1000, count)
    return np.column_stack([100 + 0.3 * t, 7 + 0.8 * t])


def _circle(count: int) -> FloatArray:
    a = np.linspace(0, 6, count)
    return 500 + 300 * np.column_stack([np.cos(a), np.sin(a)])


def test_degenerate_points_fail_with_a_reason(cls: type[Model]) -> None:
    xy = scattered(40)
    need = cls.minimum
    assert "too few" in why(cls.from_estimate(np.zeros((0, 2)), np.zeros((0, 2))))
    few = f"got {need - 1}" if need > 1 else "none given"
    assert f"{need} needed, {few}" in why(cls.from_estimate(xy[: need - 1], xy[: need - 1]))
    holed = xy.copy()
    holed[3, 1] = np.nan
    assert "1 of 40" in why(cls.from_estimate(holed, xy))
    assert "1 of 40" in why(cls.from_estimate(xy, holed))
    assert "finite" in why(cls.from_estimate(xy, xy, np.full(40, np.inf)))
    assert "negative" in why(cls.from_estimate(xy, xy, np.full(40, -1.0)))
    assert "none of 40 of positive weight" in why(cls.from_estimate(xy, xy, np.zeros(40)))
    with pytest.raises(InputError, match="shape"):
        cls.from_estimate(xy, xy[:3])
    with pytest.raises(InputError, match="weights"):
        cls.from_estimate(xy, xy, np.ones(3))
    if cls is not Translation:
        assert "coincide" in why(cls.from_estimate(np.full((40, 2), 29_999.5), xy))
        assert "coincide" in why(cls.from_estimate(xy, np.full((40, 2), 29_999.5)))


@pytest.mark.parametrize("cls", [Affine, Homography, Polynomial2, Polynomial3])
def test_points_on_a_line_fail(cls: type[Model]) -> None:
    assert why(cls.from_estimate(_line(40), _line(40)))
    assert why(cls.from_estimate(_line(40) + 29_000, _line(40)))
    assert why(cls.from_estimate(scattered(40), _line(40)))


def test_three_of_four_points_on_a_line_fail() -> None:
    xy = np.array([[0, 0], [500, 500], [1000, 1000], [900, 0]], float)
    assert "on a line" in why(Homography.from_estimate(xy, xy))


def test_points_on_a_circle_leave_a_quadratic_open() -> None:
    assert "curve" in why(Polynomial2.from_estimate(_circle(40), _circle(40)))
    assert Affine.from_estimate(_circle(40), _circle(40))


def test_rotation_that_no_point_decides() -> None:
    square = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], float)
    mirrored = square * (1, -1)
    assert "no rotation" in why(Rigid.from_estimate(square, mirrored))
    assert "no rotation" in why(Similarity.from_estimate(square, mirrored))


def test_a_crossing_horizon_fails() -> None:
    xy = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    assert why(Homography.from_estimate(xy, xy[[0, 2, 1, 3]]))


@pytest.mark.parametrize(
    ("cls", "name"), [(Similarity, "Similarity"), (Affine, "Affine"), (Homography, "Projective"), (Rigid, "Euclidean")]
)
def test_scikit_image_finds_the_same(cls: type[Model], example: Model, name: str) -> None:
    transform = pytest.importorskip("skimage.transform")
    oracle: Any = getattr(transform, f"{name}Transform")
    xy = scattered(60)
    # The oracle's affine and homography are algebraic minima, which are ours on exact points only.
    noise = 2.0 if cls in (Rigid, Similarity) else 0.0
    noisy = example(xy) + np.random.default_rng(1).normal(0, noise, xy.shape)
    theirs = oracle.from_estimate(xy, noisy) if hasattr(oracle, "from_estimate") else oracle()
    if not hasattr(oracle, "from_estimate"):
        assert theirs.estimate(xy, noisy)
    np.testing.assert_allclose(fitted(cls, xy, noisy)(xy), theirs(xy), atol=1e-7)


def test_affine_is_plain_weighted_least_squares() -> None:
    rng = np.random.default_rng(4)
    xy, weights = scattered(60), rng.uniform(0.1, 3, 60)
    noisy = Affine(np.array([[1.03, 0.07, 12.0], [-0.05, 0.97, -30.0]]))(xy) + rng.normal(0, 2, xy.shape)
    root = np.sqrt(weights)[:, None]
    oracle = np.linalg.lstsq(root * np.column_stack([xy, np.ones(60)]), root * noisy, rcond=None)[0].T
    model = Affine.from_estimate(xy, noisy, weights)
    assert model
    np.testing.assert_allclose(model.coefficients, oracle, atol=1e-9)


def test_homography_beats_the_algebraic_minimum() -> None:
    transform: Any = pytest.importorskip("skimage.transform")
    xy = scattered(40)
    true = Homography(np.array([[1.02, 0.05, 5.0], [-0.04, 0.99, 8.0], [2e-5, -3e-5, 1.0]]))
    noisy = true(xy) + np.random.default_rng(1).normal(0, 2, xy.shape)
    if not hasattr(transform.ProjectiveTransform, "from_estimate"):
        pytest.skip("this scikit-image has no from_estimate")
    theirs: NDArray[np.float64] = transform.ProjectiveTransform.from_estimate(xy, noisy)(xy)
    ours = fitted(Homography, xy, noisy).residuals(xy, noisy)
    assert (ours**2).sum() <= ((theirs - noisy) ** 2).sum()


@pytest.mark.parametrize("thin", [1.0, 0.2, 0.05, 1e-3])
def test_an_affine_fit_is_the_orthogonal_one(thin: float) -> None:
    """By normal equations where the points are well spread, by orthogonal steps where they are not."""
    rng = np.random.default_rng(4)
    here = rng.uniform(0, 600, (50, 2)) * (1.0, thin) + (3000.0, 1000.0)
    there = here @ np.array([[1.02, 0.1], [-0.12, 0.97]]) + (7.0, -3.0) + rng.normal(0, 0.3, here.shape)
    weights = rng.uniform(0.1, 3, 50)
    found = Affine.from_estimate(here, there, weights)
    assert found
    root = np.sqrt(weights)[:, None]
    centre = here.mean(axis=0)
    rows = np.column_stack([here - centre, np.ones(50)])
    wanted = np.linalg.lstsq(root * rows, root * there, rcond=None)[0]
    np.testing.assert_allclose(found(here), rows @ wanted, atol=1e-8)
