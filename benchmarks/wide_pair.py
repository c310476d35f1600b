"""A pair of scenes as wide as one likes, of real SAR texture, under a known affine map.

The texture is the Sentinel-1 mosaic of the real images, mirrored at its rims over and over; without it a simulated
scene of few looks less. Each image has speckle of its own, drawn tile by tile, so that memory does not grow with it.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from measuring import DATA, read
from numpy.typing import NDArray
from scenes import LOOKS, WRONG_BY, transform_of

from featreg.simulate import sar_pair, similarity_matrix

#: Side of a tile that is painted at once, and of a tile of the files, px.
PAINTED, TILE = 2048, 512
#: Turn in degrees and zoom of the secondary, and its shift in px.
TURN, ZOOM, SHIFT = 1.5, 1.001, (14.3, -9.6)
#: Amplitude of the texture's unit, and how many different values of speckle are drawn from.
UNIT, SPECKLES = 20.0, 1 << 16


def texture() -> NDArray[np.float32]:
    """Amplitudes without much speckle, nowhere 0."""
    found = sorted((DATA / "sentinel1_mosaic").glob("*.png"))
    image = read(found[0]) if found else sar_pair((2048, 3072), looks=math.inf).reference
    image = np.asarray(image, np.float32)
    return np.asarray(cv2.GaussianBlur(image * (118 / image.mean()) + 1, (0, 0), 0.8), np.float32)


def wide_pair(folder: Path, shape: tuple[int, int], seed: int = 7) -> Path:
    """The folder of the pair of that shape, written where it is not there yet: two tiled GeoTIFFs and the truth.

    Both say where they lie, the secondary wrong by `WRONG_BY`.
    """
    place = folder / f"wide-{shape[0]}x{shape[1]}-{seed}"
    if (place / "truth.json").exists():
        return place
    print(f"writing {shape[0]} x {shape[1]}", file=sys.stderr)
    place.mkdir(parents=True, exist_ok=True)
    truth = similarity_matrix(shape, TURN, ZOOM, SHIFT)
    stated = truth.copy()
    stated[:, 2] += WRONG_BY
    field = texture()
    # One period of its mirror images, and what a tile may reach beyond it.
    beyond = PAINTED + PAINTED // 8
    period = 2 * (field.shape[1] - 1), 2 * (field.shape[0] - 1)
    mirrored = np.pad(
        field, ((0, period[1] + beyond - field.shape[0]), (0, period[0] + beyond - field.shape[1])), "reflect"
    )
    for k, (name, map_of, said) in enumerate(
        (("reference", np.eye(3)[:2], np.eye(3)[:2]), ("secondary", truth, stated))
    ):
        back, ground = (np.linalg.inv(np.vstack([m, [0.0, 0.0, 1.0]])) for m in (map_of, said))
        profile = {
            "driver": "GTiff", "height": shape[0], "width": shape[1], "count": 1, "dtype": "uint16", "nodata": 0,
            "tiled": True, "blockxsize": TILE, "blockysize": TILE, "crs": "EPSG:32611",
            "transform": transform_of(ground),
        }  # fmt: skip
        with rasterio.open(place / f"{name}.tif", "w", **profile) as out:
            for y in range(0, shape[0], PAINTED):
                for x in range(0, shape[1], PAINTED):
                    size = min(PAINTED, shape[1] - x), min(PAINTED, shape[0] - y)
                    rng = np.random.default_rng([seed, k, y, x])
                    tile = _painted(mirrored, period, back, (x, y), size, rng)
                    out.write(tile, 1, window=rasterio.windows.Window(x, y, *size))
    (place / "truth.json").write_text(json.dumps({"matrix": truth.tolist()}), encoding="utf-8")
    return place


def _painted(
    mirrored: NDArray[np.float32],
    period: tuple[int, int],
    back: NDArray[np.float64],
    at: tuple[int, int],
    size: tuple[int, int],
    rng: np.random.Generator,
) -> NDArray[np.uint16]:
    """One tile at a column and row: the texture seen through a map from its pixels, under speckle."""
    corners = np.array([[0, 0], [size[0], 0], [0, size[1]], size], np.float64) + at
    low = np.floor((corners @ back[:2, :2].T + back[:2, 2]).min(axis=0)) - 2
    left, top = (int(v) % p for v, p in zip(low, period, strict=True))
    matrix = back[:2].copy()
    # From the tile's pixels to those of the cut, a whole number of periods away.
    matrix[:, 2] = back[:2, :2] @ at + back[:2, 2] - low
    reach = PAINTED + PAINTED // 8
    cut = mirrored[top : top + reach, left : left + reach]
    seen: Any = cv2.warpAffine(cut, matrix, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    table = (UNIT * np.sqrt(rng.gamma(LOOKS, 1 / LOOKS, SPECKLES))).astype(np.float32)
    seen *= table[rng.integers(0, SPECKLES, seen.shape, np.uint16)]
    # 0 is nodata.
    return np.asarray(np.clip(seen, 1, 65535, out=seen), np.uint16)
