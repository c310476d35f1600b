"""The bridge to vismatch: a stand-in package of its interface goes through the whole pipeline, in blocks too."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from featreg import registry
from featreg.errors import PluginUnavailableError
from featreg.io import as_image
from featreg.simulate import sar_pair

STAND_IN = """
import cv2
import numpy as np

available_models = ["sift-nn", "shifted", "broken"]


class Sift:
    def __init__(self, name, device, count):
        self.name, self.count = name, count

    def __call__(self, img0, img1):
        assert tuple(img0.shape)[0] == 3 and 0 <= float(img0.min()) and float(img0.max()) <= 1
        sift = cv2.SIFT.create(self.count, enable_precise_upscale=True)
        found = [sift.detectAndCompute((i[0].numpy() * 255).astype(np.uint8), None) for i in (img0, img1)]
        pairs = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(found[0][1], found[1][1])
        ends = [np.array([kp.pt for kp in f[0]]) for f in found]
        half = 0.5 if self.name == "shifted" else 0.0
        return {
            "matched_kpts0": ends[0][[m.queryIdx for m in pairs]] + half,
            "matched_kpts1": ends[1][[m.trainIdx for m in pairs]] + half,
            "matched_confidences": np.exp(-np.array([m.distance for m in pairs]) / 100),
            "H": None,
        }


def get_matcher(matcher_name="sift-nn", device="cpu", max_num_keypoints=2048):
    if matcher_name == "broken":
        raise RuntimeError("no weights can be had")
    return Sift(matcher_name, device, max_num_keypoints)
"""
RUN = """
import numpy as np
import featreg
from featreg.errors import ParameterError, PluginUnavailableError
from featreg.simulate import sar_pair

pair = sar_pair((300, 300), rotation_deg=3, seed=1)
whole = featreg.match(pair.reference, pair.secondary, method="vismatch", network="sift-nn", refine=False)
assert whole.status == "ok", whole.reason
assert featreg.evaluate(whole, pair.truth).grid_rmse < 0.5
assert (np.diff(whole.matches.score) <= 0).all()
moved = featreg.match(
    pair.reference, pair.secondary, method="vismatch", network="shifted", half_pixel=0.5, refine=False
)
np.testing.assert_allclose(moved.matches.reference_xy, whole.matches.reference_xy, atol=1e-4)
blocks = featreg.match(pair.reference, pair.secondary, method="vismatch", network="sift-nn", block=150, workers=1)
assert blocks.status == "ok", blocks.reason
assert blocks.timings
mask = np.ones(pair.reference.shape, bool)
mask[:, :150] = False
half = featreg.match(
    pair.reference, pair.secondary, method="vismatch", network="sift-nn", reference_mask=mask, refine=False
)
assert (half.matches.reference_xy[:, 0] > 149).all()
wrong = (("sift-nm", ParameterError, "sift-nn"), ("broken", PluginUnavailableError, "no weights can be had"))
for name, kind, words in wrong:
    try:
        featreg.match(pair.reference, pair.secondary, method="vismatch", network=name)
    except kind as error:
        assert words in str(error), error
    else:
        raise SystemExit("no error")
"""


def test_a_matcher_of_vismatch_goes_through_the_pipeline(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    (tmp_path / "vismatch.py").write_text(STAND_IN)
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n{RUN}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_without_vismatch_the_cure_is_named() -> None:
    module = pytest.importorskip("featreg.matchers.vismatch")
    if module._package():
        pytest.skip("vismatch is installed")
    assert "vismatch is not installed" in registry.entry("matcher", "vismatch").unavailable
    image = as_image(sar_pair((64, 64), seed=0).reference)
    with pytest.raises(PluginUnavailableError, match="vismatch is not installed"):
        module.Vismatch().match(image, image)


def test_another_module_of_that_name_is_no_vismatch(tmp_path: Path) -> None:
    (tmp_path / "matching.py").write_text("")
    code = (
        "import featreg.registry as r\nr.entries('matcher')\n"
        "print(dict(r.broken()), r.entry('matcher', 'vismatch').unavailable)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("{} vismatch is not installed")
