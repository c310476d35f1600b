"""Scene pairs of the tables: simulated ones after Table 1 of the SAR-ORB paper, and a real mosaic under a known warp.

Every pair is written once into a folder and found there again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from measuring import DATA, random_affine, read
from numpy.typing import NDArray

from featreg.simulate.scene import simulate_scene

#: Pair -> incidence angles of both images in degrees, as Table 1 has them: small, middle and large differences.
INCIDENCES = {"Im1 & Im2": (48.02, 48.83), "Im1 & Im3": (48.02, 45.54), "Im1 & Im4": (48.02, 53.79)}
#: Metres between valley and hill, and metres of a pixel, of the simulated scenes.
RELIEF, PIXEL = 100.0, 3.0
#: By how much, px, the geotransform of the real mosaic's second image is wrong, and looks of the speckle on it.
WRONG_BY, LOOKS = (6.0, -5.0), 4.0


def simulated_scenes(folder: Path, shape: tuple[int, int], seed: int, count: int) -> Iterator[dict[str, Any]]:
    """Pairs with RPCs and relief, in the order of their difference of incidence."""
    for k, (name, angles) in enumerate(list(INCIDENCES.items())[:count]):
        place = folder / f"simulated-{shape[0]}x{shape[1]}-{seed}-{k}"
        if not (place / "truth.json").exists():
            simulate_scene(
                place, shape, relief=RELIEF, incidence_deg=angles, heading_deg=(-12.0, -11.8), pixel=(PIXEL, PIXEL),
                seed=seed + k,
            )  # fmt: skip
        files = {role: place / f"{role}.tif" for role in ("reference", "secondary", "dem")}
        yield {"name": f"{name}, simulated", **files, "truth": place / "truth.json"}


def real_scene(folder: Path, seed: int) -> Iterator[dict[str, Any]]:
    """The mosaic and its warp, each under speckle of its own; geotransforms say where they lie, a little wrongly."""
    found = sorted((DATA / "sentinel1_mosaic").glob("*.png"))
    if not found:
        return
    place = folder / f"mosaic-{seed}"
    if not (place / "truth.json").exists():
        place.mkdir(parents=True, exist_ok=True)
        scene, rng = read(found[0]).astype(np.float32) + 1, np.random.default_rng(seed)
        shape = scene.shape[0], scene.shape[1]
        truth = random_affine(rng, shape, 3.0, 0.01, 25.0)
        size = shape[1], shape[0]
        turned = cv2.warpAffine(scene, truth, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
        seen = cv2.warpAffine(np.ones_like(scene), truth, size, flags=cv2.INTER_NEAREST)
        for name, image, place_of in (("reference", scene, np.eye(3)), ("secondary", turned * seen, _stated(truth))):
            speckle = np.sqrt(rng.gamma(LOOKS, 1 / LOOKS, shape)).astype(np.float32)
            _write(place / f"{name}.tif", np.maximum(image, 0) * speckle, place_of)
        (place / "truth.json").write_text(json.dumps({"matrix": truth.tolist()}), encoding="utf-8")
    files = {role: place / f"{role}.tif" for role in ("reference", "secondary")}
    yield {"name": "Los Angeles, real", **files, "truth": place / "truth.json"}


def _stated(truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) pixels of the secondary -> pixels of the reference, as its file has it."""
    wrong = truth.copy()
    wrong[:, 2] += WRONG_BY
    return np.asarray(np.linalg.inv(np.vstack([wrong, [0.0, 0.0, 1.0]])))


def transform_of(to_reference: NDArray[np.float64]) -> Any:
    """The geotransform of an image whose pixels lie at these ones of the reference, of 10 m on a map projection."""
    from rasterio.transform import Affine

    # GDAL counts from the corner of the first pixel.
    ground = Affine(10.0, 0.0, 380_000.0, 0.0, -10.0, 3_780_000.0) @ Affine.translation(0.5, 0.5)
    a, b, c, d, e, f = to_reference[:2].ravel().tolist()
    return ground @ Affine(a, b, c, d, e, f) @ ~Affine.translation(0.5, 0.5)


def _write(path: Path, image: NDArray[np.float32], to_reference: NDArray[np.float64]) -> None:
    import rasterio

    transform = transform_of(to_reference)
    samples = np.clip(np.rint(image * 50), 0, 65535).astype(np.uint16)
    profile = {"driver": "GTiff", "height": image.shape[0], "width": image.shape[1], "count": 1, "dtype": "uint16"}
    with rasterio.open(path, "w", **profile, nodata=0, crs="EPSG:32611", transform=transform, tiled=True) as out:
        out.write(samples, 1)
