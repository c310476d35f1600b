"""The models: exact recovery, the least-squares optimum, signs, failures, inverses, and their way through JSON."""

from __future__ import annotations

import json
import math
import pickle
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
    as_model,
    local_linear,
    model_from_dict,
    model_from_matrix,
    model_to_dict,
    prediction_covariance,
    regional_covariance,
    rigid_uncertainty,
)
from featreg.interfaces import FailedFit, Model
from featreg.registry import available, model_class, model_name
from featreg.types import FloatArray

FOUR_DEGREES = math.radians(4.0)
CUBIC = np.zeros((2, 10))
CUBIC[0] = [512.3, 498.0, 20.0, 6.0, -4.0, 3.0, 1.5, -2.0, 0.7, 0.9]
CUBIC[1] = [470.1, -18.0, 505.0, -3.0, 5.0, 2.0, -0.8, 1.1, 1.9, -1.4]

MODELS: list[Model] = [
    Translation(12.25, -7.5),
    Rigid(4.37, 25.4, -17.3),
    Rigid(-170.6, 900.0, 800.0),
    Similarity(31.7, 1.13, -60.0, 80.0),
    Affine(np.array([[1.03, 0.07, 12.0], [-0.05, 0.97, -30.0]])),
    Homography(np.array([[1.02, 0.05, 5.0], [-0.04, 0.99, 8.0], [2e-5, -3e-5, 1.0]])),
    Polynomial2(CUBIC[:, :6], (500.0, 480.0), 500.0),
    Polynomial3(CUBIC, (500.0, 480.0), 500.0),
]
ids = [f"{type(m).__name__}-{i}" for i, m in enumerate(MODELS)]
every_model = pytest.mark.parametrize("model", MODELS, ids=ids)
CLASSES = list(dict.fromkeys(type(m) for m in MODELS))
every_class = pytest.mark.parametrize("cls", CLASSES, ids=[c.__name__ for c in CLASSES])


