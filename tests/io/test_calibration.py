"""Calibration by look-up tables that the test writes: linear ones are interpolated exactly."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from featreg.errors import InputError, ParameterError
from featreg.io.calibration import Calibration, calibrated
from featreg.io.window import Window

SHAPE = (60, 80)


def value(pixel: Any, line: Any) -> Any:
    return 300.0 + 0.5 * pixel + 0.25 * line


def xml() -> str:
    vectors = []
    # The first lies before the image, as those of SLC do.
    for line in (-20, 10, 40, 90):
        pixels = [0, 30, 79]
        tables = "".join(
            f"<{name} count='3'>{' '.join(str(factor * value(p, line)) for p in pixels)}</{name}>"
            for name, factor in (("sigmaNought", 1.0), ("betaNought", 0.5), ("gamma", 0.8))
        )
        vectors.append(
            f"<calibrationVector><line>{line}</line><pixel>{' '.join(map(str, pixels))}</pixel>{tables}"
            "</calibrationVector>"
        )
    return f"<calibration><calibrationVectorList>{''.join(vectors)}</calibrationVectorList></calibration>"


@pytest.fixture(params=["grd", "slc"])
def measurement(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Path, Any]:
    folder = tmp_path / "S1A.SAFE"
    for name in ("annotation/calibration", "measurement"):
        (folder / name).mkdir(parents=True)
    (folder / "annotation/calibration/calibration-s1a-vv.xml").write_text(xml())
    rng = np.random.default_rng(0)
    samples: Any = rng.integers(1, 4000, SHAPE).astype(np.uint16)
    if request.param == "slc":
        samples = samples * np.exp(1j * rng.uniform(0, 6, SHAPE)).astype(np.complex64)
    path = folder / "measurement" / "s1a-vv.tiff"
    profile: Any = {"driver": "GTiff", "height": SHAPE[0], "width": SHAPE[1], "count": 1, "dtype": samples.dtype.name}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", **profile) as dataset:
            dataset.write(samples, 1)
    return path, samples


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_number_over_table(measurement: tuple[Path, Any]) -> None:
    path, samples = measurement
    line, pixel = np.indices(SHAPE)
    expected = samples / value(pixel, line)
    image = calibrated(path)
    assert image.is_complex == np.iscomplexobj(samples)
    np.testing.assert_allclose(image.pixels, expected, rtol=1e-5)
    part = calibrated(path, Window(50, 5, 20, 18))
    np.testing.assert_allclose(part.pixels, expected[5:23, 50:70], rtol=1e-5)
    np.testing.assert_allclose(calibrated(path, quantity="beta0").pixels, expected / 0.5, rtol=1e-5)
    np.testing.assert_allclose(calibrated(path, quantity="gamma0").pixels, expected / 0.8, rtol=1e-5)


def test_what_cannot_be_calibrated(tmp_path: Path, measurement: tuple[Path, Any]) -> None:
    path, _ = measurement
    with pytest.raises(ParameterError, match="quantity"):
        Calibration.of(path, "sigma")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no measurement in a SAFE folder"):
        Calibration.of(tmp_path / "scene.tif")
    with pytest.raises(InputError, match="cannot be read"):
        Calibration.of(path.with_name("other.tiff"))
    table = path.parent.parent / "annotation/calibration/calibration-s1a-vv.xml"
    table.write_text(xml().replace("<pixel>0 30 79</pixel>", "<pixel>0 30</pixel>", 1))
    with pytest.raises(InputError, match="no whole calibration"):
        Calibration.of(path)
    table.write_text("<calibration/>")
    with pytest.raises(InputError, match="holds no calibrationVector"):
        Calibration.of(path)
