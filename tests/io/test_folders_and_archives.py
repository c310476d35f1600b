"""Products that are folders, and images in archives."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.io import as_image
from made.placed_rasters import AMPLITUDE, archive, safe, write

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def test_a_product_that_names_files_outside_is_refused(tmp_path: Path) -> None:
    root = safe(tmp_path)
    write(tmp_path / "x.tiff", AMPLITUDE, "GTiff")
    manifest = root / "manifest.safe"
    manifest.write_text('<X><fileLocation href="measurement/../../x.tiff"/></X>')
    with pytest.raises(InputError, match="outside the product"):
        as_image(root)
    shutil.copy(tmp_path / "x.tiff", root / "measurement" / "y.tiff")
    manifest.write_text('<X><fileLocation href="measurement/y.tiff"/></X>')
    assert as_image(root).shape == AMPLITUDE.shape
    # The mask beside a measurement is opened with it.
    (root / "measurement" / "y.tiff.msk").write_text(
        f'<VRTDataset rasterXSize="{AMPLITUDE.shape[1]}" rasterYSize="{AMPLITUDE.shape[0]}"><VRTRasterBand band="1" '
        f'dataType="Byte"><SimpleSource><SourceFilename>{tmp_path / "x.tiff"}</SourceFilename></SimpleSource>'
        "</VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(InputError, match="is not a file of a mask"):
        as_image(root)
    manifest.write_text('<X><fileLocation href="measurement/gone.tiff"/></X>')
    with pytest.raises(InputError, match=r"names 1 measurements, and none is there, such as 'measurement/gone.tiff'"):
        as_image(root)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="directory without a product"):
        as_image(tmp_path / "empty")


def test_a_product_with_one_polarisation_only(tmp_path: Path) -> None:
    root = safe(tmp_path)
    next((root / "measurement").glob("*-vh-*")).unlink()
    np.testing.assert_array_equal(as_image(root).pixels, AMPLITUDE.astype(np.uint16))
    with pytest.raises(InputError, match="band 'VH'"):
        as_image(root, band="VH")


def test_a_safe_product_in_an_archive(tmp_path: Path) -> None:
    root = safe(tmp_path)
    with zipfile.ZipFile(tmp_path / "s.zip", "w") as file:
        for path in root.rglob("*"):
            file.write(path, path.relative_to(tmp_path))
    np.testing.assert_array_equal(as_image(tmp_path / "s.zip", band="VV").pixels, AMPLITUDE.astype(np.uint16))
    with pytest.raises(InputError, match=r"has 2 bands.*1 'VV' .*2 'VH'"):
        as_image(tmp_path / "s.zip")


def test_an_archive_of_several_images_lists_them(tmp_path: Path) -> None:
    path = archive(tmp_path)
    with zipfile.ZipFile(path, "a") as file:
        file.write(tmp_path / "a.tif", "b.tif")
    with pytest.raises(InputError, match=r"holds 2 images, name one as .*p.zip:NAME; in it: inside/a.tif, b.tif"):
        as_image(path)
    np.testing.assert_array_equal(as_image(f"{path}:b.tif").pixels, AMPLITUDE)
