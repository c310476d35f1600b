"""What every plugin must do: the kit over all that are registered, their declared ranges, and OpenCV's manners."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import InputError, ParameterError
from featreg.io import as_image
from featreg.testing import check_plugin
from featreg.testing.material import apart, keypoints
from featreg.types import Features

Texture = Callable[..., NDArray[np.float32]]
# Match the features that they were trained on only: tests/interop/test_weights.py.
OF_ITS_OWN = ("kornia-lightglue", "opencv-lightglue")
# Networks with trained weights promise no symmetry.
TRAINED = ("kornia-aliked", "kornia-dedode", "kornia-disk", "kornia-keynet", "kornia-xfeat")
# What OpenCV's own do not pass: pyramids that sample every second pixel from the left, blobs larger than the speckle of
# the kit's image, the order of few grey values.
NOT_PASSED = {
    ("detector", "blob"): ("points", "mirror image", "shifted view"),
    ("detector", "brisk"): ("mirror image",),
    ("detector", "harris-laplace"): ("mirror image",),
    ("descriptor", "lucid"): ("found again",),
    ("detector", "msd"): ("mirror image",),
    ("detector", "mser"): ("shifted view",),
    ("detector", "star"): ("shifted view",),
}
LONG = (
    "asift", "kornia-aliked", "kornia-disk", "kornia-dog", "kornia-gftt", "kornia-harris", "kornia-hessian",
    "scale-search", "skimage-dog", "skimage-ilk", "skimage-orb", "skimage-phase-correlation", "skimage-sift",
    "skimage-tvl1",
)  # fmt: skip
KINDS = ("detector", "descriptor", "nearest", "filter", "matcher")
EVERY = [(kind, name) for kind in KINDS for name in registry.available(kind)]
every = pytest.mark.parametrize(("kind", "name"), EVERY, ids=[f"{k}:{n}" for k, n in EVERY])
CHECKED = [
    pytest.param(kind, name, id=f"{kind}:{name}", marks=pytest.mark.slow if name in LONG else ())
    for kind, name in EVERY
    if name not in OF_ITS_OWN
]
detectors = pytest.mark.parametrize("name", registry.available("detector"))
descriptors = pytest.mark.parametrize("name", registry.available("descriptor"))


def detect(name: str, pixels: NDArray[np.float32]) -> Features:
    most = {"n_features": 100_000} if "n_features" in registry.entry("detector", name).parameters else {}
    return registry.create("detector", name, **most).detect_features(as_image(pixels))


@pytest.mark.parametrize(("kind", "name"), CHECKED)
def test_it_passes_the_conformance_kit(kind: str, name: str) -> None:
    passed = check_plugin(kind, name, symmetric=name not in TRAINED, leave_out=NOT_PASSED.get((kind, name), ()))
    assert passed[:4] == ("parameters", "docstring", "same bits again", "pickled")
    assert len(passed) > 4


@pytest.mark.parametrize("name", [name for kind, name in NOT_PASSED if kind == "detector"])
def test_what_is_less_symmetric_is_nearly_so(name: str, sar_texture: Texture) -> None:
    whole, mirrored = (detect(name, part) for part in (sar_texture(181, 181), sar_texture(181, 181)[:, ::-1]))
    there = mirrored.xy * [-1, 1] + [180, 0]
    distance, partner = apart(whole.xy, there)
    near = distance < 1
    assert near.mean() > 0.4
    np.testing.assert_allclose((there[partner] - whole.xy)[near].mean(axis=0), 0, atol=0.4)
    first, second = (detect(name, sar_texture(220, 220)[rows, columns]) for rows, columns in
                     ((slice(190), slice(190)), (slice(12, 202), slice(20, 210))))  # fmt: skip
    inner = first.xy[((first.xy > [60, 52]) & (first.xy < 150)).all(axis=1)]
    assert len(inner) > 1
    assert (apart(inner - [20, 12], second.xy)[0] < 1).mean() > 0.3


# What is declared


@every
def test_values_beyond_what_is_declared_are_refused_whoever_constructs(kind: str, name: str) -> None:
    entry = registry.entry(kind, name)
    makers: list[Callable[..., Any]] = [lambda **given: registry.create(kind, name, **given)]  # type: ignore[call-overload]
    makers += [entry.factory] if isinstance(entry.factory, type) else []
    for key, parameter in entry.declared.items():
        assert parameter.allows(parameter.default), key
        beyond: list[Any] = ["no such choice", None] if parameter.choices else []
        beyond += [-np.inf, np.inf, np.nan] if parameter.kind is float else []
        beyond += [-(10**9), 10**9, 1.5, True] if parameter.kind is int else []
        for value in beyond:
            for make in makers if not parameter.allows(value) else []:
                with pytest.raises(ParameterError, match=re.escape(f"'{name}.{key}' must be ")):
                    make(**{key: value})


@every
def test_numbers_of_our_own_have_a_declared_range_and_a_meaning(kind: str, name: str) -> None:
    entry = registry.entry(kind, name)
    if isinstance(entry.factory, type):
        free = [key for key, one in entry.declared.items() if one.kind in (int, float) and not one.bounds]
        assert free == (["chance"] if name == "target-centroids" else [])
        assert all(one.meaning for one in entry.declared.values())


# OpenCV's manners


def tiles() -> dict[str, tuple[NDArray[Any], NDArray[np.uint8] | None]]:
    """Arrays on which there is nothing to find, and their masks."""
    noise = np.random.default_rng(0).gamma(4, 0.25, (64, 64)).astype(np.float32)
    return {
        "blank": (np.full((64, 64), 3, np.float32), None),
        "all masked": (noise, np.zeros((64, 64), np.uint8)),
        "10 x 10": (noise[:10, :10], None),
        "1 x 1": (noise[:1, :1], np.full((1, 1), 255, np.uint8)),
        "no data": (np.full((64, 64), np.nan, np.float32), None),
    }


@detectors
def test_detecting_on_nothing_finds_nothing(name: str) -> None:
    made = featreg.extractor(name)
    for what, (array, mask) in tiles().items():
        assert made.detect(array, mask) == [], what
        assert made.detector.detect(array, mask) == [], what
        assert featreg.extractor(name, "brief").detectAndCompute(array, mask) == ([], None), what


@descriptors
def test_describing_on_nothing_gives_nothing(name: str) -> None:
    made = featreg.extractor("fast", name)
    points = keypoints((120, 120), 5).to_keypoints()
    for what, (array, mask) in tiles().items():
        assert made.detectAndCompute(array, mask) == ([], None), what
        if what != "all masked":  # OpenCV's compute knows no mask
            assert made.compute(array, points) == ([], None), what
    assert made.compute(np.random.default_rng(0).gamma(4, 0.25, (64, 64)), []) == ([], None)


@detectors
def test_an_array_of_no_image_and_a_mask_of_another_size_are_refused(name: str) -> None:
    made = featreg.extractor(name)
    noise = np.random.default_rng(0).gamma(4, 0.25, (64, 64))
    for array, mask in (
        (np.stack([noise] * 3, axis=2), None),
        (np.full((10, 10, 3), 7, np.uint8), None),
        (noise, np.ones((64, 63), np.uint8)),
        (noise[:10, :10], np.ones((64, 64), np.uint8)),
        (np.full((64, 64), "a"), None),
    ):
        with pytest.raises(InputError):
            made.detect(array, mask)


@descriptors
def test_the_form_of_descriptors_is_known_before_they_are_made(name: str, sar_texture: Texture) -> None:
    made = featreg.extractor("fast", name)
    form = (made.defaultNorm(), made.descriptorSize(), made.descriptorType())
    found = registry.create("descriptor", name).describe_features(
        as_image(sar_texture(150, 160)), keypoints((150, 160))
    )
    assert found.descriptors is not None
    constants = (cv2.NORM_HAMMING, cv2.CV_8U) if found.norm == "hamming" else (cv2.NORM_L2, cv2.CV_32F)
    assert form == (constants[0], found.descriptors.shape[1], constants[1])
