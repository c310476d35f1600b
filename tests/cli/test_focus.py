"""`featreg focus`: what it writes, its exit codes, and one line for whatever is wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from featreg.focusing.azimuth_filter import image_entropy
from featreg.io import as_image, write_geotiff
from featreg.types import Geolocation

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Blurred points as GeoTIFF, NPY and MATLAB file, speckle, and a real image."""
    from scipy.io import savemat

    home = tmp_path_factory.mktemp("focus")
    rng = np.random.default_rng(0)
    n = 192
    f = np.fft.fftfreq(n)
    spectrum = 0.02 * np.fft.fft2(rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n)))
    for i in range(30):
        row = rng.uniform(40, 150)
        spectrum += np.exp(2j * np.pi * (rng.uniform() - np.add.outer(f * row, f * (6 * i + 5))))
    keep = np.abs(f) < 0.4
    u = 2 * f
    spectrum *= (keep * np.exp(1j * (9 * u**2 - 5 * u**4)))[:, None] * keep
    image = np.fft.ifft2(spectrum).astype(np.complex64)
    write_geotiff(home / "blurred.tif", image, PLACE)
    np.save(home / "blurred.npy", image)
    savemat(home / "blurred.mat", {"img": image.T})
    noise = rng.normal(size=(96, 96)) + 1j * rng.normal(size=(96, 96))
    np.save(home / "speckle.npy", noise.astype(np.complex64))
    np.save(home / "real.npy", np.abs(image))
    return home


@pytest.fixture
def focus(run: Run) -> Run:
    """Run `featreg focus` in that folder."""
    return lambda *arguments: run("focus", *arguments)


def test_a_geotiff_keeps_its_place(focus: Run, tmp_path: Path) -> None:
    target, picture, record = tmp_path / "out.tif", tmp_path / "out.png", tmp_path / "out.json"
    code, out, err = focus("blurred.tif", "-o", str(target), "--plot", str(picture), "--json", str(record))
    assert (code, err) == (0, "")
    assert out.splitlines()[0] == "ok"
    made, given = as_image(target), as_image("blurred.tif")
    assert made.is_complex
    assert made.geolocation is not None
    assert made.geolocation.transform == PLACE.transform
    assert image_entropy(made.pixels) < image_entropy(given.pixels) - 0.2
    assert picture.read_bytes().startswith(b"\x89PNG")
    data = json.loads(record.read_text(), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert data["status"] == "ok"
    assert len(data["phase"]) == 192
    turned = np.fft.ifft(np.fft.fft(given.pixels, axis=0) * np.exp(-1j * np.array(data["phase"]))[:, None], axis=0)
    np.testing.assert_allclose(made.pixels, turned, atol=1e-5 * np.abs(turned).max())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.json", "out.png", "out.tif"]


@pytest.mark.parametrize("source", ["blurred.npy", "blurred.mat:img"])
def test_arrays_and_matlab_files(focus: Run, tmp_path: Path, source: str) -> None:
    target = tmp_path / "out.npy"
    axis = "1" if "mat" in source else "0"
    code, out, _ = focus(source, "-o", str(target), "--method", "mea", "--azimuth-axis", axis, "--fraction", "0.3")
    assert code == 0
    assert "58 range cells" in out
    assert np.load(target).dtype == np.complex64


def test_range_blocks(focus: Run, tmp_path: Path) -> None:
    record = tmp_path / "o.json"
    options = ("--method", "mea", "--fraction", "1", "--range-blocks", "2", "--json", str(record))
    code, out, _ = focus("blurred.npy", "-o", str(tmp_path / "o.npy"), "--plot", str(tmp_path / "o.png"), *options)
    assert code == 0
    assert "2 range blocks" in out
    assert np.array(json.loads(record.read_text())["phase"]).shape == (2, 192)


def test_what_cannot_be_trusted_is_written_and_exits_with_3(focus: Run, tmp_path: Path) -> None:
    target = tmp_path / "out.npy"
    code, out, _ = focus("speckle.npy", "-o", str(target), "--plot", str(tmp_path / "out.png"))
    assert code == 3
    assert out.startswith("unreliable: ")
    assert target.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("missing.npy", "-o", "o.npy"), "no such file"),
        (("real.npy", "-o", "o.npy"), "complex"),
        (("blurred.npy",), "--output"),
        (("blurred.npy", "-o", "o.png"), "must end in"),
        (("blurred.npy", "-o", "blurred.npy"), "replace an input"),
        (("blurred.mat:img", "-o", "o.npy", "--plot", "o.jpg"), "must end in .png"),
        (("blurred.npy", "-o", "nowhere/o.npy"), "does not exist"),
        (("blurred.npy", "-o", "o.npy", "--method", "mae"), "did you mean"),
        (("blurred.npy", "-o", "o.npy", "--methd", "mea"), "unknown option"),
        (("blurred.npy", "-o", "o.npy", "--azimuth-axis", "2"), "azimuth_axis"),
        (("blurred.npy", "-o", "o.npy", "--fraction", "2"), "fraction"),
        (("blurred.npy", "-o", "o.npy", "--range-blocks", "500"), "range_blocks"),
        (("blurred.npy", "-o", "o.npy", "--detector", "prewit", "--method", "pmea"), "prewitt"),
    ],
)
def test_whatever_is_wrong_is_one_line(focus: Run, folder: Path, arguments: tuple[str, ...], words: str) -> None:
    code, out, err = focus(*arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert words in err
    assert not (folder / "o.npy").exists()
