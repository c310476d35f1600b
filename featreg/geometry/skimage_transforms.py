"""Models to and from `skimage.transform`, which counts x, y and the centre of the first pixel as this package does."""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.geometry.convert import model_from_matrix
from featreg.geometry.polynomial import Polynomial, Polynomial2, Polynomial3
from featreg.interfaces import Model
from featreg.types import FloatArray

# (power of x, power of y) of each term, in the order of both packages.
POWERS = [(j - i, i) for j in range(4) for i in range(j + 1)]
KINDS = tuple(f"{n}Transform" for n in ("Euclidean", "Similarity", "Affine", "Projective", "Polynomial"))
TRANSFORMS = {"translation": "Euclidean", "rigid": "Euclidean", "similarity": "Similarity", "affine": "Affine"}


def to_skimage(model: Model) -> Any:
    """Return a model reference -> secondary as a transform of scikit-image, as `skimage.transform.warp` takes it.

    Returns
    -------
    `EuclideanTransform` (translation, rigid), `SimilarityTransform`, `AffineTransform`, `ProjectiveTransform` or
    `PolynomialTransform`: ``skimage.transform.warp(secondary, to_skimage(model))`` lies on the reference grid

    Raises
    ------
    InputError
        A model that is none of these, such as a residual field.
    """
    from skimage import transform

    from featreg.registry import model_name

    if isinstance(model, Polynomial2 | Polynomial3):
        return transform.PolynomialTransform(_expanded(model))
    if model.matrix is None:
        raise InputError(f"scikit-image has no transform for a model of the kind {type(model).__name__}")
    name = TRANSFORMS.get(model_name(type(model)), "Projective")
    return getattr(transform, f"{name}Transform")(matrix=model.matrix)


def from_skimage(transform: Any) -> Model:
    """Return a transform of scikit-image from reference to secondary pixels as a model of the same kind.

    Raises
    ------
    InputError
        A kind that this package has no model for: thin plates, piecewise affine, polynomials of degree 0 or above 3.
    """
    kind = type(transform).__name__
    parameters = np.asarray(getattr(transform, "params", None), np.float64) if hasattr(transform, "params") else None
    if parameters is None or kind in (
        "ThinPlateSplineTransform",
        "PiecewiseAffineTransform",
        "FundamentalMatrixTransform",
    ):
        raise InputError(f"featreg has no model for scikit-image's {kind}")
    if kind == "PolynomialTransform":
        model = {3: None, 6: Polynomial2, 10: Polynomial3}
        if parameters.shape[1] not in model:
            raise InputError(
                f"featreg has polynomials of degree 1 to 3, got {parameters.shape[1]} coefficients an axis"
            )
        of_degree = model[parameters.shape[1]]
        if of_degree is not None:
            return of_degree(parameters)
        return model_from_matrix(parameters[:, [1, 2, 0]])
    if parameters.shape != (3, 3):
        raise InputError(f"a transform of the plane is needed, got {kind} with parameters of shape {parameters.shape}")
    general = model_from_matrix(parameters)
    if kind not in ("EuclideanTransform", "SimilarityTransform"):
        return general
    from featreg.registry import model_class

    # Three points determine either model, and both agree with them exactly.
    corners = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    made = model_class({"EuclideanTransform": "rigid", "SimilarityTransform": "similarity"}[kind]).from_estimate(
        corners, general(corners)
    )
    if not isinstance(made, Model) or np.abs(made(corners) - general(corners)).max() > 1e-6:
        return general  # one that mirrors, which no similarity here does
    return made


def _expanded(model: Polynomial) -> FloatArray:
    """(2, N) coefficients of the powers of x and y themselves, of a polynomial of (x - centre) / scale."""
    (cx, cy), scale = model.centre, model.scale
    given = np.asarray(model.coefficients, np.float64)
    out = np.zeros_like(given)
    for k, (a, b) in enumerate(POWERS[: given.shape[1]]):
        for i in range(a + 1):
            for j in range(b + 1):
                factor = comb(a, i) * (-cx) ** (a - i) * comb(b, j) * (-cy) ** (b - j) / scale ** (a + b)
                out[:, POWERS.index((i, j))] += factor * given[:, k]
    return out
