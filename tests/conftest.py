"""Fixtures that several test files share; all synthetic images are seeded."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.simulate import SimulatedPair, sar_pair

Texture = Callable[..., NDArray[np.float32]]


def _texture(
    height: int = 200, width: int = 220, seed: int = 0, looks: float = 4.0, relief: float = 0.6
) -> NDArray[np.float32]:
    """Smooth fields with dark ponds and bright squares under speckle: (H, W) linear amplitude, mean about 1."""
    import cv2

    rng = np.random.default_rng(seed)
    fields = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 6.0)
    scene = np.exp(relief * fields / fields.std())
    for _ in range(height * width // 1500):
        x, y, r = (int(rng.integers(k)) for k in (width, height, 6))
        cv2.circle(scene, (x, y), r + 3, float(rng.choice([0.1, 0.3])), -1)
    for _ in range(height * width // 1500):
        x, y, w, h = (int(rng.integers(k)) for k in (width, height, 9, 9))
        cv2.rectangle(scene, (x, y), (x + w + 2, y + h + 2), float(rng.choice([3.0, 8.0])), -1)
    speckle = rng.gamma(looks, 1.0 / looks, (height, width))
    return np.asarray(np.sqrt(scene * speckle), np.float32)


@pytest.fixture(scope="session")
def sar_texture() -> Texture:
    """Factory of seeded amplitude images: ``sar_texture(height, width, seed, looks)``."""
    return _texture


@pytest.fixture(scope="session")
def pair() -> SimulatedPair:
    """300 x 300, four looks, turned by 6 degrees, scale 1.02."""
    return sar_pair((300, 300), seed=1)


@pytest.fixture(scope="session")
def turned_pair() -> SimulatedPair:
    """300 x 300, four looks, turned by 30 degrees."""
    return sar_pair((300, 300), rotation_deg=30.0, scale=1.0, shift=(3.0, -2.0), seed=2)


@dataclass(frozen=True)
class LocatedPair:
    """Two GeoTIFFs on tilted grids of one map projection, and the (2, 3) truth reference -> secondary."""

    reference: Path
    secondary: Path
    truth: NDArray[np.float64]
    bias: tuple[float, float]


@pytest.fixture(scope="session")
def located_pair(tmp_path_factory: pytest.TempPathFactory) -> LocatedPair:
    """700 x 800, 16 bits, turned by 1.5 degrees; the secondary's geotransform is off by (9, -7) px.

    A corner of the reference is nodata.
    """
    import rasterio
    from rasterio.transform import Affine

    folder, bias = tmp_path_factory.mktemp("located"), (9.0, -7.0)
    pair = sar_pair((700, 800), rotation_deg=1.5, scale=1.005, shift=(20.0, -14.0), seed=3)
    here = Affine(10.0, 0.0, 500_000.0, 0.0, -10.0, 4_000_000.0)
    (a, b, c), (d, e, f) = pair.truth.tolist()
    # GDAL counts pixels from the corner; its secondary pixel is the true one plus the bias.
    half = Affine.translation(0.5, 0.5)
    there = here @ half @ ~Affine(a, b, c + bias[0], d, e, f + bias[1]) @ ~half
    for name, array, transform in (("reference", pair.reference, here), ("secondary", pair.secondary, there)):
        samples = np.clip(np.rint(array * 300), 1, 65535).astype(np.uint16)
        if name == "reference":
            samples[:280, :280] = 0
        profile = {"driver": "GTiff", "height": 700, "width": 800, "count": 1, "dtype": "uint16", "nodata": 0}
        tiles = {"tiled": True, "blockxsize": 256, "blockysize": 256}
        with rasterio.open(
            folder / f"{name}.tif", "w", **profile, **tiles, crs="EPSG:32633", transform=transform
        ) as dataset:
            dataset.write(samples, 1)
    return LocatedPair(folder / "reference.tif", folder / "secondary.tif", pair.truth, bias)


@pytest.fixture
def scratch(monkeypatch: pytest.MonkeyPatch) -> dict[tuple[str, str], registry.Entry]:
    """The registry with a copy of its list, put back afterwards."""
    registry.available("detector")
    copy = dict(registry._entries)
    monkeypatch.setattr(registry, "_entries", copy)
    monkeypatch.setattr(registry, "_broken", dict(registry._broken))
    return copy


@pytest.fixture(scope="session")
def realdata() -> Path:
    """The folder of real SAR images that FEATREG_DATA names; tests that need it are skipped where it is absent."""
    usual = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("FEATREG_DATA", usual))
    if not folder.is_dir():
        pytest.skip(f"no real images at {folder}")
    return folder


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A real browser without a network of its own, driven by Playwright; skipped where either is missing."""
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="pages are tested with Playwright: pip install playwright"
    )
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next((path for path in map(shutil.which, names) if path), None)
    if found is None:
        pytest.skip(f"pages are tested in a real browser, and none of {', '.join(names)} is on the PATH")
    flags = ("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
             "--disable-component-update", "--disable-sync")  # fmt: skip
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=list(flags))
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def accessible() -> Callable[[Any], None]:
    """Fails where axe-core finds a violation of WCAG 2.2 A and AA, or of its best practice, on a page on show.

    The script is that of the npm package axe-core: of FEATREG_AXE, of ``.venv/node_modules`` (``npm install --prefix
    .venv axe-core``), or installed globally; skipped where there is none.
    """
    own = Path(__file__).parents[1] / ".venv/node_modules/axe-core/axe.min.js"
    places = [os.environ.get("FEATREG_AXE", ""), str(own)]
    npm = shutil.which("npm")
    if npm is not None:
        root = subprocess.run([npm, "root", "--global"], capture_output=True, text=True, check=False).stdout.strip()
        places.append(str(Path(root, "axe-core/axe.min.js")))
    script = next((Path(place) for place in places if place and Path(place).is_file()), None)
    if script is None:
        pytest.skip("accessibility is looked at by axe-core: npm install --prefix .venv axe-core")
    source = script.read_text(encoding="utf-8")

    def check(page: Any) -> None:
        page.evaluate(f"{source}; undefined")
        found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        assert len(found["passes"]) > 10, "axe-core has not looked"
        said = [
            f"{v['id']} ({v['impact']}): {v['help']}: {[n['html'][:160] for n in v['nodes'][:3]]}"
            for v in found["violations"]
        ]
        assert not said, "\n".join(said)

    return check
