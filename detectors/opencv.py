"""Every feature detector of OpenCV 4.10 to 5 that its wheels hold, one row of a table each.

Names and defaults of the parameters are OpenCV's, in snake_case, with these exceptions: `n_features` is the budget, at
most so many features by response (OpenCV: 500 for ORB, 1000 for GFTT, none for the others); SIFT has
`enable_precise_upscale` switched on, without which its points lie a quarter of a pixel off; and `half_pixel` corrects
the positions that ORB (by up to two pixels, more at higher levels) and Harris-Laplace (by half a pixel) report shifted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from featreg.interfaces import Detector
from featreg.interop.opencv import (
    NORMALISE,
    Algorithm,
    Parameter,
    clear_errors,
    clearance,
    grey,
    on_data,
    orb_to_true,
    unavailable,
)
from featreg.registry import register_family
from featreg.types import Features, FloatArray, Image

P = Parameter
BUDGET = 5000
MIN_SIDE = 16


@dataclass(frozen=True)
class DetectorAlgorithm(Algorithm):
    """A row of the table.

    Parameters
    ----------
    describes : it describes as well, and has a parameter `describe`
    unlimited : the value of OpenCV's own budget that means no limit, where it applies the budget before the mask
    margin : parameters -> radius in pixels of the smallest support, kept clear of invalid pixels from the start
    true_xy : parameters, features, image shape -> (N, 2) positions without the shift that OpenCV gives them
    min_side : shortest image side that OpenCV handles; smaller images have no features
    """

    describes: bool = False
    unlimited: int | None = None
    margin: Callable[[Mapping[str, Any]], float] | None = None
    true_xy: Callable[[Mapping[str, Any], Features, tuple[int, int]], FloatArray] | None = None
    min_side: int = MIN_SIDE


@dataclass(frozen=True)
class OpenCVDetector(Detector):
    """One detector of OpenCV: a row of the table by name, and its parameters.

    Parameters
    ----------
    name : key of `TABLE`
    parameters : the values that differ from the defaults; afterwards all, also as attributes
    """

    name: str
    parameters: Mapping[str, Any]

    def __post_init__(self) -> None:
        values = TABLE[self.name].settings(self.parameters)
        object.__setattr__(self, "parameters", values)
        vars(self).update(values)

    def __hash__(self) -> int:
        return hash((self.name, *self.parameters.values()))

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
        return _best(features.take(on_data(features, image)), self.parameters["n_features"])


def _best(features: Features, count: int) -> Features:
    """The best `count` features in a fixed order; where OpenCV gives no response, the region's size stands for it."""
    if len(features) and not features.score.any():
        features = replace(features, score=features.scale)
    x, y = features.xy.T
    order = np.lexsort((features.angle, features.scale, x, y, -features.score))
    return features.take(order[:count])


def _orb_margin(values: Mapping[str, Any]) -> float:
    return float(values["patch_size"]) / 2.0


def _block_margin(values: Mapping[str, Any]) -> float:
    return float(values["block_size"]) / 2.0


def _orb_xy(values: Mapping[str, Any], features: Features, shape: tuple[int, int]) -> FloatArray:
    return orb_to_true(features.xy, features.level, values["scale_factor"], shape)


def _harris_laplace_xy(values: Mapping[str, Any], features: Features, shape: tuple[int, int]) -> FloatArray:
    return features.xy - 0.5