def scattered(count: int = 200, size: float = 1000.0, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(0, size, (count, 2))


def fitted(cls: type[Model], *arguments: Any) -> Model:
    model = cls.from_estimate(*arguments)
    assert model, model
    return model


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


@every_model
def test_known_model_is_recovered_exactly(model: Model) -> None:
    xy = scattered()
    again = fitted(type(model), xy, model(xy))
    np.testing.assert_allclose(again(xy), model(xy), atol=1e-9)
    np.testing.assert_allclose(again.residuals(xy, model(xy)), 0, atol=1e-9)


@every_model
def test_fewest_points_suffice(model: Model) -> None:
    xy = np.array([[0, 0], [900, 80], [100, 950], [880, 870], [450, 10], [20, 500], [940, 430], [480, 520], [250, 700],
                   [700, 300]], float)[: model.minimum]  # fmt: skip
    np.testing.assert_allclose(fitted(type(model), xy, model(xy))(xy), model(xy), atol=1e-7)


@every_model
def test_large_coordinates_keep_their_precision(model: Model) -> None:
    # A full scene of 30 000 px, and a small part of it far from the origin.
    for size, corner in ((30_000.0, 0.0), (500.0, 29_500.0)):
        local = scattered(size=1000.0) * 1.0
        xy = local * (size / 1000.0) + corner
        target = model(local) * (size / 1000.0) + corner
        if isinstance(model, Translation | Rigid):  # these cannot follow the change of scale
            target = model(xy)
        np.testing.assert_allclose(fitted(type(model), xy, target)(xy), target, atol=1e-6)


@every_class
def test_error_shrinks_with_the_number_of_points(cls: type[Model]) -> None:
    model = next(m for m in MODELS if type(m) is cls)
    grid = np.stack(np.meshgrid(*[np.linspace(100, 900, 9)] * 2), -1).reshape(-1, 2)
    rms = {}
    for count in (100, 1600):
        errors = []
        for seed in range(40):
            xy = scattered(count, seed=seed)
            noisy = model(xy) + np.random.default_rng(1000 + seed).normal(0, 0.5, xy.shape)
            errors.append(np.mean(fitted(cls, xy, noisy).residuals(grid, model(grid)) ** 2))
        rms[count] = math.sqrt(np.mean(errors))
    assert rms[100] < 0.5 * math.sqrt(model.minimum / 100) * 2
    assert rms[100] / rms[1600] == pytest.approx(4.0, rel=0.25)


@every_class
def test_fit_is_the_least_squares_optimum(cls: type[Model]) -> None:
    """No small change of any parameter lowers the weighted sum of squares."""
    model = next(m for m in MODELS if type(m) is cls)
    rng = np.random.default_rng(5)
    xy, weights = scattered(30), rng.uniform(0.1, 5, 30)
    noisy = model(xy) + rng.normal(0, 3, xy.shape)
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


@every_class
def test_weights_count_like_repeated_points(cls: type[Model]) -> None:
    rng = np.random.default_rng(2)
    xy = scattered(30)
    noisy = next(m for m in MODELS if type(m) is cls)(xy) + rng.normal(0, 1, xy.shape)
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


@every_model
def test_local_linear_part(model: Model) -> None:
    at = np.array([[300.0, 400.0], [900.0, 100.0]])
    linear = local_linear(model, at)
    step = np.array([0.01, -0.02])
    np.testing.assert_allclose(model(at + step) - model(at), linear @ step, atol=1e-6)
    np.testing.assert_allclose(local_linear(model, at[0]), linear[0])
    if isinstance(model, Polynomial2 | Polynomial3):
        np.testing.assert_allclose(model.jacobian(at), linear, atol=1e-7)
    if isinstance(model, Homography):
        np.testing.assert_allclose(model._linear(), local_linear(model, np.zeros(2)), atol=1e-7)


@every_model
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
    folded = Polynomial2([[0, 1, 0, 0.01, 0, 0], [0, 0, 1, 0, 0, 0]])  # type: ignore[arg-type]
    back = folded.inverse(np.array([[10.0, 3.0], [-1000.0, 3.0]]))
    np.testing.assert_allclose(folded(back[:1]), [[10.0, 3.0]], atol=1e-9)
    assert np.isnan(back[1]).all()  # x + 0.01 x^2 never falls below -25
    assert isinstance(folded.inverse, InverseModel)
    assert folded.inverse.inverse is folded
    with pytest.raises(InputError, match="not fitted"):
        InverseModel.from_estimate(np.zeros((0, 2)), np.zeros((0, 2)))


@every_model
def test_pickle_parameters_and_json_rebuild_it_exactly(model: Model) -> None:
    xy = scattered(50)
    for whole in (model, model.inverse):
        for again in (
            pickle.loads(pickle.dumps(whole)),
            type(whole)(**whole.parameters),
            model_from_dict(json.loads(json.dumps(model_to_dict(whole), allow_nan=False))),
        ):
            assert type(again) is type(whole)
            np.testing.assert_array_equal(again(xy), whole(xy))


def test_dict_holds_the_contract_keys() -> None:
    written = model_to_dict(Rigid(4.0, 1.0, 2.0))
    assert written["type"] == "rigid"
    assert written["rotation_deg"] == 4.0
    assert written["scale"] == 1.0
    np.testing.assert_array_equal(written["matrix"], Rigid(4.0, 1.0, 2.0).matrix)
    assert model_to_dict(MODELS[-1])["matrix"] is None


@pytest.mark.parametrize(
    "broken",
    [
        {},
        {"type": "rigid"},
        {"type": "no-such-model", "parameters": {}},
        {"type": "rigid", "parameters": {"angle": 4}},
        {"type": "affine", "parameters": {"coefficients": [[1, 2], [3, 4]]}},
        {"type": "inverse", "parameters": {"forward": {"type": "translation", "parameters": {"dx": 1, "dy": 2}}}},
    ],
)
def test_dict_that_is_no_model_is_refused(broken: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        model_from_dict(broken)


def test_matrix_becomes_the_simplest_model() -> None:
    two = np.array([[1.0, 0.1, 5], [-0.1, 1.0, 6]])
    three = np.vstack([two, [0, 0, 1]])
    xy = scattered(10)
    for matrix in (two, three, 4 * three, two.tolist()):
        model = model_from_matrix(matrix)
        assert isinstance(model, Affine)
        np.testing.assert_allclose(model(xy), Affine(two)(xy))
    three[2, 0] = 1e-5
    assert isinstance(model_from_matrix(three), Homography)
    assert as_model(MODELS[1]) is MODELS[1]
    assert isinstance(as_model(two), Affine)


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(2),
        np.zeros((2, 3)),
        np.zeros((3, 3)),
        np.full((2, 3), np.nan),
        [[1, 2, 3], [2, 4, 6]],
        "a.json",
        None,
        {},
    ],
)
def test_matrix_that_is_no_model_is_refused(matrix: Any) -> None:
    with pytest.raises(InputError):
        as_model(matrix)


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


