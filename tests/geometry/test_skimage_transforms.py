"""Models to and from scikit-image's transforms: the same map, and the same kind of model back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from skimage import transform

from featreg.errors import InputError
from featreg.geometry import (
    Affine,
    Homography,
    Polynomial2,
    Polynomial3,
    Rigid,
    Similarity,
    Translation,
    from_skimage,
    to_skimage,
)

XY = np.random.default_rng(0).uniform(0, 900, (50, 2))
LINEAR = np.array([[400.0, 390, 9], [380, -9, 390]])
CUBIC = np.random.default_rng(1).normal(0, 1, (2, 10)) + np.pad(LINEAR, ((0, 0), (0, 7)))
MODELS: list[tuple[Any, type, type]] = [
    (Translation(3.5, -2), transform.EuclideanTransform, Rigid),
    (Rigid(20.0, 4.0, 5.0), transform.EuclideanTransform, Rigid),
    (Similarity(-30.0, 1.2, 4.0, 5.0), transform.SimilarityTransform, Similarity),
    (Affine(np.array([[1.01, 0.2, 3], [-0.1, 0.9, 4]])), transform.AffineTransform, Affine),
    (
        Homography(np.array([[1.01, 0.2, 3], [-0.1, 0.9, 4], [1e-4, 1e-5, 1]])),
        transform.ProjectiveTransform,
        Homography,
    ),
    (Polynomial2(CUBIC[:, :6], (400.0, 380.0), 390.0), transform.PolynomialTransform, Polynomial2),
    (Polynomial3(CUBIC, (400.0, 380.0), 390.0), transform.PolynomialTransform, Polynomial3),
]


@pytest.mark.parametrize(("model", "kind", "back"), MODELS, ids=[type(m[0]).__name__ for m in MODELS])
def test_a_model_and_its_transform_map_alike_both_ways(model: Any, kind: type, back: type) -> None:
    there: Any = to_skimage(model)
    assert type(there).__name__ == kind.__name__
    np.testing.assert_allclose(there(XY), model(XY), atol=1e-8)
    again: Any = from_skimage(there)
    assert type(again).__name__ == back.__name__
    np.testing.assert_allclose(again(XY), model(XY), atol=1e-8)


def test_a_linear_polynomial_is_an_affine() -> None:
    given = transform.PolynomialTransform(np.array([[3.0, 1.1, 0.2], [4.0, -0.1, 0.9]]))
    found: Any = from_skimage(given)
    assert type(found) is Affine
    np.testing.assert_allclose(found(XY), given(XY), atol=1e-9)


def test_skimage_warps_the_secondary_onto_the_reference() -> None:
    """Row and column of its arrays are our y and x: output[p] = secondary[model(p)]."""
    secondary = np.random.default_rng(2).normal(size=(60, 70))
    model = Translation(3.0, -2.0)
    aligned = transform.warp(secondary, to_skimage(model), order=1)
    np.testing.assert_allclose(aligned[5:50, 5:60], secondary[3:48, 8:63], atol=1e-12)


def test_kinds_without_a_counterpart_are_refused() -> None:
    with pytest.raises(InputError, match="PiecewiseAffineTransform"):
        from_skimage(transform.PiecewiseAffineTransform())
    with pytest.raises(InputError, match="degree 1 to 3"):
        from_skimage(transform.PolynomialTransform(np.zeros((2, 15))))
    with pytest.raises(InputError, match="of the kind InverseModel"):
        to_skimage(MODELS[-1][0].inverse)