N_FEATURES = P("", BUDGET)
HALF_PIXEL = P("", True)
THRESHOLD = {"threshold": P("threshold", 10), "nonmax_suppression": P("nonmaxSuppression", True)}
DIFFUSIVITY = P("diffusivity", "pm-g2", {"pm-g1": 0, "pm-g2": 1, "weickert": 2, "charbonnier": 3})
TABLE: dict[str, DetectorAlgorithm] = {
    "agast": DetectorAlgorithm(
        "AgastFeatureDetector",
        "AGAST corners",
        {
            "n_features": N_FEATURES,
            **THRESHOLD,
            "type": P("type", "oast-9-16", {"5-8": 0, "7-12d": 1, "7-12s": 2, "oast-9-16": 3}),
        },
    ),
    "akaze": DetectorAlgorithm(
        "AKAZE",
        "AKAZE: blobs in a non-linear scale space, with binary MLDB descriptors",
        {
            "n_features": P("max_points", BUDGET),
            "descriptor_type": P(
                "descriptor_type", "mldb", {"kaze-upright": 2, "kaze": 3, "mldb-upright": 4, "mldb": 5}
            ),
            "descriptor_size": P("descriptor_size", 0),
            "descriptor_channels": P("descriptor_channels", 3),
            "threshold": P("threshold", 0.001),
            "n_octaves": P("nOctaves", 4),
            "n_octave_layers": P("nOctaveLayers", 4),
            "diffusivity": DIFFUSIVITY,
        },
        describes=True,
        unlimited=-1,
    ),
    "blob": DetectorAlgorithm(
        "SimpleBlobDetector",
        "Blobs by repeated thresholding, filtered by area, colour, circularity, inertia and convexity",
        {
            "n_features": N_FEATURES,
            "threshold_step": P("thresholdStep", 10.0),
            "min_threshold": P("minThreshold", 50.0),
            "max_threshold": P("maxThreshold", 220.0),
            "min_repeatability": P("minRepeatability", 2),
            "min_dist_between_blobs": P("minDistBetweenBlobs", 10.0),
            "filter_by_color": P("filterByColor", True),
            "blob_color": P("blobColor", 0),
            "filter_by_area": P("filterByArea", True),
            "min_area": P("minArea", 25.0),
            "max_area": P("maxArea", 5000.0),
            "filter_by_circularity": P("filterByCircularity", False),
            "min_circularity": P("minCircularity", 0.8),
            "filter_by_inertia": P("filterByInertia", True),
            "min_inertia_ratio": P("minInertiaRatio", 0.1),
            "filter_by_convexity": P("filterByConvexity", True),
            "min_convexity": P("minConvexity", 0.95),
        },
    ),
    "brisk": DetectorAlgorithm(
        "BRISK",
        "BRISK: AGAST corners in scale space, with binary descriptors",
        {
            "n_features": N_FEATURES,
            "thresh": P("thresh", 30),
            "octaves": P("octaves", 3),
            "pattern_scale": P("patternScale", 1.0),
        },
        describes=True,
    ),
    "fast": DetectorAlgorithm(
        "FastFeatureDetector",
        "FAST corners",
        {"n_features": N_FEATURES, **THRESHOLD, "type": P("type", "9-16", {"5-8": 0, "7-12": 1, "9-16": 2})},
    ),
    "gftt": DetectorAlgorithm(
        "GFTTDetector",
        "Good features to track: Shi-Tomasi or Harris corners",
        {
            "n_features": P("maxCorners", BUDGET),
            "quality_level": P("qualityLevel", 0.01),
            "min_distance": P("minDistance", 1.0),
            "block_size": P("blockSize", 3),
            "use_harris_detector": P("useHarrisDetector", False),
            "k": P("k", 0.04),
        },
        margin=_block_margin,
    ),
    "harris-laplace": DetectorAlgorithm(
        "HarrisLaplaceFeatureDetector",
        "Harris corners at the scale of the strongest Laplacian",
        {
            "n_features": P("maxCorners", BUDGET),
            "num_octaves": P("numOctaves", 6),
            "corn_thresh": P("corn_thresh", 0.01),
            "dog_thresh": P("DOG_thresh", 0.01),
            "num_layers": P("num_layers", 4, {2: 2, 4: 4}),
            "half_pixel": HALF_PIXEL,
        },
        true_xy=_harris_laplace_xy,
    ),
    "kaze": DetectorAlgorithm(
        "KAZE",
        "KAZE: blobs in a non-linear scale space, with float descriptors",
        {
            "n_features": N_FEATURES,
            "extended": P("extended", False),
            "upright": P("upright", False),
            "threshold": P("threshold", 0.001),
            "n_octaves": P("nOctaves", 4),
            "n_octave_layers": P("nOctaveLayers", 4),
            "diffusivity": DIFFUSIVITY,
        },
        describes=True,
    ),
    "msd": DetectorAlgorithm(
        "MSDDetector",
        "Maximal self-dissimilarity points",
        {
            "n_features": N_FEATURES,
            "patch_radius": P("m_patch_radius", 3),
            "search_area_radius": P("m_search_area_radius", 5),
            "nms_radius": P("m_nms_radius", 5),
            "nms_scale_radius": P("m_nms_scale_radius", 0),
            "th_saliency": P("m_th_saliency", 250.0),
            "k_nn": P("m_kNN", 4),
            "scale_factor": P("m_scale_factor", 1.25),
            "n_scales": P("m_n_scales", -1),
            "compute_orientation": P("m_compute_orientation", False),
        },
        min_side=32,
    ),
    "mser": DetectorAlgorithm(
        "MSER",
        "Maximally stable extremal regions, as discs; the largest first",
        {
            "n_features": N_FEATURES,
            "delta": P("delta", 5),
            "min_area": P("min_area", 60),
            "max_area": P("max_area", 14400),
            "max_variation": P("max_variation", 0.25),
            "min_diversity": P("min_diversity", 0.2),
        },
    ),
    "orb": DetectorAlgorithm(
        "ORB",
        "ORB: FAST corners in a pyramid, with binary oriented BRIEF descriptors",
        {
            "n_features": P("nfeatures", BUDGET),
            "scale_factor": P("scaleFactor", 1.2),
            "n_levels": P("nlevels", 8),
            "edge_threshold": P("edgeThreshold", 31),
            "score_type": P("scoreType", "harris", {"harris": 0, "fast": 1}),
            "patch_size": P("patchSize", 31),
            "fast_threshold": P("fastThreshold", 20),
            "half_pixel": HALF_PIXEL,
        },
        describes=True,
        margin=_orb_margin,
        true_xy=_orb_xy,
    ),
    "sift": DetectorAlgorithm(
        "SIFT",
        "SIFT: blobs in a difference-of-Gaussian scale space, with float descriptors",
        {
            "n_features": P("nfeatures", BUDGET),
            "n_octave_layers": P("nOctaveLayers", 3),
            "contrast_threshold": P("contrastThreshold", 0.04),
            "edge_threshold": P("edgeThreshold", 10.0),
            "sigma": P("sigma", 1.6),
            "enable_precise_upscale": P("enable_precise_upscale", True),
        },
        describes=True,
        unlimited=0,
    ),
    "star": DetectorAlgorithm(
        "StarDetector",
        "Star: centre-surround extrema (CenSurE)",
        {
            "n_features": N_FEATURES,
            "max_size": P("maxSize", 45),
            "response_threshold": P("responseThreshold", 30),
            "line_threshold_projected": P("lineThresholdProjected", 10),
            "line_threshold_binarized": P("lineThresholdBinarized", 8),
            "suppress_nonmax_size": P("suppressNonmaxSize", 5),
        },
    ),
    "surf": DetectorAlgorithm(
        "SURF",
        "SURF: box-filter Hessian blobs, with float descriptors",
        {
            "n_features": N_FEATURES,
            "hessian_threshold": P("hessianThreshold", 100.0),
            "n_octaves": P("nOctaves", 4),
            "n_octave_layers": P("nOctaveLayers", 3),
            "extended": P("extended", False),
            "upright": P("upright", False),
        },
        describes=True,
    ),
    "tbmr": DetectorAlgorithm(
        "TBMR",
        "Tree-based Morse regions, as discs; the largest first",
        {
            "n_features": N_FEATURES,
            "min_area": P("min_area", 60),
            "max_area_relative": P("max_area_relative", 0.01),
            "scale_factor": P("scale_factor", 1.25),
            "n_scales": P("n_scales", -1),
        },
    ),
}


def _create(name: str, **parameters: Any) -> OpenCVDetector:
    return OpenCVDetector(name, parameters)


for _name, _row in TABLE.items():
    _row = replace(
        _row, parameters=dict(_row.parameters) | ({"describe": P("", True)} if _row.describes else {}) | NORMALISE
    )
    TABLE[_name] = _row
    register_family(
        "detector",
        _name,
        partial(_create, _name),
        _row.defaults,
        summary=_row.summary,
        module=__name__,
        unavailable=unavailable(_row.creator),
    )