@every_class
def test_degenerate_points_fail_with_a_reason(cls: type[Model]) -> None:
    xy = scattered(40)
    need = cls.minimum
    assert "too few" in why(cls.from_estimate(np.zeros((0, 2)), np.zeros((0, 2))))
    assert f"{need} needed, got {need - 1}" in why(cls.from_estimate(xy[: need - 1], xy[: need - 1]))
    holed = xy.copy()
    holed[3, 1] = np.nan
    assert "1 of 40" in why(cls.from_estimate(holed, xy))
    assert "1 of 40" in why(cls.from_estimate(xy, holed))
    assert "finite" in why(cls.from_estimate(xy, xy, np.full(40, np.inf)))
    assert "negative" in why(cls.from_estimate(xy, xy, np.full(40, -1.0)))
    assert "got 0 of positive weight" in why(cls.from_estimate(xy, xy, np.zeros(40)))
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
def test_scikit_image_finds_the_same(cls: type[Model], name: str) -> None:
    transform = pytest.importorskip("skimage.transform")
    oracle: Any = getattr(transform, f"{name}Transform")
    model = next(m for m in MODELS if type(m) is cls)
    xy = scattered(60)
    # The oracle's affine and homography are algebraic minima, which are ours on exact points only.
    noise = 2.0 if cls in (Rigid, Similarity) else 0.0
    noisy = model(xy) + np.random.default_rng(1).normal(0, noise, xy.shape)
    theirs = oracle.from_estimate(xy, noisy) if hasattr(oracle, "from_estimate") else oracle()
    if not hasattr(oracle, "from_estimate"):
        assert theirs.estimate(xy, noisy)
    np.testing.assert_allclose(fitted(cls, xy, noisy)(xy), theirs(xy), atol=1e-7)


def test_affine_is_plain_weighted_least_squares() -> None:
    rng = np.random.default_rng(4)
    xy, weights = scattered(60), rng.uniform(0.1, 3, 60)
    noisy = MODELS[4](xy) + rng.normal(0, 2, xy.shape)
    root = np.sqrt(weights)[:, None]
    oracle = np.linalg.lstsq(root * np.column_stack([xy, np.ones(60)]), root * noisy, rcond=None)[0].T
    model = Affine.from_estimate(xy, noisy, weights)
    assert model
    np.testing.assert_allclose(model.coefficients, oracle, atol=1e-9)


def test_homography_beats_the_algebraic_minimum() -> None:
    transform: Any = pytest.importorskip("skimage.transform")
    xy = scattered(40)
    noisy = MODELS[5](xy) + np.random.default_rng(1).normal(0, 2, xy.shape)
    if not hasattr(transform.ProjectiveTransform, "from_estimate"):
        pytest.skip("this scikit-image has no from_estimate")
    theirs: NDArray[np.float64] = transform.ProjectiveTransform.from_estimate(xy, noisy)(xy)
    ours = fitted(Homography, xy, noisy).residuals(xy, noisy)
    assert (ours**2).sum() <= ((theirs - noisy) ** 2).sum()


