"""Whatever is wrong with an input ends in one line that names it, says what is wrong and what would be right."""

from __future__ import annotations

import os
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.io import as_image

GRAY = np.random.default_rng(0).integers(1, 250, (200, 300), dtype=np.uint8)


def picture(path: Path, array: Any = GRAY) -> Path:
    import cv2

    assert cv2.imwrite(str(path), array)
    return path


def cut(path: Path, share: float = 0.5) -> Path:
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    return path


def text(path: Path) -> Path:
    path.write_text("range azimuth power\n" * 50)
    return path


def saved(path: Path, array: Any) -> Path:
    np.save(path, array, allow_pickle=True)
    return path


def bands(path: Path, count: int) -> Path:
    import rasterio

    with rasterio.open(path, "w", driver="GTiff", height=20, width=30, count=count, dtype="uint8") as dataset:
        dataset.write(np.arange(count * 600, dtype=np.uint8).reshape(count, 20, 30))
    return path


def pages(path: Path) -> Path:
    import cv2

    cv2.imwritemulti(str(path), [GRAY, GRAY])
    return path


def empty(path: Path) -> Path:
    path.touch()
    return path


def struct(path: Path) -> Path:
    from scipy.io import savemat

    savemat(path, {"data": {"fp": GRAY}})
    return path


def new_matlab(path: Path) -> Path:
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(600))
    return path


pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")  # of the files written here
BAD_FILES: dict[str, tuple[Callable[[Path], Any], str]] = {
    "missing": (lambda d: d / "a.tif", "no such file"),
    "directory": (lambda d: d, "is a directory"),
    "empty": (lambda d: empty(d / "a.tif"), r"empty \(0 bytes\)"),
    "text named tif": (lambda d: text(d / "a.tif"), "not TIFF in spite of its name"),
    "text named npy": (lambda d: text(d / "a.npy"), "not NPY in spite of its name"),
    "text named mat": (lambda d: text(d / "a.mat"), "broken or cut short"),
    "truncated tif": (lambda d: cut(picture(d / "a.tif")), "the TIFF file is broken"),
    "tif of a few bytes": (lambda d: cut(picture(d / "a.tif"), 0.001), "the TIFF file is broken"),
    "truncated png": (lambda d: cut(picture(d / "a.png")), "the PNG file is broken"),
    "truncated 16-bit png": (lambda d: cut(picture(d / "a.png", GRAY.astype(np.uint16))), "the PNG file is broken"),
    "truncated jpg": (lambda d: cut(picture(d / "a.jpg")), "the JPEG file is broken"),
    "truncated bmp": (lambda d: cut(picture(d / "a.bmp")), "the BMP file is broken"),
    "truncated npy": (lambda d: cut(saved(d / "a.npy", GRAY)), "the NPY file is broken"),
    "pickled npy": (lambda d: saved(d / "a.npy", np.array([{"a": 1}, None])), "pickled Python objects"),
    "suffix": (lambda d: text(d / "a.xyz"), "not a known image format.*known are GeoTIFF"),
    "no suffix": (lambda d: text(d / "a"), "not a known image format"),
    "two bands": (
        lambda d: bands(d / "a.tif", 2),
        r"has 2 bands, state which .*: 1 \(uint8\), 2 \(uint8\)",
    ),
    "five bands": (lambda d: bands(d / "a.tif", 5), "has 5 bands"),
    "pages": (lambda d: pages(d / "a.tif"), "holds 2 pages"),
    "3-D npy": (lambda d: saved(d / "a.npy", np.ones((20, 20, 3))), r"shape \(20, 20, 3\)"),
    "matlab 7.3": (lambda d: new_matlab(d / "a.mat"), "broken or cut short"),
    "matlab without image": (lambda d: struct(d / "a.mat"), r"no 2-D numeric variable.* holds data \(1x1 struct\)"),
    "tiny": (lambda d: picture(d / "a.png", GRAY[:3, :3]), "3 x 3 pixels .* too small, at least 16 x 16"),
    "constant": (lambda d: picture(d / "a.png", GRAY * 0 + 7), r"same value \(7\)"),
    "all NaN": (lambda d: saved(d / "a.npy", np.full((20, 20), np.nan)), "no valid pixel"),
    "long name": (lambda d: d / ("a" * 300 + ".tif"), "give a"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_one_line(tmp_path: Path, case: str, capfd: pytest.CaptureFixture[str]) -> None:
    make, wanted = BAD_FILES[case]
    path = make(tmp_path)
    capfd.readouterr()
    with pytest.raises(InputError, match=wanted) as caught:
        as_image(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(tmp_path) in message
    assert len(message) < 400 + len(str(path))
    assert capfd.readouterr() == ("", "")


def test_nothing_reaches_stderr_without_logging_set_up(tmp_path: Path) -> None:
    files = [cut(picture(tmp_path / name)) for name in ("a.tif", "a.png", "a.jpg", "a.bmp")] + [
        text(tmp_path / "b.tif")
    ]
    good = picture(tmp_path / "good.tif")
    code = (
        "import sys\nfrom featreg.errors import InputError\nfrom featreg.io import as_image, write_geotiff\n"
        "good = sys.argv.pop()\nwrite_geotiff(good, as_image(good).pixels)\n"
        "for path in sys.argv[1:]:\n"
        "    try:\n        as_image(path)\n"
        "    except InputError:\n        print('one line')\n"
    )
    command = [sys.executable, "-W", "always", "-c", code, *map(str, files), str(good)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout == "one line\n" * len(files)


def test_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = picture(tmp_path / "a.png")

    def refuse(self: Path, *args: Any, **kwargs: Any) -> Any:
        raise PermissionError(13, "Permission denied", str(self))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refuse)
        with pytest.raises(InputError, match=r"a\.png: permission denied; make the file readable"):
            as_image(path)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read every file")
def test_unreadable_file_for_real(tmp_path: Path) -> None:
    path = picture(tmp_path / "a.png")
    path.chmod(0)
    with pytest.raises(InputError, match="permission denied"):
        as_image(path)


BAD_ARRAYS: dict[str, tuple[Any, str]] = {
    "thin": (np.ones((70000, 2), np.float32), "array: 2 x 70000 pixels .* too small"),
    "tiny": (GRAY[:3, :3], "array: 3 x 3 pixels .* too small"),
    "1-D": (np.ones(100), r"shape \(100,\)"),
    "colour": (np.dstack([GRAY] * 3), r"shape \(200, 300, 3\), one band"),
    "empty": (np.ones((0, 50)), "too small"),
    "bool": (GRAY > 5, "bool values.* give a bool array as mask="),
    "object": (GRAY.astype(object), "object values"),
    "constant": (np.full((20, 20), 3.5), r"same value \(3.5\)"),
    "zeros": (np.zeros((20, 20), np.uint8), r"same value \(0\)"),
    "constant complex": (np.full((20, 20), 1 + 2j), "same value"),
    "all NaN": (np.full((20, 20), np.nan), "no valid pixel"),
    "all infinite": (np.full((20, 20), np.inf), "no valid pixel"),
    "all NaN complex": (np.full((20, 20), complex(np.nan, 0)), "no valid pixel"),
    "list": ([[1, 2], [3, 4]], "cannot make an image from list"),
    "none": (None, "cannot make an image from NoneType"),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_a_bad_array_is_one_line(case: str) -> None:
    array, wanted = BAD_ARRAYS[case]
    with pytest.raises(InputError, match=wanted) as caught:
        as_image(array)
    assert "\n" not in str(caught.value)


def test_constant_or_nothing_after_masking() -> None:
    half = GRAY.copy()
    half[:, :150] = 0
    with pytest.raises(InputError, match=r"same value \(0\)"):
        as_image(half, mask=half == 0)
    with pytest.raises(InputError, match="no valid pixel"):
        as_image(half * 0, nodata=0)


def test_a_broken_byte_in_the_middle_is_not_read_as_data(tmp_path: Path) -> None:
    for name in ("a.png", "a.jpg"):
        path = picture(tmp_path / name)
        content = bytearray(path.read_bytes())
        for i in range(len(content) // 2, len(content) // 2 + 40):
            content[i] ^= 0x55
        path.write_bytes(content)
        with pytest.raises(InputError, match="broken"):
            as_image(path)


def test_a_matlab_file_with_damaged_data(tmp_path: Path) -> None:
    from scipy.io import savemat

    path = tmp_path / "a.mat"
    savemat(path, {"a": GRAY}, do_compression=True)
    content = bytearray(path.read_bytes())
    content[-200:-100] = zlib.compress(b"x" * 1000)[:1] * 100
    path.write_bytes(content)
    with pytest.raises(InputError, match="broken"):
        as_image(path)
