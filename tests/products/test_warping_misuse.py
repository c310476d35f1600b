"""Products from file to file: whole or not at all."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import CancelledError, InputError, ParameterError
from featreg.interfaces import FailedFit
from featreg.io import write_geotiff
from featreg.products.files import WINDOW
from featreg.products.warping import warp_file
from made.warped_files import SHAPE, files, read, registration, texture

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def test_misuse_leaves_nothing_behind(tmp_path: Path) -> None:
    files(tmp_path, texture(*SHAPE))
    reg, sec, out = registration(tmp_path), tmp_path / "sec.tif", tmp_path / "out.tif"
    write_geotiff(tmp_path / "small.tif", texture(40, 60))
    cases: list[tuple[Any, dict[str, Any], str]] = [
        (InputError, {"secondary": tmp_path / "none.tif"}, "no such file"),
        (InputError, {"secondary": tmp_path / "small.tif"}, "60 x 40 pixels, but the secondary of the result was 340"),
        (InputError, {"like": tmp_path / "small.tif"}, "60 x 40 pixels, but the reference of the result was 340 x 300"),
        (InputError, {"output": sec}, "would replace an input"),
        (InputError, {"output": tmp_path / "ref.tif"}, "would replace an input"),
        (InputError, {"output": tmp_path / "none" / "o.tif"}, "existing, writable folder"),
        (InputError, {"output": tmp_path}, "is a directory"),
        (ParameterError, {"resampling": "linear"}, "'bilinear'"),
        (ParameterError, {"deramp": True}, "need complex ones"),
        (ParameterError, {"coherence": tmp_path / "c.tif"}, "need complex ones"),
        (ParameterError, {"secondary_scale": -1.0}, "must be > 0"),
        (ParameterError, {"secondary_scale": (1.0, 2.0, 3.0)}, "one number or two"),
        (InputError, {"like": (0, 340)}, r"its \(H, W\)"),
        (ParameterError, {"coherence_window": (3,)}, "odd number"),
        (ParameterError, {"coherence_window": 2.5}, "odd number"),
        (InputError, {"registration": registration(tmp_path, FailedFit("2 points"))}, r"no model \(2 points\)"),
    ]
    before = read(sec)[0]
    for error, change, words in cases:
        given: dict[str, Any] = {"registration": reg, "secondary": sec, "output": out} | change
        with pytest.raises(error, match=words):
            warp_file(**given)
    assert not out.exists()
    assert not list(tmp_path.glob(".*"))
    np.testing.assert_array_equal(read(sec)[0], before)


def test_the_scale_in_the_result_is_that_of_the_file_by_any_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files(tmp_path, texture(*SHAPE))
    reg = registration(tmp_path, scale="intensity")
    monkeypatch.chdir(tmp_path)
    for name in (tmp_path / "sec.tif", "sec.tif"):
        warp_file(reg, name, tmp_path / f"{str(name)[0] == '/'}.tif", resampling="bilinear")
    absolute, relative = (read(tmp_path / f"{name}.tif")[0] for name in (True, False))
    np.testing.assert_array_equal(absolute, relative)


def test_progress_and_cancel(tmp_path: Path) -> None:
    files(tmp_path, texture(40, 3 * WINDOW))
    reg = registration(tmp_path, size=(40, 3 * WINDOW))
    seen: list[tuple[int, int]] = []
    stop = threading.Event()

    def progress(done: int, total: int) -> None:
        seen.append((done, total))
        stop.set()

    with pytest.raises(CancelledError, match="after 1 of 3"):
        warp_file(reg, tmp_path / "sec.tif", tmp_path / "o.tif", progress=progress, cancel=stop)
    assert not (tmp_path / "o.tif").exists()
    warp_file(reg, tmp_path / "sec.tif", tmp_path / "o.tif", progress=lambda *n: seen.append(n))
    assert seen == [(1, 3), (1, 3), (2, 3), (3, 3)]
