"""The models: exact recovery, precision, signs and inverses."""

from __future__ import annotations

import math

import numpy as np
import pytest

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
from featreg.interfaces import Model
from featreg.registry import available, model_class, model_name
from made.models import fitted, scattered

FOUR_DEGREES = math.radians(4.0)
BENT = Polynomial2([[0, 1, 0, 0.01, 0, 0], [0, 0, 1, 0, 0, 0]])  # type: ignore[arg-type]


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
