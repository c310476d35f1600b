"""Models from matrices and truths, to and from JSON-able dicts, and the linear part of any model at a point."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError, UnknownNameError
from featreg.geometry.homography import Homography
from featreg.geometry.matrix import Affine
from featreg.geometry.polynomial import InverseModel, Polynomial
from featreg.interfaces import Model
from featreg.registry import model_class, model_name
from featreg.types import FloatArray


def model_from_matrix(matrix: ArrayLike) -> Affine | Homography:
    """Return the model of a (2, 3) or (3, 3) matrix reference -> secondary: affine where it can be, else a homography.

    Raises
    ------
    InputError
        Another shape, values that are not finite, a matrix that cannot be inverted.
    """
    try:
        m = np.asarray(matrix, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"a model matrix must hold numbers, got {matrix!r}") from error
    if m.shape not in ((2, 3), (3, 3)):
        raise InputError(f"a model matrix must be (2, 3) or (3, 3), reference -> secondary, got shape {m.shape}")
    if m.shape == (2, 3):
        return Affine(m)
    if (m[2, :2] == 0).all() and m[2, 2] != 0:
        return Affine(m[:2] / m[2, 2])
    return Homography(m)


def as_model(truth: Model | ArrayLike) -> Model:
    """Return a model as it is, and the model of a (2, 3) or (3, 3) matrix.

    Raises
    ------
    InputError
        Anything else.
    """
    if isinstance(truth, Model):
        return truth
    if isinstance(truth, str | bytes) or truth is None or isinstance(truth, Mapping):
        raise InputError(f"a model or a (2, 3) or (3, 3) matrix is needed, got {type(truth).__name__}")
    return model_from_matrix(truth)


def model_to_dict(model: Model) -> dict[str, Any]:
    """Return a JSON-able dict of a model; `model_from_dict` rebuilds it to the last bit.

    The keys: `type` (registered name), `matrix` (3 rows, or None), `parameters`, and `rotation_deg`, `scale`,
    `anisotropy`, `shear_deg`, each where the model has it and it is finite.
    """
    inverted = isinstance(model, InverseModel)
    matrix = model.matrix
    out: dict[str, Any] = {
        "type": "inverse" if inverted else model_name(type(model)),
        "matrix": None if matrix is None else matrix.tolist(),
        "parameters": {name: _plain(value) for name, value in model.parameters.items()},
    }
    if matrix is not None:
        for name in ("rotation_deg", "scale", "anisotropy", "shear_deg"):
            value = getattr(model, name, None)
            if value is not None and math.isfinite(value):
                out[name] = float(value)
    return out


def model_from_dict(values: Mapping[str, Any]) -> Model:
    """Return the model that `model_to_dict` wrote.

    Raises
    ------
    InputError
        A key is missing, the type is unknown, or the parameters do not make such a model.
    """
    try:
        name, parameters = values["type"], dict(values["parameters"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"a model needs the keys 'type' and 'parameters', got {sorted(values)}") from error
    if name == "inverse":
        forward = model_from_dict(parameters.get("forward", {}))
        if not isinstance(forward, Polynomial):
            raise InputError(f"an inverse is that of a polynomial, got {type(forward).__name__}")
        return InverseModel(forward)
    try:
        return model_class(name)(**parameters)
    except UnknownNameError as error:
        raise InputError(str(error)) from error
    except (TypeError, ValueError) as error:
        raise InputError(f"no model '{name}' has the parameters {sorted(parameters)}: {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, Model):
        return model_to_dict(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def local_linear(model: Model, xy: ArrayLike, step: float = 0.5) -> FloatArray:
    """Return the linear part of any model around reference points, by central differences.

    Parameters
    ----------
    model : the model
    xy : (N, 2) reference points, or (2,) for one
    step : half the distance of the two samples, px

    Returns
    -------
    (N, 2, 2) float64, or (2, 2); `decompose` reads rotation, scale, anisotropy and shear off each.
    """
    at = np.asarray(xy, np.float64)
    p = at.reshape(-1, 2)
    offsets = step * np.eye(2)
    columns = [(model(p + offset) - model(p - offset)) / (2 * step) for offset in offsets]
    return np.stack(columns, axis=-1).reshape(*at.shape[:-1], 2, 2)
