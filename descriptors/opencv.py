"""Every feature descriptor of OpenCV 4.10 to 5 that its wheels hold, one row of a table each.

Names and defaults of the parameters are OpenCV's, in snake_case. Each describes the features of any detector: the
pyramid level that ORB, SIFT, AKAZE and KAZE read a keypoint from, which OpenCV keeps in private numbers of its own
keypoints, follows from the feature's scale, and with their own keypoints it is the level OpenCV used (nearly always for
KAZE, which refines the scale by up to a level). KAZE alone, in OpenCV as here, gives other descriptors to keypoints
that it has not detected in the same call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.interfaces import Descriptor
from featreg.interop.family import Member, option, register_table
from featreg.interop.opencv import (
    HALF_PIXEL,
    LEVELS,
    MIN_SIDE,
    MLDB,
    SIZES,
    Algorithm,
    camel,
    clear_errors,
    grey,
    inside,
    snake,
    true_to_orb,
)
from featreg.types import Features, Image, IntArray
from featreg.types.keypoints import to_radians

Place = Callable[[Mapping[str, Any], Features, tuple[int, int]], tuple[IntArray, IntArray | None]]
SMALLEST = 0.5  # OpenCV 4.10 writes past its memory where SIFT is given a keypoint of size 0


@dataclass(frozen=True)
class DescriptorAlgorithm(Algorithm):
    """A row of the table.

    Parameters
    ----------
    place : parameters, features, image shape -> the `octave` and `class_id` of OpenCV's own keypoints of that scale
    colour : it reads three channels; the grey image is given three times
    anchor : `octave` of a keypoint that is added to each call and taken out again: SIFT doubles the image only where a
        keypoint needs it, and then describes all others slightly differently
    """

    place: Place | None = None
    colour: bool = False
    anchor: int | None = None


def _steps(features: Features, size: float, per_octave: float) -> IntArray:
    """(N,) whole steps from the diameter `size` to the features', `per_octave` of them to a factor of two."""
    diameter = np.maximum(2.0 * features.scale, 1e-6)
    return np.rint(per_octave * np.log2(diameter / size)).astype(np.int64)


def _place_orb(values: Mapping[str, Any], features: Features, shape: tuple[int, int]) -> tuple[IntArray, None]:
    per_octave = 1.0 / np.log2(values["scale_factor"])
    return np.clip(_steps(features, values["patch_size"], per_octave), 0, values["n_levels"] - 1), None


