"""Points marked on two images, of which one lies under a known model of the other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from featreg.geometry import Affine
from featreg.marking.points import MarkedPoints

TRUTH = Affine(np.array([[1.01, -0.05, 4.0], [0.04, 0.99, 7.0]]))
PLACES = np.array([[10.0, 12.0], [90.0, 15.0], [20.0, 80.0], [85.0, 70.0], [50.0, 40.0]])
SHAPES = ((100, 120), (140, 150))


def marked(path: Path, count: int = 0, **more: Any) -> MarkedPoints:
    points = MarkedPoints(path, ("a.tif", "b.tif"), SHAPES, **more)
    for reference, secondary in zip(PLACES[:count].tolist(), TRUTH(PLACES[:count]).tolist(), strict=True):
        points.add(reference, secondary)
    return points
