"""A registration of twelve tie points between two files, for what writes tie points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from featreg.geometry import Affine
from featreg.io import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches

PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
MODEL = Affine(np.array([[0.99, 0.05, 3.25], [-0.05, 1.01, -2.5]]))
SHAPE = (90, 120)
# The first tie point is the first pixel's centre in both images.
REFERENCE = np.vstack([[0.0, 0.0], np.random.default_rng(0).uniform(5, 80, (11, 2))])
SECONDARY = np.vstack([[0.0, 0.0], MODEL(REFERENCE[1:])])


def registration_in(folder: Path, place: Geolocation | None = PLACE, status: str = "ok") -> Registration:
    """Twelve tie points, two of them no inliers, and files of both images."""
    rng = np.random.default_rng(1)
    write_geotiff(folder / "ref.tif", rng.integers(1, 200, SHAPE).astype(np.uint16), place)
    write_geotiff(folder / "sec.tif", rng.integers(1, 200, SHAPE).astype(np.uint16), nodata=0)
    score = np.arange(12.0)
    score[3] = np.nan
    matches = Matches(REFERENCE, SECONDARY, score)
    inliers = np.arange(12) < 10
    paths = {"reference": folder / "ref.tif", "secondary": folder / "sec.tif"}
    images: dict[str, Any] = {role: InputImage(str(path), SHAPE) for role, path in paths.items()}
    stages = {"gms": np.arange(12) < 11, "fsc": inliers}
    reason = "" if status == "ok" else "made up"
    return Registration(matches, stages, inliers, MODEL, status, reason, provenance={"method": "m"}, **images)
