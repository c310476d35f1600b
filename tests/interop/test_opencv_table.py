"""The table of OpenCV's algorithms: what is offered, what is refused and why, threads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg.interop.opencv as featreg_opencv
from featreg import registry
from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.io import as_image
from featreg.runtime.threads import single_threaded

cv2 = pytest.importorskip("cv2")

DETECTORS = {e.name: e for e in registry.entries("detector") if e.module == "featreg.detectors.opencv"}
DESCRIPTORS = {e.name: e for e in registry.entries("descriptor") if e.module == "featreg.descriptors.opencv"}


class TestTable:
    def test_names(self) -> None:
        assert {"akaze", "agast", "brisk", "fast", "gftt", "kaze", "mser", "orb", "sift", "star"} <= set(DETECTORS)
        assert {"akaze", "brisk", "freak", "kaze", "latch", "opencv-brief", "orb", "sift", "vgg"} <= set(DESCRIPTORS)
        assert all(e.summary for e in (*DETECTORS.values(), *DESCRIPTORS.values()))

    def test_surf_names_reason_and_cure(self) -> None:
        if not DETECTORS["surf"].unavailable:
            pytest.skip("this OpenCV was built with its patented algorithms")
        with pytest.raises(PluginUnavailableError, match=r"patented.*use 'sift'"):
            registry.create("detector", "surf")

    def test_doctor_knows_where_everything_is(self) -> None:
        found = featreg_opencv.homes()
        assert found["ORB"] == "cv2"
        assert found["AKAZE"] == ("cv2" if hasattr(cv2, "AKAZE_create") else "cv2.xfeatures2d")
        from featreg.descriptors import opencv as descriptors
        from featreg.detectors import opencv as detectors
        from featreg.detectors import opencv_networks as networks
        from featreg.matchers import opencv as matchers

        tables = (detectors.TABLE, descriptors.TABLE, networks.TABLE, matchers.TABLE)
        assert {row.creator for table in tables for row in table.values()} == set(found)

    def test_an_opencv_without_contrib_says_so(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delattr(cv2, "xfeatures2d")
        assert "contrib" in featreg_opencv.unavailable("FREAK")
        assert featreg_opencv.unavailable("ORB") == ""
        assert "has no" in featreg_opencv.unavailable("NoSuchThing") or "contrib" in featreg_opencv.unavailable("No")

    def test_what_is_refused(self, sar_texture: Callable[..., NDArray[np.float32]]) -> None:
        for name, given, text in (
            ("orb", {"n_featurs": 5}, "did you mean 'n_features'"),
            ("orb", {"n_features": 0}, "at least 1"),
            ("orb", {"n_features": "many"}, "a whole number"),
            ("orb", {"score_type": "best"}, "'harris' or 'fast'"),
            ("sift", {"normalise": "log"}, "log-stretch"),
            ("sift", {"enable_precise_upscale": 1}, "true or false"),
        ):
            with pytest.raises(ParameterError, match=text):
                registry.create("detector", name, **given)
        assert registry.create("detector", "sift", sigma=2) == registry.create("detector", "sift", sigma=2.0)
        with pytest.raises(InputError, match="OpenCV's ORB refuses"):
            registry.create("detector", "orb", patch_size=-3).detect_features(as_image(sar_texture(200, 200)))

    def test_one_thread_inside_the_block(self) -> None:
        before = cv2.getNumThreads()
        with single_threaded():
            assert cv2.getNumThreads() == 1
        assert cv2.getNumThreads() == before
