"""New rational polynomials for a sensor whose image points are moved by an affine map."""

from __future__ import annotations

from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.geolocation.rpc import RpcSensor
from featreg.geometry.least_squares import least_squares
from featreg.types import FloatArray

#: Lattice nodes along longitude, latitude and height, and the largest error that is accepted, px.
NODES = (15, 15, 7)
ACCEPTED_PX = 0.01


def with_affine(sensor: RpcSensor, matrix: FloatArray) -> dict[str, Any]:
    """Return the RPC, under rasterio's names, that projects to ``matrix @ (x, y, 1)`` where `sensor` does to (x, y).

    Raises
    ------
    InputError
        No RPC with the same denominators reproduces it to 0.01 px over the range of the RPC.
    """
    made = dict(sensor.rpcs)
    if np.array_equal(matrix[:, :2], np.eye(2)):
        made["samp_off"] += float(matrix[0, 2])
        made["line_off"] += float(matrix[1, 2])
        return made
    unit = lattice(*(np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in NODES))
    moved = _projected(sensor, unit) @ matrix[:, :2].T + matrix[:, 2]
    design = terms(unit)
    for axis, name in enumerate(("samp", "line")):
        wanted = (moved[:, axis] - made[f"{name}_off"]) / made[f"{name}_scale"]
        bottom = design @ made[f"{name}_den_coeff"]
        # Rows over the denominator, so that the residual is that of the quotient.
        made[f"{name}_num_coeff"] = least_squares(design / bottom[:, None], wanted)[0].tolist()
    check = lattice(*(np.linspace(-1, 1, n + 3) for n in NODES))
    truth = _projected(sensor, check) @ matrix[:, :2].T + matrix[:, 2]
    error = float(np.hypot(*(_projected(RpcSensor(made), check) - truth).T).max())
    if not error <= ACCEPTED_PX:
        raise InputError(f"no RPC reproduces the bias: {error:.3g} px off, {ACCEPTED_PX} px is accepted; use a shift")
    return made


def fitted(
    ground: FloatArray, image: FloatArray, frame: dict[str, float], *, errors: dict[str, float]
) -> dict[str, Any]:
    """Return the RPC through corresponding points.

    Parameters
    ----------
    ground : (N, 3) longitude, latitude in degrees, height in metres
    image : (N, 2) x, y
    frame : the ten offsets and scales, under rasterio's names
    errors : ``err_bias`` and ``err_rand`` in metres

    Notes
    -----
    Linear least squares of numerator - value * denominator, with the denominator's constant 1 and a small ridge on the
    rest of it, repeated with the rows over the last denominator (C. V. Tao, Y. Hu, "A comprehensive study of the
    rational function model for photogrammetric processing", Photogramm. Eng. Remote Sens. 67(12), 2001).
    """
    made: dict[str, Any] = {**frame, **errors}
    unit = np.column_stack(
        [(ground[:, i] - frame[f"{n}_off"]) / frame[f"{n}_scale"] for i, n in enumerate(("long", "lat", "height"))]
    )
    design = terms(unit)
    for axis, name in enumerate(("samp", "line")):
        value = (image[:, axis] - frame[f"{name}_off"]) / frame[f"{name}_scale"]
        bottom = np.ones(len(value))
        ridge = 1e-6 * np.sqrt(len(value)) * np.eye(39)
        ridge[:20] = 0.0
        for _ in range(4):
            rows = np.column_stack([design, -value[:, None] * design[:, 1:]]) / bottom[:, None]
            solution = least_squares(np.vstack([rows, ridge]), np.concatenate([value / bottom, np.zeros(39)]))[0]
            bottom = 1.0 + design[:, 1:] @ solution[20:]
        made[f"{name}_num_coeff"] = solution[:20].tolist()
        made[f"{name}_den_coeff"] = [1.0, *solution[20:].tolist()]
    return made


def terms(unit: FloatArray) -> FloatArray:
    """(N, 20) terms of RPC00B at (N, 3) normalised longitude, latitude, height."""
    x, y, z = unit.T
    columns = [
        np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x, y * y, z * z,
        x * y * z, x**3, x * y * y, x * z * z, x * x * y, y**3, y * z * z, x * x * z, y * y * z, z**3,
    ]  # fmt: skip
    return np.column_stack(columns)


def lattice(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """(N, 3) nodes of the product of three axes."""
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3)


def _projected(sensor: RpcSensor, unit: FloatArray) -> FloatArray:
    r = sensor.rpcs
    scale, offset = (np.array([r[f"{name}_{part}"] for name in ("long", "lat", "height")]) for part in ("scale", "off"))
    ground = unit * scale + offset
    return sensor.ground_to_image(ground[:, :2], ground[:, 2])
