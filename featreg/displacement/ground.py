"""Displacements on the ground, in metres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from featreg.types import FloatArray, Geolocation

if TYPE_CHECKING:
    from featreg.displacement.field import Offsets


def ground_displacement(field: Offsets) -> FloatArray | None:
    """Return `Offsets.metres`."""
    here, there = field.reference.geolocation, field.secondary.geolocation
    size = field.reference.pixel_size
    if size is None or size.unit != "metre":
        return None
    xy = np.stack(np.meshgrid(field.x, field.y), -1)
    moved = xy + np.stack([field.dx, field.dy], -1)
    if _on_map(here) and _on_map(there) and here is not None and there is not None and here.crs == there.crs:
        # A unit of the projection in metres.
        a, _, _, d, _, _ = here.transform or (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        unit = size.x / float(np.hypot(a, d))
        return np.asarray((_mapped(there, moved) - _mapped(here, xy)) * unit)
    return np.asarray((moved - xy) * (size.x, size.y))


def is_on_map(field: Offsets) -> bool:
    """Whether the metres are to the east and to the north, not along the columns and the rows."""
    here, there = field.reference.geolocation, field.secondary.geolocation
    return _on_map(here) and _on_map(there) and here is not None and there is not None and here.crs == there.crs


def _on_map(place: Geolocation | None) -> bool:
    return place is not None and place.transform is not None and bool(place.crs) and place.rpcs is None


def _mapped(place: Geolocation, xy: FloatArray) -> FloatArray:
    a, b, c, d, e, f = place.transform or (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    # A geotransform counts from the corner of the first pixel.
    x, y = xy[..., 0] + 0.5, xy[..., 1] + 0.5
    return np.stack([a * x + b * y + c, d * x + e * y + f], axis=-1)