def test_rigid_intervals_cover_the_truth() -> None:
    """95 % intervals hold the true rotation and the true shift in 93 to 97 % of 2000 draws, weighted or not."""
    from scipy.stats import t as student

    truth, at, sigma = Rigid(4.0, 6.0, -4.0), np.array([450.0, 300.0]), 0.7
    for weighted in (False, True):
        rng = np.random.default_rng(11 + weighted)
        hits = np.zeros(3)
        for _ in range(2000):
            xy = rng.uniform(0, 600, (12, 2))
            weights = rng.uniform(0.2, 4, 12) if weighted else None
            spread = sigma / np.sqrt(weights)[:, None] if weights is not None else sigma
            noisy = truth(xy) + rng.normal(0, 1, (12, 2)) * spread
            model = Rigid.from_estimate(xy, noisy, weights)
            error = rigid_uncertainty(xy, noisy, weights, at=at)
            assert model
            assert error
            off = np.abs([model.rotation_deg - 4.0, *(model.shift_at(at) - truth.shift_at(at))])
            hits += off <= student.ppf(0.975, error.dof) * np.array([error.rotation_deg, *error.shift])
        assert (hits / 2000 > 0.93).all()
        assert (hits / 2000 < 0.97).all()


def test_uncertainty_needs_a_fit() -> None:
    assert not rigid_uncertainty(np.zeros((1, 2)), np.zeros((1, 2)), at=(0, 0))
    assert not rigid_uncertainty(np.zeros((5, 2)), np.zeros((5, 2)), at=(0, 0))


@every_class
def test_prediction_covariance_is_what_the_draws_show(cls: type[Model]) -> None:
    """Mapped points scatter over 800 draws as each draw alone says, near the points and beyond them, weighted."""
    model, rng = next(m for m in MODELS if type(m) is cls), np.random.default_rng(8)
    xy, at = scattered(30), np.array([[450.0, 300.0], [1100.0, -50.0]])
    weights = rng.uniform(0.3, 3, 30)
    mapped, said = [], []
    for _ in range(800):
        noisy = model(xy) + rng.normal(0, 0.3, xy.shape) / np.sqrt(weights)[:, None]
        fit = fitted(cls, xy, noisy, weights)
        covariance = prediction_covariance(fit, xy, noisy, weights, at=at)
        assert not isinstance(covariance, FailedFit)
        mapped.append(fit(at))
        said.append(covariance)
    for i in range(2):
        seen = np.cov(np.array(mapped)[:, i].T)
        mean = np.mean(said, axis=0)[i]
        np.testing.assert_allclose(mean, seen, atol=0.15 * np.trace(seen))
        np.testing.assert_allclose(np.trace(mean), np.trace(seen), rtol=0.12)


def test_prediction_covariance_agrees_with_the_rigid_errors() -> None:
    rng, at = np.random.default_rng(1), np.array([700.0, -20.0])
    xy, weights = scattered(20), rng.uniform(0, 2, 20)
    noisy = MODELS[1](xy) + rng.normal(0, 1, xy.shape)
    error = rigid_uncertainty(xy, noisy, weights, at=at)
    covariance = prediction_covariance(fitted(Rigid, xy, noisy, weights), xy, noisy, weights, at=at)
    assert error
    assert not isinstance(covariance, FailedFit)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), error.shift, rtol=1e-9)


