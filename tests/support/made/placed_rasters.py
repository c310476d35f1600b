"""Small images with a place, as files, in archives and as a product of Sentinel-1."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray

from made.rasters import write_raster

H, W = 60, 90
RNG = np.random.default_rng(5)
AMPLITUDE = (RNG.gamma(2, 30, (H, W)) + 1).astype(np.float32)
BYTES = np.clip(AMPLITUDE, 1, 250).astype(np.uint8)
COMPLEX = np.round(AMPLITUDE * np.exp(1j * RNG.uniform(0, 6, (H, W)))).astype(np.complex64)
CRS = "EPSG:32611"
TRANSFORM = (10.0, 0.0, 500000.0, 0.0, -10.0, 4200000.0)


def write(path: Path, array: NDArray[Any], driver: str, place: bool = True, **more: Any) -> Path:
    """Write (H, W) or (B, H, W) with rasterio, on the grid of `TRANSFORM` or on none."""
    where = {"crs": CRS, "transform": rasterio.Affine(*TRANSFORM)} if place else {}
    return write_raster(path, array, driver, **(where | more))


def archive(folder: Path) -> Path:
    write(folder / "a.tif", AMPLITUDE, "GTiff")
    with zipfile.ZipFile(folder / "p.zip", "w", zipfile.ZIP_DEFLATED) as file:
        file.write(folder / "a.tif", "inside/a.tif")
        file.writestr("readme.txt", "words")
    return folder / "p.zip"


def safe(folder: Path) -> Path:
    from rasterio.control import GroundControlPoint

    root = folder / "S1A_IW_GRDH_1SDV_x.SAFE"
    (root / "measurement").mkdir(parents=True)
    gcps = [GroundControlPoint(r, c, -118 + c * 1e-4, 34 - r * 1e-4, 12.0) for r in (0, H) for c in (0, W // 2, W)]
    objects = ""
    for pol, gain in (("vv", 1), ("vh", 2)):
        name = f"measurement/s1a-iw-grd-{pol}-20200101t000000-20200101t000025-030000-036fd5-001.tiff"
        write(root / name, (AMPLITUDE * gain).astype(np.uint16), "GTiff", False, crs="EPSG:4326", gcps=gcps)
        objects += f'<dataObject><byteStream><fileLocation href="./{name}"/></byteStream></dataObject>'
    (root / "manifest.safe").write_text(f"<XFDU><dataObjectSection>{objects}</dataObjectSection></XFDU>")
    return root
