"""Every feature detector of OpenCV 4.10 to 5 that its wheels hold, one row of a table each.

Names and defaults of the parameters are OpenCV's, in snake_case, with these exceptions: `n_features` is the budget, at
most so many features by response (OpenCV: 500 for ORB, 1000 for GFTT, none for the others); SIFT has
`enable_precise_upscale` switched on, without which its points lie a quarter of a pixel off; and `half_pixel` corrects
the positions that ORB (by up to two pixels, more at higher levels) and Harris-Laplace (by half a pixel) report shifted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from featreg.interfaces import Detector
from featreg.interop.family import N_FEATURES, Member, Option, best_first, option, register_table
from featreg.interop.opencv import (
    BACKENDS,
    HALF_PIXEL,
    LEVELS,
    MIN_SIDE,
    MLDB,
    SIZES,
    Algorithm,
    camel,
    clear_errors,
    clearance,
    grey,
    on_data,
    orb_to_true,
    snake,
)
from featreg.types import Features, FloatArray, Image


def budget(keyword: str) -> dict[str, Option]:
    """OpenCV's own limit on the number of features."""
    return {"n_features": replace(N_FEATURES["n_features"], keyword=keyword)}


@dataclass(frozen=True)
class DetectorAlgorithm(Algorithm):
    """A row of the table.

    Parameters
    ----------
    unlimited : the value of OpenCV's own budget that means no limit, where it applies the budget before the mask
    margin : parameters -> radius in pixels of the smallest support, kept clear of invalid pixels from the start
    true_xy : parameters, features, image shape -> (N, 2) positions without the shift that OpenCV gives them
    min_side : shortest image side that OpenCV handles; smaller images have no features
    """

    unlimited: int | None = None
    margin: Callable[[Mapping[str, Any]], float] | None = None
    true_xy: Callable[[Mapping[str, Any], Features, tuple[int, int]], FloatArray] | None = None
    min_side: int = MIN_SIDE


