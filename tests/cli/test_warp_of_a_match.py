"""`featreg warp` of what `featreg match` found."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from featreg.io import as_image
from featreg.types import Geolocation

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
Run = Callable[..., tuple[int, str, str]]


def test_warp_gives_the_reference_grid_and_its_place(run: Run, folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "aligned.tif"
    code, out, err = run("warp", "result.json", "sec.tif", "-o", str(target))
    assert (code, err) == (0, "")
    assert "256 x 256 pixels, float32, georeferenced as the reference" in out
    aligned, reference = as_image(target), as_image(folder / "ref.tif")
    assert aligned.geolocation is not None
    assert reference.geolocation is not None
    assert aligned.geolocation.transform == PLACE.transform
    assert aligned.geolocation.crs == reference.geolocation.crs
    inside = aligned.mask.copy()
    inside[:20] = inside[-20:] = inside[:, :20] = inside[:, -20:] = False
    before = np.corrcoef(as_image(folder / "sec.tif").pixels[inside], reference.pixels[inside])[0, 1]
    assert np.corrcoef(aligned.pixels[inside], reference.pixels[inside])[0, 1] > before + 0.3


def test_warp_with_an_explicit_reference(run: Run, folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "aligned.tif"
    assert run("warp", "result.json", "sec.tif", "-o", str(target), "--like", "other.tif")[0] == 0
    assert as_image(target).geolocation is None
    assert (
        run("warp", "result.json", "sec.tif", "-o", str(target), "--like", "ref.tif", "--resampling", "nearest")[0] == 0
    )
    assert as_image(target).geolocation is not None


def test_warp_with_an_untrusted_result_says_so(run: Run, tmp_path: Path, folder: Path) -> None:
    data = json.loads((folder / "result.json").read_text())
    data |= {"status": "unreliable", "reason": "made up"}
    (tmp_path / "bad.json").write_text(json.dumps(data))
    code, _, err = run("warp", str(tmp_path / "bad.json"), "sec.tif", "-o", str(tmp_path / "aligned.tif"))
    assert code == 3
    assert err.startswith("warning: ")
    assert "made up" in err
    assert (tmp_path / "aligned.tif").exists()
