"""Comparisons of files with several bands, and of pairs of which one cannot be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import Experiment
from featreg.cli.main import main
from featreg.io import as_image
from featreg.products.warping import warp_file
from featreg.simulate import sar_pair
from featreg.study.prediction_cache import PredictionCache
from featreg.study.protocol import Protocol

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A pair whose right bands are VH of the reference and VV of the secondary; the others hold something else."""
    home = tmp_path_factory.mktemp("bands")
    pair = sar_pair((160, 160), rotation_deg=2.0, scale=1.0, shift=(3.0, -2.0), seed=1)
    noise = np.random.default_rng(0).gamma(1.0, 50.0, (160, 160)).astype(np.float32)
    given = (("a.tif", (noise, pair.reference)), ("b.tif", (pair.secondary, noise[::-1])))
    for name, bands in given:
        size = {"height": 160, "width": 160, "count": 2, "dtype": "float32"}
        with rasterio.open(home / name, "w", driver="GTiff", **size) as dataset:
            dataset.write(np.stack(bands))
            dataset.descriptions = ("VV", "VH")
    return home / "a.tif", home / "b.tif"


def test_match_reads_the_bands_that_are_named_and_its_result_keeps_them(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    bands: dict[str, Any] = {"band": "VV", "reference_band": "VH"}
    result = featreg.match(*files, method="orb", **bands)
    same = featreg.match(as_image(files[0], band=2), as_image(files[1], band=1), method="orb")
    np.testing.assert_array_equal(result.matches.reference_xy, same.matches.reference_xy)
    assert [image.band for image in (result.reference, result.secondary) if image] == ["VH", "VV"]
    result.to_json(tmp_path / "r.json")
    kept = featreg.Registration.from_json(tmp_path / "r.json")
    assert [image.band for image in (kept.reference, kept.secondary) if image] == ["VH", "VV"]
    product = warp_file(kept, files[1], tmp_path / "o.tif", band="VV", resampling="nearest")
    assert product.bands == (1,)
    with pytest.raises(featreg.FeatregError, match="state which one as band"):
        featreg.match(*files, method="orb")


def test_the_bands_are_part_of_what_a_kept_result_is_found_by(files: tuple[Path, Path], tmp_path: Path) -> None:
    store = PredictionCache(tmp_path)
    keys = {store.key("pair", files, {"method": "orb", "reference_band": band}) for band in ("VV", "VH", None)}
    assert len(keys) == 3
    protocol = Protocol(timing=False, band="VV", reference_band="VH")
    study = Experiment([files], ["orb"], protocol=protocol).run()
    assert study.table().failed == 0


def test_a_pair_that_cannot_be_read_is_a_row_with_its_reason(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.tif"
    broken.write_bytes(files[0].read_bytes()[:300])
    pairs = [str(files[0]), str(files[1]), str(broken), str(files[1])]
    options = ["--band", "VV", "--reference-band", "VH", "--no-times", "--no-isolate"]
    assert main(["compare", *pairs, "--methods", "orb", *options]) == 4
    printed = capsys.readouterr()
    assert "broken or cut short" in printed.out + printed.err
    assert main(["compare", str(broken), str(files[1]), "--methods", "orb", *options]) == 2


def test_products_that_are_folders_are_compared(files: tuple[Path, Path], tmp_path: Path) -> None:
    given = []
    for name, file in zip(("R.SAFE", "S.SAFE"), files, strict=True):
        (tmp_path / name / "measurement").mkdir(parents=True)
        (tmp_path / name / "measurement" / "s1a-iw-grd-vv-1-2.tiff").write_bytes(file.read_bytes())
        (tmp_path / name / "manifest.safe").write_text(
            '<X><fileLocation href="measurement/s1a-iw-grd-vv-1-2.tiff"/></X>'
        )
        given.append(str(tmp_path / name))
    options = ["--reference-band", "2", "--secondary-band", "1", "--no-times", "--no-isolate"]
    assert main(["compare", *given, "--methods", "orb", *options, "--resume", str(tmp_path / "kept")]) == 0
    assert len(list((tmp_path / "kept").glob("*.json"))) == 1
    (tmp_path / "empty").mkdir()
    assert main(["compare", given[0], str(tmp_path / "empty"), "--methods", "orb"]) == 2
