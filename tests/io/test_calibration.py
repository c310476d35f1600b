"""Calibration by metadata that the test writes: linear tables are interpolated exactly."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from featreg.cli.info import describe
from featreg.cli.main import main
from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine
from featreg.io import as_image, write_geotiff
from featreg.io.raster_source import RasterSource, open_source
from featreg.io.window import Window
from featreg.products.in_memory import warp
from featreg.products.warping import warp_file
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Matches

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (60, 80)
SHARES = {"sigma0": 1.0, "beta0": 0.5, "gamma0": 0.8}


def value(pixel: Any, line: Any) -> Any:
    return 300.0 + 0.5 * pixel + 0.25 * line


def xml() -> str:
    vectors = []
    # The first lies before the image, as those of SLC do.
    for line in (-20, 10, 40, 90):
        pixels = [0, 30, 79]
        tables = "".join(
            f"<{name} count='3'>{' '.join(str(factor * value(p, line)) for p in pixels)}</{name}>"
            for name, factor in zip(("sigmaNought", "betaNought", "gamma"), SHARES.values(), strict=True)
        )
        vectors.append(
            f"<calibrationVector><line>{line}</line><pixel>{' '.join(map(str, pixels))}</pixel>{tables}"
            "</calibrationVector>"
        )
    return f"<calibration><calibrationVectorList>{''.join(vectors)}</calibrationVectorList></calibration>"


def samples_of(kind: str) -> Any:
    rng = np.random.default_rng(0)
    samples: Any = rng.integers(1, 4000, SHAPE).astype(np.uint16)
    samples[:4, :4] = 0
    return samples * np.exp(1j * rng.uniform(0, 6, SHAPE)).astype(np.complex64) if kind == "slc" else samples


def safe(root: Path, kind: str) -> Path:
    """A SAFE folder of one measurement with its calibration, and of another that has none."""
    folder = root / "S1A.SAFE"
    for name in ("annotation/calibration", "measurement"):
        (folder / name).mkdir(parents=True)
    names = [f"s1a-iw-{kind}-{polarisation}-20240101t000000" for polarisation in ("vv", "vh")]
    (folder / f"annotation/calibration/calibration-{names[0]}.xml").write_text(xml())
    samples = samples_of(kind)
    profile: Any = {"driver": "GTiff", "height": SHAPE[0], "width": SHAPE[1], "count": 1, "dtype": samples.dtype.name}
    for name in names:
        with rasterio.open(folder / "measurement" / f"{name}.tiff", "w", **profile, nodata=0) as dataset:
            dataset.write(samples, 1)
    parts = "".join(f'<fileLocation href="./measurement/{name}.tiff"/>' for name in names)
    (folder / "manifest.safe").write_text(f"<XFDU>{parts}</XFDU>")
    return folder


@pytest.fixture(params=["grd", "slc"])
def product(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Path, Any]:
    return safe(tmp_path, request.param), samples_of(request.param)


def test_number_over_table_in_folder_archive_and_file(tmp_path: Path, product: tuple[Path, Any]) -> None:
    folder, samples = product
    line, pixel = np.indices(SHAPE)
    found = [file.name for file in sorted((folder / "measurement").iterdir())]
    band = describe(str(folder))["bands"][0]["name"]
    with zipfile.ZipFile(tmp_path / "product.zip", "w") as archive:
        for file in folder.rglob("*.*"):
            archive.write(file, file.relative_to(tmp_path))
    inputs: list[tuple[Path, Any]] = [
        (folder, band), (tmp_path / "product.zip", band), (folder / "measurement" / found[1], None)
    ]  # fmt: skip
    for path, name in inputs:
        for quantity, share in SHARES.items():
            image = as_image(path, band=name, calibrate=quantity)
            assert image.calibration == quantity
            assert image.is_complex == np.iscomplexobj(samples)
            np.testing.assert_allclose(image.pixels, samples / (share * value(pixel, line)), rtol=1e-5)
            assert np.array_equal(image.mask, samples != 0)


def test_windows_hold_the_bits_of_the_whole(product: tuple[Path, Any]) -> None:
    folder, samples = product
    band = describe(str(folder))["bands"][0]["name"]
    whole = as_image(folder, band=band, calibrate="sigma0")
    source = open_source(folder, band=band, calibrate="sigma0")
    assert isinstance(source, RasterSource)
    assert source.known_scale == whole.scale == ("complex" if np.iscomplexobj(samples) else "amplitude")
    assert source.dtype == whole.source_dtype == ("complex64" if np.iscomplexobj(samples) else "float32")
    assert source.identity() != open_source(folder, band=band).identity()
    for window in (Window(0, 0, 80, 60), Window(50, 5, 20, 18), Window(70, 50, 20, 20)):
        part = source.read(window)
        rows, cols = slice(window.y, window.y + window.height), slice(window.x, window.x + window.width)
        expected = whole.pixels[rows, cols]
        assert np.array_equal(part.pixels[: expected.shape[0], : expected.shape[1]], expected)
        assert np.array_equal(part.mask[: expected.shape[0], : expected.shape[1]], whole.mask[rows, cols])


@pytest.mark.filterwarnings("ignore")
def test_scale_factors_of_a_sicd(tmp_path: Path) -> None:
    sicd = pytest.importorskip("sarkit.sicd")
    etree = pytest.importorskip("lxml.etree")
    from featreg.simulate.orbit import RangeDoppler
    from featreg.simulate.sicd import sicd_xml

    view = RangeDoppler.over((12.0, 47.0), SHAPE, incidence_deg=35.0, heading_deg=-12.0, pixel=1.0, height=400.0)
    root = etree.fromstring(sicd_xml(view, SHAPE, 400.0))
    space = etree.QName(root).namespace
    table = np.array([[2e-4, 1e-7], [3e-7, 0.0]])
    part = etree.Element(f"{{{space}}}Radiometric")
    tree = etree.ElementTree(root)
    root.insert(list(root).index(root.find("{*}SCPCOA")) + 1, part)
    helper = sicd.ElementWrapper(root)
    helper["Radiometric"]["SigmaZeroSFPoly"] = table
    meta = sicd.NitfMetadata(
        xmltree=tree, file_header_part={"ostaid": "x", "security": {"clas": "U"}},
        im_subheader_part={"isorce": "x", "security": {"clas": "U"}}, de_subheader_part={"security": {"clas": "U"}},
    )  # fmt: skip
    samples = np.random.default_rng(1).normal(size=(80, 60, 2)).astype(np.float32).view(np.complex64)[..., 0]
    path = tmp_path / "a.nitf"
    with path.open("wb") as file, sicd.NitfWriter(file, meta) as writer:
        writer.write_image(samples)
    centre = [float(root.findtext(f"{{*}}ImageData/{{*}}SCPPixel/{{*}}{name}")) for name in ("Row", "Col")]
    spacing = [float(root.findtext(f"{{*}}Grid/{{*}}{name}/{{*}}SS")) for name in ("Row", "Col")]
    row, col = np.indices(samples.shape)
    x, y = (row - centre[0]) * spacing[0], (col - centre[1]) * spacing[1]
    power = np.abs(samples) ** 2 * (2e-4 + 1e-7 * y + 3e-7 * x)
    image = as_image(path, calibrate="sigma0")
    np.testing.assert_allclose(np.abs(image.pixels) ** 2, power, rtol=1e-5)
    assert describe(str(path))["calibration"]["possible"] == ["sigma0"]
    with pytest.raises(InputError, match="states sigma0, not gamma0: its Radiometric has no other polynomial"):
        as_image(path, calibrate="gamma0")


def test_scale_factor_of_capella(tmp_path: Path) -> None:
    samples = np.abs(samples_of("grd")).astype(np.uint16)
    write_geotiff(tmp_path / "a.tif", samples)
    collect = {"collect": {"image": {"scale_factor": 0.002, "radiometry": "beta_nought"}}}
    (tmp_path / "a_extended.json").write_text(json.dumps(collect))
    np.testing.assert_allclose(as_image(tmp_path / "a.tif", calibrate="beta0").pixels, samples * 0.002, rtol=1e-6)
    with pytest.raises(InputError, match="states beta0, not sigma0: its radiometry is beta_nought"):
        as_image(tmp_path / "a.tif", calibrate="sigma0")
    (tmp_path / "a_extended.json").write_text(json.dumps({"collect": {"image": {"scale_factor": 1}}}))
    with pytest.raises(InputError, match="nothing in this GTiff says how to calibrate it to beta0"):
        as_image(tmp_path / "a.tif", calibrate="beta0")


def test_what_cannot_be_calibrated(tmp_path: Path) -> None:
    folder = safe(tmp_path, "grd")
    with pytest.raises(ParameterError, match="unknown quantity 'sigma' to calibrate to, did you mean 'sigma0'"):
        as_image(folder, band="VV", calibrate="sigma")
    with pytest.raises(ParameterError, match="scale 'db' contradicts calibrate='sigma0'"):
        open_source(folder, band="VV", calibrate="sigma0", scale="db")
    with pytest.raises(InputError, match=r"its calibration, '.*-vh-.*xml', is not there"):
        open_source(folder, band="VH", calibrate="sigma0")
    with pytest.raises(InputError, match="is for files of products"):
        as_image(np.ones(SHAPE), calibrate="sigma0")
    with pytest.raises(InputError, match="is for files of products"):
        as_image(as_image(folder, band="VV"), calibrate="sigma0")
    np.save(tmp_path / "a.npy", samples_of("grd"))
    with pytest.raises(InputError, match=r"nothing in this NPY says how to calibrate it to gamma0; Sentinel-1"):
        as_image(tmp_path / "a.npy", calibrate="gamma0")
    table = next((folder / "annotation/calibration").iterdir())
    table.write_text(xml().replace("<pixel>0 30 79</pixel>", "<pixel>0 30</pixel>", 1))
    with pytest.raises(InputError, match="no whole calibration"):
        as_image(folder, band="VV", calibrate="sigma0")
    table.write_text(xml().replace("<line>10</line>", "<line>nan</line>"))
    with pytest.raises(InputError, match="no whole calibration"):
        as_image(folder, band="VV", calibrate="sigma0")
    table.write_text("<calibration/>")
    with pytest.raises(InputError, match="holds no calibrationVector"):
        as_image(folder, band="VV", calibrate="sigma0")


def test_a_result_records_it_and_products_follow(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = safe(tmp_path, "grd")
    file = next((folder / "measurement").glob("*-vv-*"))
    known = InputImage(str(file), SHAPE, "amplitude", calibration="sigma0")
    result = Registration(
        Matches.empty(), {}, np.zeros(0, bool), Affine(np.array([[1.0, 0, 0], [0, 1, 0]])), "ok", "",
        reference=known, secondary=known,
    )  # fmt: skip
    result.to_json(tmp_path / "r.json")
    again = Registration.from_json(tmp_path / "r.json")
    assert again.secondary is not None
    assert again.secondary.calibration == "sigma0"
    line, pixel = np.indices(SHAPE)
    amplitude = np.where(samples_of("grd") > 0, samples_of("grd") / value(pixel, line), np.nan)
    np.testing.assert_allclose(warp(again, file, resampling="nearest"), amplitude, rtol=1e-5)
    product = warp_file(again, file, tmp_path / "o.tif", resampling="nearest")
    assert product.dtype == "float32"
    assert product.nodata is not None
    assert np.isnan(product.nodata)
    with rasterio.open(tmp_path / "o.tif") as dataset:
        np.testing.assert_allclose(dataset.read(1), amplitude**2, rtol=1e-5)
        assert dataset.tags()["FEATREG_CALIBRATION"] == "sigma0"
        assert dataset.descriptions == ("sigma0",)
    command = ["warp", str(tmp_path / "r.json"), str(file), "-o", str(tmp_path / "g.tif"), "--resampling", "nearest"]
    assert main([*command, "--calibrate", "gamma0"]) == 0
    with rasterio.open(tmp_path / "g.tif") as dataset:
        np.testing.assert_allclose(dataset.read(1), (amplitude / 0.8) ** 2, rtol=1e-5)
    capsys.readouterr()
    assert main([*command, "--calibrate", "sigma9"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_command_line_says_what_is_possible(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = safe(tmp_path, "grd")
    assert main(["info", str(folder), "--band", "VV", "--calibrate", "beta0"]) == 0
    out = capsys.readouterr().out
    assert "calibration  possible sigma0 or beta0 or gamma0, applied beta0, note thermal noise is left in" in out
    assert main(["info", str(folder), "--band", "VH"]) == 0
    assert "is not there; the product must be complete" in capsys.readouterr().out
    write_geotiff(tmp_path / "a.tif", samples_of("grd"))
    for command in ("match", "compare", "offsets", "stack"):
        more = [str(tmp_path / "a.tif")] if command == "stack" else []
        more += ["-o", str(tmp_path / "o.tif")] if command == "offsets" else []
        more += ["-o", str(tmp_path / "o")] if command == "stack" else []
        more += ["--methods", "orb"] if command == "compare" else []
        pair = [str(tmp_path / "a.tif")] * 2
        assert main([command, *pair, *more, "--calibrate", "sigma0"]) == 2, command
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert "nothing in this GTiff says how to calibrate it to sigma0" in err
