"""Detectors and descriptors behind the methods of OpenCV's feature classes."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

import featreg
from featreg.errors import ParameterError, UnknownNameError
from featreg.interop.extraction import Extractor, extractor
from featreg.interop.opencv import resolve
from featreg.simulate import sar_pair

IMAGE = sar_pair((256, 256), seed=1).reference


@pytest.mark.parametrize(
    ("detector", "descriptor", "dtype"),
    [
        ("sar-ofast", "brief", np.uint8),
        ("orb", None, np.uint8),
        ("sift", None, np.float32),
        ("fast", "sift", np.float32),
    ],
)
def test_keypoints_and_descriptors_belong_together(detector: str, descriptor: str | None, dtype: Any) -> None:
    keypoints, descriptors = extractor(detector, descriptor, n_features=300).detectAndCompute(IMAGE)
    assert descriptors is not None
    assert 50 < len(keypoints) == len(descriptors)
    assert descriptors.dtype == dtype
    assert isinstance(keypoints[0], cv2.KeyPoint)


def test_detect_then_compute_describes_the_same_points() -> None:
    finder = extractor("sar-ofast", "brief", n_features=300)
    keypoints, at_once = finder.detectAndCompute(IMAGE)
    again, in_steps = finder.compute(IMAGE, finder.detect(IMAGE))
    assert at_once is not None
    assert in_steps is not None
    assert len(again) == len(keypoints)
    # Keypoints hold float32, so a few bits may differ.
    assert np.unpackbits(at_once ^ in_steps).mean() < 0.01


def test_it_serves_opencv_code() -> None:
    pair = sar_pair((256, 256), rotation_deg=0.0, scale=1.0, shift=(4.0, 2.0), seed=2)
    finder = extractor("sar-ofast", "brief", n_features=1000)
    (a, first), (b, second) = (finder.detectAndCompute(image) for image in (pair.reference, pair.secondary))
    assert first is not None
    assert second is not None
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(first, second)
    shifts = np.array([np.subtract(b[m.trainIdx].pt, a[m.queryIdx].pt) for m in matches])
    assert np.sum(np.hypot(*(shifts - [4.0, 2.0]).T) < 2) > 50


def test_a_mask_keeps_features_out() -> None:
    mask = np.zeros(IMAGE.shape, np.uint8)
    mask[:, 128:] = 255
    keypoints, _ = extractor("sar-ofast", "brief").detectAndCompute(IMAGE, mask)
    assert min(k.pt[0] for k in keypoints) > 128
    assert min(k.pt[0] for k in extractor("sar-ofast").detect(IMAGE, mask)) > 128


def test_nothing_found_is_empty() -> None:
    step = np.ones((64, 64), np.float32)
    step[:, 32:] = 1.0001
    keypoints, descriptors = extractor("fast", "brief").detectAndCompute(step)
    assert len(keypoints) == 0
    assert descriptors is None or len(descriptors) == 0


@pytest.mark.parametrize(
    ("name", "given"),
    [("orb", {}), ("sift", {}), ("kaze", {"extended": True}), ("akaze", {"descriptor_type": "kaze"}), ("brisk", {})],
)
def test_the_form_of_descriptors_is_opencvs(name: str, given: dict[str, Any]) -> None:
    create: Any = resolve(name.upper())
    theirs = create(**({"descriptor_type": 3} if name == "akaze" else given))
    alone: Any = extractor(name, **given)
    both: Any = extractor("fast", name, **given)
    for ours in (alone, both):
        for question in ("defaultNorm", "descriptorSize", "descriptorType"):
            assert getattr(ours, question)() == getattr(theirs, question)(), question
    assert alone.detectAndCompute(IMAGE)[1].shape[1] == theirs.descriptorSize()


def test_the_form_follows_from_the_parameters() -> None:
    made = extractor("sar-ofast", "brief", bits=512)
    assert (made.defaultNorm(), made.descriptorSize(), made.descriptorType()) == (cv2.NORM_HAMMING, 64, cv2.CV_8U)
    with pytest.raises(ParameterError, match="choose one, as in descriptor='brief'"):
        extractor("fast").descriptorSize()
    with pytest.raises(ParameterError, match="choose one, as in descriptor='brief'"):
        extractor("orb", describe=False).defaultNorm()


def test_objects_and_names_mix() -> None:
    made = extractor(featreg.create("detector", "orb", n_features=50, describe=False), "brief", bits=512)
    _, descriptors = made.detectAndCompute(IMAGE)
    assert descriptors is not None
    assert descriptors.shape[1] == 64


def test_parameters_find_their_owner() -> None:
    made: Any = extractor("sar-ofast", "brief", n_features=7, bits=512, **{"descriptor.sigma": 2.5})
    assert (made.detector.n_features, made.descriptor.bits, made.descriptor.sigma) == (7, 512, 2.5)
    with pytest.raises(ParameterError, match=r"ambiguous: write 'detector\.sigma' or 'descriptor\.sigma'"):
        extractor("sar-ofast", "brief", sigma=2.0)
    with pytest.raises(ParameterError, match="did you mean 'n_features'"):
        extractor("sar-ofast", "brief", n_feature=7)


def test_misuse_says_what_would_be_right() -> None:
    with pytest.raises(UnknownNameError, match="sar-ofast"):
        extractor("sar-fast")
    with pytest.raises(ParameterError, match="a name or a Detector, got int"):
        extractor(3)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="a Descriptor or None, got int"):
        extractor("fast", 3)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="choose one, as in descriptor='brief'"):
        extractor("fast").detectAndCompute(IMAGE)
    with pytest.raises(ParameterError, match="choose a descriptor"):
        extractor("fast").compute(IMAGE, [])
    assert not issubclass(Extractor, cv2.Feature2D)
