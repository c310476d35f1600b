"""Two looks at bright rectangles in clutter, one turned and shifted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.geometry import Rigid
from featreg.sar.obcls.association import Map

Floats = NDArray[np.float64]
SIZE = 320
CENTRE = np.array([[(SIZE - 1) / 2, (SIZE - 1) / 2]])


def rigid_fit(a: Floats, b: Floats) -> Map | None:
    return Rigid.from_estimate(a, b) or None


def rigid(rotation_deg: float, shift: tuple[float, float] = (0.0, 0.0)) -> Rigid:
    """Turned about the image centre, then shifted."""
    turned = Rigid(rotation_deg)
    dx, dy = (CENTRE - turned(CENTRE))[0] + shift
    return Rigid(rotation_deg, float(dx), float(dy))


def parking(truth: Rigid, seed: int = 0, targets: int = 45, seen: float = 0.8) -> tuple[Floats, Floats]:
    """Amplitudes of two looks at bright rectangles in clutter; each look misses some and has its own speckle."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-60, SIZE + 60, (targets * 2, 2))
    # No two on one spot.
    xy = xy[[i for i in range(len(xy)) if (np.hypot(*(xy[:i] - xy[i]).T) > 24).all()]]
    angle, size = rng.uniform(0, np.pi, len(xy)), rng.uniform(3, 8, (len(xy), 2))
    shine = rng.uniform(20, 80, len(xy))
    y, x = np.mgrid[:SIZE, :SIZE]
    grid = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    looks = []
    for way in (grid, truth.inverse(grid)):
        power = np.ones(len(grid))
        for i in np.flatnonzero(rng.random(len(xy)) < seen):
            d = way - xy[i]
            along = d @ [np.cos(angle[i]), np.sin(angle[i])]
            across = d @ [-np.sin(angle[i]), np.cos(angle[i])]
            edge = np.minimum(size[i, 0] - np.abs(along), size[i, 1] - np.abs(across))
            power += shine[i] * np.clip(edge + 0.5, 0, 1)
        looks.append(np.sqrt(power * rng.gamma(2.0, 0.5, len(grid))).reshape(SIZE, SIZE))
    return looks[0], looks[1]
