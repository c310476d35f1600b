"""How two images relate to each other by what their files say of where they lie."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from featreg.errors import InputError
from featreg.types import FloatArray, Geolocation

IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
#: Positions that differ by less are the same, px.
SAME_PX = 0.01
#: The map between two images may bend by so much and still be taken as affine, px.
BENT_PX = 0.05
#: Nodes along each side of the lattice on which that is looked at.
NODES = 7


class Placed(NamedTuple):
    """An image: its name for messages, (H, W), and where it lies."""

    name: str
    shape: tuple[int, int]
    geolocation: Geolocation | None


def relation(old: Placed, new: Placed) -> FloatArray | None:
    """Return the (2, 3) affine map from the pixels of one image to those of another, by their geolocation.

    None where one of them does not say where it lies.

    Raises
    ------
    InputError
        What they say contradicts each other, cannot be compared, or is no affine map.
    """
    first, second = old.geolocation, new.geolocation
    if first is None or second is None:
        return None
    if _equal(first, second):
        return IDENTITY
    grids = first.transform, second.transform
    if grids[0] is not None and grids[1] is not None and not (_exact(first) or _exact(second)):
        affine = _between(grids[0], grids[1], _turn(second.crs), new.shape)
        if bool(first.crs) != bool(second.crs):
            if _is_identity(affine, old.shape):
                return IDENTITY
            bare, full = (old, new) if second.crs else (new, old)
            raise InputError(
                f"{new.name}: its geotransform is another than that of {old.name}, and {bare.name} has no coordinate "
                f"system while {full.name} has one: whether they show the same place cannot be told"
            )
        if not first.crs or _same_crs(first.crs, str(second.crs)):
            return IDENTITY if _is_identity(affine, old.shape) else affine
    return _by_sensors(old, new)


def _by_sensors(old: Placed, new: Placed) -> FloatArray:
    from featreg.geolocation import ConstantHeight, Transfer, ground_level, sensor_of

    try:
        sensors = [sensor_of(one.geolocation, one.shape, one.name) for one in (old, new)]
    except InputError as error:
        message = f"{new.name}: whether it shows the same place as {old.name} cannot be told ({error})"
        raise InputError(message) from error
    x, y = np.meshgrid(*(np.linspace(0, n - 1, NODES) for n in old.shape[::-1]))
    nodes = np.column_stack([x.ravel(), y.ravel()])
    level = ground_level(*sensors)[0]
    # An affine map must hold at any height of the ground.
    mapped = [Transfer(sensors[0], sensors[1], ConstantHeight(level + up))(nodes) for up in (0.0, 300.0)]
    design = np.column_stack([nodes, np.ones(len(nodes))])
    away = math.hypot(*(s.uncertainty_px for s in sensors)) if _by_points(first=old, second=new) else SAME_PX
    if not all(np.isfinite(m).all() for m in mapped):
        raise InputError(f"{new.name}: does not show the place of {old.name}, as their files say where they lie")
    if old.shape == new.shape and all(np.abs(m - nodes).max() <= away for m in mapped):
        return IDENTITY
    affine = np.linalg.lstsq(design, mapped[0])[0].T
    bent = max(float(np.hypot(*(m - design @ affine.T).T).max()) for m in mapped)
    if bent > BENT_PX:
        dx, dy = (mapped[0] - nodes).mean(axis=0)
        raise InputError(
            f"{new.name}: lies elsewhere than {old.name} by what their files say ({_kind(new)} against {_kind(old)}; "
            f"{dx:+.1f}, {dy:+.1f} px in the mean, bent by {bent:.2f} px): an affine map cannot hold that; give a file "
            "on the same grid"
        )
    return np.asarray(affine)


def _by_points(first: Placed, second: Placed) -> bool:
    """Whether one of two images is located by control points, which two programs seldom sample alike."""
    return any(_kind(one) == "ground control points" for one in (first, second))


def _kind(image: Placed) -> str:
    place = image.geolocation or Geolocation()
    if place.sensor is not None:
        return "orbit and timing"
    if place.rpcs is not None:
        return "RPC coefficients"
    return "ground control points" if place.transform is None else "a geotransform"


def _equal(first: Geolocation, second: Geolocation) -> bool:
    gcps = first.gcps, second.gcps
    points = gcps[0] is gcps[1] or (gcps[0] is not None and gcps[1] is not None and np.array_equal(gcps[0], gcps[1]))
    alike = (first.transform, first.crs) == (second.transform, second.crs)
    stated = all(dict(a or {}) == dict(b or {}) for a, b in ((first.rpcs, second.rpcs), (first.sensor, second.sensor)))
    return points and alike and stated


def _exact(place: Geolocation) -> bool:
    """Whether more than a geotransform says where an image lies."""
    return place.rpcs is not None or place.sensor is not None


def _same_crs(first: str, second: str) -> bool:
    if first == second:
        return True
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        return bool(CRS.from_user_input(first) == CRS.from_user_input(second))
    except CRSError:
        return False


def _turn(crs: str | None) -> float:
    """A whole turn in the units of a geographic coordinate system; 0 for any other."""
    if not crs:
        return 0.0
    from featreg.geolocation.projection import Projection

    return Projection(crs).turn


def _between(old: tuple[float, ...], new: tuple[float, ...], turn: float, shape: tuple[int, int]) -> FloatArray:
    """The affine map between the pixels of two geotransforms; `shape` is that of the second."""
    # Geotransforms count from the corner of the first pixel, we from its centre.
    to_corner = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    old_map, new_map = (np.array([t[:3], t[3:], (0.0, 0.0, 1.0)]) for t in (old, new))
    if turn:
        middle = (new_map @ [shape[1] / 2, shape[0] / 2, 1.0])[0]
        old_map[0, 2] -= turn * round((old_map[0, 2] - middle) / turn)
    return np.asarray((np.linalg.inv(to_corner) @ np.linalg.inv(new_map) @ old_map @ to_corner)[:2])


def _is_identity(affine: FloatArray, shape: tuple[int, int]) -> bool:
    corners = np.array([[0, 0], [shape[1] - 1, 0], [0, shape[0] - 1], [shape[1] - 1, shape[0] - 1]], np.float64)
    return bool(np.abs(corners @ affine[:, :2].T + affine[:, 2] - corners).max() <= SAME_PX)
