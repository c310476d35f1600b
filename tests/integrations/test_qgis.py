"""The provider for QGIS in a real QGIS without a window: register, warp, tie points as layers, offsets."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from featreg.io import as_image, write_geotiff
from featreg.results.registration import Registration
from featreg.simulate import sar_pair
from featreg.types import Geolocation

ROOT = Path(__file__).parents[2]
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
# Debian's qgis_process hands on an option that the program does not know.
QGIS = shutil.which("qgis_process.bin") or shutil.which("qgis_process")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("qgis"),
    pytest.mark.skipif(QGIS is None, reason="QGIS is not installed"),
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
]


class Qgis:
    """`qgis_process` with a profile of its own, in which the provider is switched on."""

    def __init__(self, home: Path) -> None:
        self.home = home
        runtime = home / "runtime"
        runtime.mkdir(mode=0o700)
        # The Python of QGIS is the system's, whatever virtual environment this is.
        self.environment = {
            "PATH": "/usr/bin:/bin", "HOME": str(home), "QT_QPA_PLATFORM": "offscreen",
            "XDG_RUNTIME_DIR": str(runtime), "QGIS_CUSTOM_CONFIG_PATH": str(home / "profile"),
            "QGIS_PLUGINPATH": str(ROOT / "docs" / "integrations" / "qgis"),
            "FEATREG_PROGRAM": str(Path(sys.executable).with_name("featreg")),
            "LANG": os.environ.get("LANG", "C.UTF-8"), "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip

    def __call__(self, *arguments: str) -> tuple[int, str]:
        assert QGIS is not None
        done = subprocess.run(
            [QGIS, *arguments], cwd=self.home, env=self.environment, capture_output=True, text=True, timeout=300
        )
        return done.returncode, done.stdout + done.stderr

    def run(self, algorithm: str, **parameters: str) -> tuple[int, str]:
        return self("run", f"featreg:{algorithm}", "--", *(f"{name}={value}" for name, value in parameters.items()))


@pytest.fixture(scope="module")
def qgis(tmp_path_factory: pytest.TempPathFactory) -> Qgis:
    """QGIS, and in its folder a pair of which the reference lies on a map, with its registration."""
    made = Qgis(tmp_path_factory.mktemp("qgis"))
    pair = sar_pair((200, 200), rotation_deg=3.0, scale=1.0, shift=(3.0, -2.0), seed=1)
    write_geotiff(made.home / "ref.tif", pair.reference, PLACE)
    write_geotiff(made.home / "sec.tif", pair.secondary)
    write_geotiff(made.home / "flat.tif", np.zeros((200, 200), np.float32))
    code, said = made("plugins", "enable", "featreg_processing")
    if code or "featreg_processing" not in said:
        pytest.skip(f"QGIS does not load plugins of Python here: {said[-200:]}")
    code, said = made.run(
        "register", REFERENCE="ref.tif", SECONDARY="sec.tif", METHOD="sar-orb", RESULT=str(made.home / "result.json"),
        ALIGNED=str(made.home / "aligned.tif"), EXTRA="--n-features 1000",
    )  # fmt: skip
    assert code == 0, said
    assert "STATUS:\tok" in said
    assert "ROTATION:\t3.0" in said or "ROTATION:\t2.9" in said
    return made


def test_what_register_writes_is_what_featreg_writes(qgis: Qgis) -> None:
    result = Registration.from_json(qgis.home / "result.json")
    assert result.status == "ok"
    assert int(result.inliers.sum()) <= 1000
    aligned, reference = as_image(qgis.home / "aligned.tif"), as_image(qgis.home / "ref.tif")
    assert aligned.geolocation is not None
    assert aligned.geolocation.transform == PLACE.transform
    assert np.corrcoef(aligned.pixels[aligned.mask], reference.pixels[aligned.mask])[0, 1] > 0.5


def test_tie_points_and_arrows_lie_where_the_images_do(qgis: Qgis) -> None:
    geopandas = pytest.importorskip("geopandas", reason="geopandas is not installed")
    layers = {name: str(qgis.home / f"{name}.gpkg") for name in ("points", "arrows")}
    code, said = qgis.run(
        "tiepoints", RESULT=str(qgis.home / "result.json"), POINTS=layers["points"], ARROWS=layers["arrows"]
    )
    assert code == 0, said
    points, arrows = (geopandas.read_file(path).to_crs("EPSG:32632") for path in layers.values())
    result = Registration.from_json(qgis.home / "result.json")
    final = result.matches.take(result.inliers)
    assert len(points) == len(arrows) == len(final)

    def pixels(x: object, y: object) -> np.ndarray:
        return np.column_stack([(np.asarray(x) - 5e5) / 10, (6e6 - np.asarray(y)) / 10]) - 0.5

    np.testing.assert_allclose(pixels(points.geometry.x, points.geometry.y), final.reference_xy, atol=0.01)
    starts = np.array([line.coords[0] for line in arrows.geometry])
    np.testing.assert_allclose(pixels(*starts.T), final.reference_xy, atol=0.01)
    np.testing.assert_allclose(points["secondary_x"], final.secondary_xy[:, 0], atol=1e-6)
    lengths = arrows.geometry.length / 10
    # The secondary has no place of its own: the arrow is the residual.
    np.testing.assert_allclose(lengths, result.residuals()[result.inliers], atol=0.02)


def test_warp_and_offsets_of_the_aligned_image(qgis: Qgis) -> None:
    code, said = qgis.run(
        "warp", RESULT=str(qgis.home / "result.json"), SECONDARY="sec.tif", REFERENCE="ref.tif", RESAMPLING="2",
        ALIGNED=str(qgis.home / "again.tif"),
    )  # fmt: skip
    assert (code, "covered" in said) == (0, True), said
    code, said = qgis.run(
        "offsets", REFERENCE="ref.tif", SECONDARY="again.tif", STEP="32", OFFSETS=str(qgis.home / "offsets.tif")
    )
    assert code == 0, said
    import rasterio

    with rasterio.open(qgis.home / "offsets.tif") as file:
        assert file.descriptions[:2] == ("dx", "dy")
        assert np.nanmax(np.abs(np.nanmedian(file.read([1, 2]), axis=(1, 2)))) < 0.1


def test_what_is_refused_or_not_trusted_is_said(qgis: Qgis) -> None:
    code, said = qgis.run("register", REFERENCE="ref.tif", SECONDARY="flat.tif", RESULT=str(qgis.home / "no.json"))
    assert code != 0
    assert "flat.tif" in said
    assert "same value" in said
    data = json.loads((qgis.home / "result.json").read_text())
    (qgis.home / "bad.json").write_text(json.dumps({**data, "status": "unreliable", "reason": "made up"}))
    code, said = qgis.run(
        "warp", RESULT=str(qgis.home / "bad.json"), SECONDARY="sec.tif", ALIGNED=str(qgis.home / "b.tif")
    )
    assert code == 0
    assert "made up" in said
    assert "cannot be trusted" in said
    assert (qgis.home / "b.tif").is_file()
    qgis.environment["FEATREG_PROGRAM"] = "no-such-featreg"
    code, said = qgis.run("warp", RESULT="result.json", SECONDARY="sec.tif", ALIGNED=str(qgis.home / "c.tif"))
    assert code != 0
    assert "'no-such-featreg' is no program" in said