THRESHOLD = camel(threshold=10, nonmax_suppression=True)
TABLE: dict[str, DetectorAlgorithm] = {
    "agast": DetectorAlgorithm(
        "AgastFeatureDetector",
        "AGAST corners",
        {
            **N_FEATURES,
            **THRESHOLD,
            "type": option("oast-9-16", choices={"5-8": 0, "7-12d": 1, "7-12s": 2, "oast-9-16": 3}, keyword="type"),
        },
    ),
    "akaze": DetectorAlgorithm(
        "AKAZE",
        "AKAZE: blobs in a non-linear scale space, with binary MLDB descriptors",
        {**budget("max_points"), **MLDB, **snake(threshold=0.001), **LEVELS},
        describes=True,
        unlimited=-1,
    ),
    "asift": DetectorAlgorithm(
        "AffineFeature",
        "ASIFT: points and descriptors of a detector in views of the image tilted and turned",
        {
            **N_FEATURES,
            "backend": option("sift", choices=BACKENDS, meaning="the detector that describes each view"),
            **camel(max_tilt=5, min_tilt=0, tilt_step=2**0.5, rotate_step_base=72.0),
        },
        describes=True,
    ),
    "blob": DetectorAlgorithm(
        "SimpleBlobDetector",
        "Blobs by repeated thresholding, filtered by area, colour, circularity, inertia and convexity",
        {
            **N_FEATURES,
            **camel(
                threshold_step=10.0,
                min_threshold=50.0,
                max_threshold=220.0,
                min_repeatability=2,
                min_dist_between_blobs=10.0,
                filter_by_color=True,
                blob_color=0,
                filter_by_area=True,
                min_area=25.0,
                max_area=5000.0,
                filter_by_circularity=False,
                min_circularity=0.8,
                filter_by_inertia=True,
                min_inertia_ratio=0.1,
                filter_by_convexity=True,
                min_convexity=0.95,
            ),
        },
    ),
    "brisk": DetectorAlgorithm(
        "BRISK",
        "BRISK: AGAST corners in scale space, with binary descriptors",
        {**N_FEATURES, **camel(thresh=30, octaves=3, pattern_scale=1.0)},
        describes=True,
    ),
    "fast": DetectorAlgorithm(
        "FastFeatureDetector",
        "FAST corners",
        {**N_FEATURES, **THRESHOLD, "type": option("9-16", choices={"5-8": 0, "7-12": 1, "9-16": 2}, keyword="type")},
    ),
    "gftt": DetectorAlgorithm(
        "GFTTDetector",
        "Good features to track: Shi-Tomasi or Harris corners",
        {
            **budget("maxCorners"),
            **camel(quality_level=0.01, min_distance=1.0, block_size=3, use_harris_detector=False, k=0.04),
        },
        margin=lambda values: values["block_size"] / 2,
    ),
    "harris-laplace": DetectorAlgorithm(
        "HarrisLaplaceFeatureDetector",
        "Harris corners at the scale of the strongest Laplacian",
        {
            **budget("maxCorners"),
            **camel(num_octaves=6),
            **snake(corn_thresh=0.01),
            "dog_thresh": option(0.01, keyword="DOG_thresh"),
            "num_layers": option(4, choices={2: 2, 4: 4}, keyword="num_layers"),
            **HALF_PIXEL,
        },
        true_xy=lambda values, found, shape: found.xy - 0.5,
    ),
    "kaze": DetectorAlgorithm(
        "KAZE",
        "KAZE: blobs in a non-linear scale space, with float descriptors",
        {**N_FEATURES, **SIZES, **snake(threshold=0.001), **LEVELS},
        describes=True,
    ),
    "msd": DetectorAlgorithm(
        "MSDDetector",
        "Maximal self-dissimilarity points",
        {
            **N_FEATURES,
            "patch_radius": option(3, keyword="m_patch_radius"),
            "search_area_radius": option(5, keyword="m_search_area_radius"),
            "nms_radius": option(5, keyword="m_nms_radius"),
            "nms_scale_radius": option(0, keyword="m_nms_scale_radius"),
            "th_saliency": option(250.0, keyword="m_th_saliency"),
            "k_nn": option(4, keyword="m_kNN"),
            "scale_factor": option(1.25, keyword="m_scale_factor"),
            "n_scales": option(-1, keyword="m_n_scales"),
            "compute_orientation": option(False, keyword="m_compute_orientation"),
        },
        min_side=32,
    ),
    "mser": DetectorAlgorithm(
        "MSER",
        "Maximally stable extremal regions, as discs; the largest first",
        {**N_FEATURES, **snake(delta=5, min_area=60, max_area=14400, max_variation=0.25, min_diversity=0.2)},
    ),
    "orb": DetectorAlgorithm(
        "ORB",
        "ORB: FAST corners in a pyramid, with binary oriented BRIEF descriptors",
        {
            **budget("nfeatures"),
            **camel(scale_factor=1.2),
            "n_levels": option(8, keyword="nlevels"),
            **camel(edge_threshold=31),
            "score_type": option("harris", choices={"harris": 0, "fast": 1}, keyword="scoreType"),
            **camel(patch_size=31, fast_threshold=20),
            **HALF_PIXEL,
        },
        describes=True,
        margin=lambda values: values["patch_size"] / 2,
        true_xy=lambda values, found, shape: orb_to_true(found.xy, found.level, values["scale_factor"], shape),
    ),
    "sift": DetectorAlgorithm(
        "SIFT",
        "SIFT: blobs in a difference-of-Gaussian scale space, with float descriptors",
        {
            **budget("nfeatures"),
            **camel(n_octave_layers=3, contrast_threshold=0.04, edge_threshold=10.0, sigma=1.6),
            **snake(enable_precise_upscale=True),
        },
        describes=True,
        unlimited=0,
    ),
    "star": DetectorAlgorithm(
        "StarDetector",
        "Star: centre-surround extrema (CenSurE)",
        {
            **N_FEATURES,
            **camel(
                max_size=45,
                response_threshold=30,
                line_threshold_projected=10,
                line_threshold_binarized=8,
                suppress_nonmax_size=5,
            ),
        },
    ),
    "surf": DetectorAlgorithm(
        "SURF",
        "SURF: box-filter Hessian blobs, with float descriptors",
        {**N_FEATURES, **camel(hessian_threshold=100.0, n_octaves=4, n_octave_layers=3), **SIZES},
        describes=True,
    ),
    "tbmr": DetectorAlgorithm(
        "TBMR",
        "Tree-based Morse regions, as discs; the largest first",
        {**N_FEATURES, **snake(min_area=60, max_area_relative=0.01, scale_factor=1.25, n_scales=-1)},
    ),
}


@register_table
class OpenCVDetector(Member, Detector):
    """One detector of OpenCV: a row of the table by name, and its parameters."""

    table = TABLE
    compiled = False
    describes = "describe"

    def form(self) -> tuple[str, int] | None:
        return TABLE[self.name].form(self.parameters) if self.parameters.get("describe") else None

    def detect_features(self, image: Image) -> Features:
        """Return the keypoints of `image`, best first, ties by position.

        Raises
        ------
        InputError
            OpenCV refuses these parameters together, or for this image.

        Notes
        -----
        No support (a disc of radius `scale`) touches an invalid pixel, and no point lies outside the image.
        """
        algorithm, values = TABLE[self.name], dict(self.parameters)
        if min(image.shape) < algorithm.min_side or not image.mask.any():
            return Features.empty()
        if algorithm.unlimited is not None and not image.all_valid:
            values["n_features"] = algorithm.unlimited
        mask = None
        if not image.all_valid:
            margin = algorithm.margin(values) if algorithm.margin else 0.5
            mask = np.where(image.derive(clearance) >= margin, np.uint8(255), np.uint8(0))
        picture = grey(image, values["normalise"])
        if picture.min() == picture.max():  # MSER of OpenCV 4.10 takes a constant image for a region
            return Features.empty()
        with clear_errors(algorithm.creator):
            detector = algorithm.make(values)
            found = (
                detector.detectAndCompute(picture, mask)
                if values.get("describe")
                else (detector.detect(picture, mask),)
            )
        features = Features.from_keypoints(*found)
        if algorithm.true_xy is not None and values["half_pixel"]:
            features = replace(features, xy=algorithm.true_xy(values, features, image.shape))
        features = features.take(on_data(features, image))
        if not features.score.any():  # where OpenCV gives no response, the region's size stands for it
            features = replace(features, score=features.scale)
        return best_first(features, self.parameters["n_features"])
