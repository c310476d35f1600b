"""What a result records about how it was made."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

import featreg
from featreg.cli.doctor import examine
from featreg.runtime import versions as module
from featreg.runtime.versions import version_of, versions


@pytest.fixture(autouse=True)
def _afresh() -> Iterator[None]:
    module._versions.cache_clear()
    yield
    module._versions.cache_clear()


def test_every_library_that_decides_results_is_named() -> None:
    found = versions()
    assert list(found) == ["featreg", "python", "numpy", "numba", "scipy", "scikit-image", "rasterio", "opencv"]
    assert found["featreg"] == featreg.__version__
    assert found["numpy"] == np.__version__
    assert version_of("no-such-distribution") is None


@pytest.mark.parametrize("name", ["opencv-python", "opencv-python-headless", "opencv-contrib-python", "built-here"])
def test_opencv_is_recorded_under_whatever_name_it_was_installed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.metadata.version

    def installed(given: str) -> str:
        if given.startswith("opencv") or given == "built-here":
            if given != name:
                raise importlib.metadata.PackageNotFoundError(given)
            return "9.9.9.9"
        return real(given)

    monkeypatch.setattr(importlib.metadata, "version", installed)
    monkeypatch.setattr(cv2, "__version__", "9.9.9")
    assert versions()["opencv"] == "9.9.9"
    xy = np.random.default_rng(0).uniform(0, 100, (40, 2))
    result = featreg.fit(np.hstack([xy, xy + 1.0]), model="translation", filters=[])
    assert result.provenance["versions"]["opencv"] == "9.9.9"
    shown = examine()["versions"]["OpenCV"]
    assert shown.startswith("9.9.9 (")
    assert (name in shown) == name.startswith("opencv")