def test_prediction_covariance_of_a_known_error_takes_the_weights_as_they_are() -> None:
    xy, at = scattered(30), np.array([[20.0, 30.0]])
    model, weights = fitted(Affine, xy, xy), np.linspace(1.0, 3.0, 30)
    one, other = (
        prediction_covariance(model, xy, xy, w, at=at, sigma=s) for w, s in ((4 * weights, 1.0), (weights, 0.5))
    )
    assert not isinstance(one, FailedFit)
    assert not isinstance(other, FailedFit)
    np.testing.assert_allclose(one, other)
    # The mean of equal points: sigma^2 over the sum of their weights.
    centre = prediction_covariance(Translation(0.0, 0.0), xy, xy, np.full(30, 4.0), at=at, sigma=1.0)
    assert not isinstance(centre, FailedFit)
    np.testing.assert_allclose(centre[0], np.eye(2) / 120)


def test_prediction_covariance_needs_more_than_the_fewest_points() -> None:
    xy = scattered(3)
    assert "no degree of freedom" in prediction_covariance(fitted(Affine, xy, xy), xy, xy, at=(0, 0)).reason  # type: ignore[union-attr]
    with pytest.raises(InputError, match="derivatives"):
        prediction_covariance(MODELS[-1].inverse, xy, xy, at=(0, 0))


@pytest.mark.parametrize("cls", [Translation, Rigid, Similarity, Affine, Homography, Polynomial2])
def test_regional_covariance_is_that_of_fits_without_each_region(cls: type[Model]) -> None:
    rng, at = np.random.default_rng(3), np.array([[0.0, 0.0], [500.0, 20.0], [250.0, 400.0]])
    xy = rng.uniform(0, 500, (120, 2))
    noisy = xy + np.array([3.0, -2.0]) + rng.normal(0, 0.5, xy.shape)
    region = np.floor(xy / 170).astype(np.int64) @ np.array([1, 3])
    refitted = np.stack([fitted(cls, xy[region != k], noisy[region != k])(at) for k in range(9)])
    offsets = refitted - refitted.mean(axis=0)
    wanted = 8 / 9 * np.einsum("kna,knb->nab", offsets, offsets)
    covariance = regional_covariance(fitted(cls, xy, noisy), xy, noisy, region, at=at)
    assert not isinstance(covariance, FailedFit)
    np.testing.assert_allclose(covariance, wanted, rtol=0.05, atol=0.02 * np.trace(wanted, axis1=1, axis2=2).max())


def test_regional_covariance_sees_errors_that_neighbours_share() -> None:
    """With an error common to each region the truth is as far off as it says, not as independent points would be."""
    rng, at = np.random.default_rng(4), np.array([[250.0, 250.0], [0.0, 500.0]])
    xy = rng.uniform(0, 500, (400, 2))
    region = np.minimum(xy // 125, 3).astype(np.int64) @ np.array([1, 4])
    missed: list[float] = []
    regional: list[float] = []
    independent: list[float] = []
    for _ in range(60):
        moved = xy + rng.normal(0, 1, (16, 2))[region] + rng.normal(0, 0.2, xy.shape)
        model = fitted(Affine, xy, moved)
        missed.append(np.sum((model(at) - at) ** 2))
        for method, extra, into in (
            (regional_covariance, (region,), regional),
            (prediction_covariance, (), independent),
        ):
            covariance = method(model, xy, moved, *extra, at=at)
            assert not isinstance(covariance, FailedFit)
            into.append(np.trace(covariance, axis1=1, axis2=2).sum())
    assert 0.7 < np.mean(regional) / np.mean(missed) < 1.6
    assert np.mean(independent) < 0.2 * np.mean(missed)


def test_regional_covariance_needs_three_regions_that_can_be_left_out() -> None:
    xy = scattered(6)
    model = fitted(Affine, xy, xy)
    assert "2 regions" in regional_covariance(model, xy, xy, np.arange(6) % 2, at=xy[:1]).reason  # type: ignore[union-attr]
    lopsided = np.array([0, 0, 0, 0, 1, 2])
    assert "do not determine" in regional_covariance(model, xy, xy, lopsided, at=xy[:1]).reason  # type: ignore[union-attr]
