"""An optical image in colours and a SAR band of another coordinate system and pixel size: matched by where they lie."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.cli.main import main
from featreg.results.registration import Registration

rasterio = pytest.importorskip("rasterio")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.realdata,
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
]
SIDE, SAR_CRS, OPTICAL_CRS = 1024, "EPSG:32611", "EPSG:3857"


def pair(data: Path, tile: str, folder: Path) -> tuple[Path, Path, Any, Any]:
    """The two tiles, which lie on one grid, as files of two grids, and their geotransforms."""
    from rasterio.transform import from_origin
    from rasterio.warp import Resampling, calculate_default_transform, reproject

    def read(name: str) -> NDArray[np.uint8]:
        with rasterio.open(data / "optical_sar" / name) as dataset:
            bands = dataset.read()[:, :SIDE, :SIDE]
        return np.asarray(bands if len(bands) >= 3 else np.repeat(bands[:1], 3, axis=0))[:3]

    sar, colours = read(f"s1_{tile}_sar.png")[0], read(f"s2_{tile}_optical.png")
    here = from_origin(500000, 4200000, 10, 10)
    ends = 500000, 4200000 - 10 * SIDE, 500000 + 10 * SIDE, 4200000
    there, width, height = calculate_default_transform(SAR_CRS, OPTICAL_CRS, SIDE, SIDE, *ends, resolution=16.5)
    optical = np.zeros((3, height, width), np.uint8)
    reproject(
        colours, optical, src_transform=here, src_crs=SAR_CRS, dst_transform=there, dst_crs=OPTICAL_CRS,
        resampling=Resampling.cubic,
    )  # fmt: skip
    one = {"driver": "GTiff", "dtype": "uint8"}
    paths = folder / "sar.tif", folder / "optical.tif"
    size = {"height": SIDE, "width": SIDE, "count": 2, "crs": SAR_CRS, "transform": here}
    with rasterio.open(paths[0], "w", **one, **size) as dataset:
        dataset.write(np.stack([sar[::-1], sar]))
        dataset.descriptions = ("VH", "VV")
    size = {"height": height, "width": width, "count": 3, "crs": OPTICAL_CRS, "transform": there}
    with rasterio.open(paths[1], "w", photometric="RGB", **one, **size) as dataset:
        dataset.write(optical)
    return *paths, here, there


@pytest.mark.parametrize("model", ["affine", "similarity"])
@pytest.mark.parametrize("tile", ["047", "060"])
def test_the_pair_is_registered(
    tile: str, model: str, realdata: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from rasterio.warp import transform

    sar, optical, here, there = pair(realdata, tile, tmp_path)
    out = tmp_path / "result.json"
    given = [
        "match",
        str(optical),
        str(sar),
        "--method",
        "optical-sar",
        "--model",
        model,
        "--secondary-band",
        "VV",
        "--json",
        str(out),
    ]
    assert main(given) == 0, capsys.readouterr()
    result = Registration.from_json(out)
    assert json.loads(out.read_text())["reference"]["band"] == "rgb"
    assert json.loads(out.read_text())["secondary"]["band"] == "VV"
    assert result.provenance["frame"]["source"] == "geolocation"
    # The one projection stretches the other's squares by 0.2 %: no similarity in pixels.
    assert result.provenance["frame"].get("model") == (None if model == "affine" else "similarity")
    assert json.loads(out.read_text())["model"]["type"] == "affine"
    points = np.array([(x, y) for x in np.linspace(60, 720, 8) for y in np.linspace(60, 720, 8)])
    ground = [there * (x + 0.5, y + 0.5) for x, y in points]
    east, north = transform(OPTICAL_CRS, SAR_CRS, [e for e, _ in ground], [n for _, n in ground])
    truth = np.array([~here * (e, n) for e, n in zip(east, north, strict=True)]) - 0.5
    away = np.hypot(*(result.model(points) - truth).T)
    # In pixels of 10 m. The method does not refine: its tie points are 2 to 3 px off, and the tiles themselves about 1.
    # A shear is not for the tie points to say.
    assert np.median(away) < (4.0 if model == "affine" else 3.0)
    assert away.max() < (8.0 if model == "affine" else 6.0)