def _place_sift(values: Mapping[str, Any], features: Features, shape: tuple[int, int]) -> tuple[IntArray, None]:
    layers = values["n_octave_layers"]
    steps = _steps(features, 2.0 * values["sigma"], layers)
    largest = max(0, int(np.log2(min(shape))) - 2)
    octave = np.clip((steps - 1) // layers, -1, largest)
    layer = np.clip(steps - octave * layers, 1, layers)
    return (octave & 255) | (layer << 8), None


def _place_akaze(values: Mapping[str, Any], features: Features, shape: tuple[int, int]) -> tuple[IntArray, IntArray]:
    octaves = 1
    while octaves < values["n_octaves"] and shape[0] >> octaves >= 40 and shape[1] >> octaves >= 80:
        octaves += 1
    layers = values["n_octave_layers"]
    level = np.clip(_steps(features, 2.0 * 1.5 * 1.6, layers), 0, octaves * layers - 1)
    return level // layers, level


def _place_kaze(values: Mapping[str, Any], features: Features, shape: tuple[int, int]) -> tuple[IntArray, IntArray]:
    layers = values["n_octave_layers"]
    level = np.clip(_steps(features, 2.0 * 1.6, layers), 1, values["n_octaves"] * layers - 1)
    return level // layers, level


BOOST = {
    "bgm": 100, "bgm-hard": 101, "bgm-bilinear": 102, "lbgm": 200,
    "binboost-64": 300, "binboost-128": 301, "binboost-256": 302,
}  # fmt: skip
TABLE: dict[str, DescriptorAlgorithm] = {
    "akaze": DescriptorAlgorithm(
        "AKAZE", "MLDB bits (or KAZE floats) read from a non-linear scale space", {**MLDB, **LEVELS}, place=_place_akaze
    ),
    "beblid": DescriptorAlgorithm(
        "BEBLID",
        "Boosted bits; scale_factor 1 suits ORB's sizes, 5 AKAZE's and FAST's, 6.25 KAZE's, 6.75 SIFT's",
        {**snake(scale_factor=1.0), "n_bits": option(512, choices={512: 100, 256: 101}, keyword="n_bits")},
    ),
    "boost": DescriptorAlgorithm(
        "BoostDesc",
        "BinBoost bits; scale_factor 0.75 suits ORB's sizes, 5 AKAZE's and FAST's, 6.25 KAZE's, 6.75 SIFT's",
        {
            "desc": option("binboost-256", choices=BOOST, keyword="desc"),
            **snake(use_scale_orientation=True, scale_factor=6.25),
        },
    ),
    "daisy": DescriptorAlgorithm(
        "DAISY",
        "DAISY: gradient histograms on rings around the point",
        {
            **snake(radius=15.0, q_radius=3, q_theta=8, q_hist=8),
            "norm": option("none", choices={"none": 100, "partial": 101, "full": 102, "sift": 103}, keyword="norm"),
            **snake(interpolation=True, use_orientation=False),
        },
    ),
    "freak": DescriptorAlgorithm(
        "FREAK",
        "FREAK: bits on a retina-like pattern, which measures its own orientation",
        camel(orientation_normalized=True, scale_normalized=True, pattern_scale=22.0, n_octaves=4),
    ),
    "brisk": DescriptorAlgorithm(
        "BRISK", "BRISK: bits on a ring pattern, which measures its own orientation", camel(pattern_scale=1.0)
    ),
    "kaze": DescriptorAlgorithm(
        "KAZE", "KAZE: gradient sums read from a non-linear scale space", {**SIZES, **LEVELS}, place=_place_kaze
    ),
    "latch": DescriptorAlgorithm(
        "LATCH",
        "LATCH: bits from comparing triplets of patches",
        {**camel(bytes=32, rotation_invariance=True), **snake(half_ssd_size=3, sigma=2.0)},
    ),
    "lucid": DescriptorAlgorithm(
        "LUCID",
        "LUCID: the order of a patch's pixels; made for colour, so a grey image is given as three equal channels",
        snake(lucid_kernel=1, blur_kernel=2),
        colour=True,
    ),
    "opencv-brief": DescriptorAlgorithm(
        "BriefDescriptorExtractor",
        "BRIEF bits as OpenCV samples them",
        {"bytes": option(32, choices={16: 16, 32: 32, 64: 64}, keyword="bytes"), **snake(use_orientation=False)},
    ),
    "orb": DescriptorAlgorithm(
        "ORB",
        "Oriented BRIEF bits read from ORB's pyramid",
        {
            **camel(scale_factor=1.2),
            "n_levels": option(8, keyword="nlevels"),
            **camel(edge_threshold=31, patch_size=31),
            **HALF_PIXEL,
        },
        place=_place_orb,
    ),
    "sift": DescriptorAlgorithm(
        "SIFT",
        "SIFT: gradient histograms read from a Gaussian pyramid",
        {**camel(n_octave_layers=3, sigma=1.6), **snake(enable_precise_upscale=True)},
        place=_place_sift,
        anchor=255 | (1 << 8),
    ),
    "surf": DescriptorAlgorithm("SURF", "SURF: sums of Haar wavelet responses", SIZES),
    "teblid": DescriptorAlgorithm(
        "TEBLID",
        "Triplet-trained bits; scale_factor 1 suits ORB's sizes, 5 AKAZE's and FAST's, 6.25 KAZE's, 6.75 SIFT's",
        {**snake(scale_factor=1.0), "n_bits": option(256, choices={256: 102, 512: 103}, keyword="n_bits")},
    ),
    "vgg": DescriptorAlgorithm(
        "VGG",
        "Learnt floats (DLCO); scale_factor 0.75 suits ORB's sizes, 5 AKAZE's and FAST's, 6.25 KAZE's, 6.75 SIFT's",
        {
            "desc": option(120, choices={120: 100, 80: 101, 64: 102, 48: 103}, keyword="desc"),
            **snake(isigma=1.4, img_normalize=True, use_scale_orientation=True, scale_factor=6.25, dsc_normalize=False),
        },
    ),
}


@register_table
class OpenCVDescriptor(Member, Descriptor):
    """One descriptor of OpenCV: a row of the table by name, and its parameters."""

    table = TABLE
    compiled = False

    def form(self) -> tuple[str, int]:
        return TABLE[self.name].form(self.parameters)

    def describe_features(self, image: Image, features: Features) -> Features:
        """Return the features with descriptors, in the order given.

        Those outside the image, too near its border or (KAZE) on a flat patch are dropped.

        Raises
        ------
        InputError
            OpenCV refuses these parameters together, or for this image.

        Notes
        -----
        Binary descriptors are packed uint8 with the norm "hamming", all others float32 with "l2". `angle` becomes the
        orientation that the descriptor measured (BRISK, FREAK, KAZE); the others use the one they are given.
        """
        algorithm, values = TABLE[self.name], self.parameters
        within = np.flatnonzero(inside(features.xy, image.shape))
        if len(within) == 0 or min(image.shape) < MIN_SIDE:
            return _nothing(features)
        used = features.take(within)
        octave, class_id = algorithm.place(values, used, image.shape) if algorithm.place else (used.level & 255, None)
        placed = replace(used, scale=np.maximum(used.scale, SMALLEST))
        if values.get("half_pixel"):
            placed = replace(placed, xy=true_to_orb(used.xy, octave, values["scale_factor"], image.shape))
        given = placed.to_keypoints(octave=octave, class_id=np.arange(len(used)) if class_id is None else class_id)
        sent = np.array([k.angle for k in given])
        if algorithm.anchor is not None:
            given += placed.take(np.zeros(1, np.int64)).to_keypoints(octave=algorithm.anchor)
        picture: NDArray[Any] = grey(image, values["normalise"])
        if algorithm.colour:
            picture = np.repeat(picture[:, :, None], 3, axis=2)
        with clear_errors(algorithm.creator):
            kept, descriptors = algorithm.make(values).compute(picture, given)
        if len(kept) == 0 or descriptors is None:
            return _nothing(features)
        if class_id is None:
            rows = np.array([k.class_id for k in kept], dtype=np.int64)
            real = np.flatnonzero(rows >= 0)
            kept, descriptors, rows = [kept[i] for i in real], descriptors[real], rows[real]
        elif len(kept) == len(used):
            rows = np.arange(len(used))
        else:
            raise InputError(f"OpenCV's {algorithm.creator} lost {len(used) - len(kept)} of its keypoints")
        # KAZE divides by the length of a descriptor, which a flat patch does not have.
        order = np.argsort(rows, kind="stable")
        order = order[np.isfinite(descriptors[order]).all(axis=1)]
        turned, sent, rows = np.array([k.angle for k in kept])[order], sent[rows[order]], within[rows[order]]
        dtype: Any = np.uint8 if descriptors.dtype == np.uint8 else np.float32
        return replace(
            features.take(rows),
            angle=np.where(turned == sent, features.angle[rows], to_radians(turned)),
            descriptors=np.ascontiguousarray(descriptors[order], dtype=dtype),
            norm="hamming" if dtype is np.uint8 else "l2",
            index=None if np.array_equal(rows, np.arange(len(features))) else rows,
        )


def _nothing(features: Features) -> Features:
    none = features.take(np.zeros(0, np.int64))
    return replace(none, descriptors=None, index=np.zeros(0, np.int64) if len(features) else None)
