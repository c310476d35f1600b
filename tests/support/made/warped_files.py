"""Two files, a result that maps one onto the other, and what is read of a product."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.io import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches

PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
MOVE = Affine(np.array([[0.99, 0.03, 4.3], [-0.03, 1.01, 7.6]]))
SHAPE = (300, 340)


def texture(height: int, width: int, *, seed: int = 0) -> NDArray[np.float32]:
    import cv2

    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(100.0 + 300.0 * np.abs(smooth), np.float32)


def registration(
    folder: Path, model: Any = MOVE, size: tuple[int, int] = SHAPE, scale: str = "amplitude", status: str = "ok"
) -> Registration:
    paths = {"reference": folder / "ref.tif", "secondary": folder / "sec.tif"}
    images: dict[str, Any] = {role: InputImage(str(path), size, scale) for role, path in paths.items()}
    reason = "" if status == "ok" else "made up"
    return Registration(
        Matches.empty(), {}, np.zeros(0, bool), model, status, reason, provenance={"method": "m"}, **images
    )


def files(
    folder: Path, samples: NDArray[Any], *, place: Geolocation | None = PLACE, nodata: float | None = None
) -> None:
    write_geotiff(folder / "ref.tif", texture(samples.shape[0], samples.shape[1], seed=5), place)
    write_geotiff(folder / "sec.tif", samples, nodata=nodata)


def read(path: Path) -> tuple[NDArray[Any], Any]:
    with rasterio.open(path) as dataset:
        return dataset.read(), dataset.profile | {"tags": dataset.tags(), "image": dataset.tags(ns="IMAGE_STRUCTURE")}
