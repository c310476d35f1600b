"""Detectors of scikit-image, one row of a table each: ORB, SIFT, CenSurE, corner responses and blobs.

Names and defaults of the parameters are scikit-image's, with these exceptions: `n_features` is the budget, at most so
many by score; FAST and the corner responses take every peak above `threshold_rel` of the highest, where scikit-image's
example has 0.1; blobs are sought up to a sigma of 8 instead of 30 or 50 px; and the positions that ORB reports shifted
by up to two pixels, and SIFT by a quarter of one, are put right.

Departures from scikit-image: a support that touches an invalid pixel drops its point. CenSurE and SIFT give no
response: the strength of the Laplacian at the point's scale is the score. `blob_doh` is left out: its box filters are
not symmetric, and the blobs of an image and of its mirror image lie 1 to 3 px apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from annotated_types import Ge, Gt, Interval

from featreg.interfaces import Detector
from featreg.interop.family import DESCRIBE, N_FEATURES, Member, best_first, option, register_table
from featreg.interop.opencv import MIN_SIDE, grey, on_data
from featreg.interop.scikit_image import SkimageRow, features, own, picture, pyramid_to_true, to_xy
from featreg.types import Features, FloatArray, Image

# Radius of the support of a point of scale 1: of ORB's patch, of CenSurE's largest ring, of SIFT's sigma.
ORB_RADIUS, CENSURE_RADIUS, SIFT_RADIUS = 15.5, 3.0, 6.0


def _orb(image: FloatArray, values: Mapping[str, Any]) -> Features:
    from skimage.feature import ORB

    keywords = {key: values[key] for key in ("downscale", "n_scales", "fast_n", "fast_threshold", "harris_k")}
    # It has no other way to say "all".
    orb = ORB(n_keypoints=image.size, **keywords)
    (orb.detect_and_extract if values["describe"] else orb.detect)(image)
    level = np.rint(np.log(orb.scales) / np.log(values["downscale"])).astype(np.int64)
    xy = pyramid_to_true(to_xy(orb.keypoints), level, values["downscale"], (image.shape[0], image.shape[1]))
    table = np.asarray(orb.descriptors, np.bool_) if values["describe"] else None
    # Angles of images whose rows run down are clockwise as seen.
    return features(xy, ORB_RADIUS * orb.scales, orb.responses, np.mod(-orb.orientations, 2 * np.pi), level, table)


def _sift(image: FloatArray, values: Mapping[str, Any]) -> Features:
    from skimage.feature import SIFT

    names = (
        "upsampling", "n_octaves", "n_scales", "sigma_min", "sigma_in", "c_dog", "c_edge", "n_bins", "lambda_ori",
        "c_max", "lambda_descr", "n_hist", "n_ori",
    )  # fmt: skip
    sift = SIFT(**{key: values[key] for key in names})
    (sift.detect_and_extract if values["describe"] else sift.detect)(image)
    # Pixel u of the enlarged image is u / f + (1 / f - 1) / 2 of the image.
    xy = to_xy(sift.positions) + 0.5 * (1 / values["upsampling"] - 1)
    table = np.asarray(sift.descriptors, np.float32) if values["describe"] else None
    # They are measured from down towards the right.
    angle = np.mod(sift.orientations - np.pi / 2, 2 * np.pi)
    score = laplacian(image, xy, sift.sigmas)
    return features(xy, SIFT_RADIUS * sift.sigmas, score, angle, sift.octaves, table)


def _censure(image: FloatArray, values: Mapping[str, Any]) -> Features:
    from skimage.feature import CENSURE

    names = ("min_scale", "max_scale", "mode", "non_max_threshold", "line_threshold")
    censure = CENSURE(**{key: values[key] for key in names})
    censure.detect(image)
    xy = to_xy(censure.keypoints)
    return features(xy, CENSURE_RADIUS * censure.scales, laplacian(image, xy, censure.scales))


def laplacian(image: FloatArray, xy: FloatArray, sigma: Any) -> FloatArray:
    """Return the (N,) strength of the scale-normalised Laplacian of (H, W) at points (N, 2), to a quarter octave."""
    from scipy.ndimage import gaussian_laplace

    sigmas = 2 ** (np.rint(4 * np.log2(np.maximum(sigma, 0.5))) / 4)
    column, row = np.clip(np.rint(xy).astype(np.int64), 0, np.array(image.shape[::-1]) - 1).T
    out = np.zeros(len(xy))
    for one in np.unique(sigmas):
        at = sigmas == one
        out[at] = np.abs(one**2 * gaussian_laplace(image, one)[row[at], column[at]])
    return out


def _corners(image: FloatArray, values: Mapping[str, Any]) -> Features:
    """Peaks of a corner response."""
    from skimage import feature

    settings = {key: values[key] for key in RESPONSES[values["response"]] if key in values}
    response = getattr(feature, f"corner_{values['response']}")(image, **settings)
    if values["response"] == "foerstner":
        # Of the error ellipse: its size where it is round enough.
        accuracy, roundness = response
        response = np.where(roundness > values["roundness"], accuracy, 0.0)
    response = np.nan_to_num(np.asarray(response, np.float64))
    highest = float(response.max())
    if highest <= 0:
        return Features.empty()
    at = feature.peak_local_max(
        response,
        min_distance=values["min_distance"],
        threshold_abs=max(values["threshold_rel"] * highest, np.finfo(np.float64).tiny),
        exclude_border=False,
    )
    return features(to_xy(at), values["support"], response[at[:, 0], at[:, 1]])


def _blobs(image: FloatArray, values: Mapping[str, Any]) -> Features:
    from skimage import feature

    kind = values["response"]
    names = BLOBS[kind]
    found = np.asarray(getattr(feature, f"blob_{kind}")(image, **{key: values[key] for key in names})).reshape(-1, 3)
    xy, sigma = to_xy(found[:, :2]), found[:, 2]
    # The radius of a blob is sigma times the root of 2; its support is twice as wide.
    return features(xy, 2 * np.sqrt(2) * sigma, laplacian(image, xy, sigma))


RESPONSES = {
    "harris": ("method", "k", "eps", "sigma"),
    "shi_tomasi": ("sigma",),
    "foerstner": ("sigma",),
    "fast": ("n", "threshold"),
    "moravec": ("window_size",),
    "kitchen_rosenfeld": (),
}
BLOBS = {
    "log": ("min_sigma", "max_sigma", "num_sigma", "threshold", "overlap", "log_scale"),
    "dog": ("min_sigma", "max_sigma", "sigma_ratio", "threshold", "overlap"),
}
PEAKS = {
    "min_distance": option(1, Ge(1), keyword="min_distance", meaning="of neighbouring points, px"),
    "threshold_rel": option(0.01, Interval(ge=0, lt=1), meaning="least response, as a part of the highest"),
    "support": option(8.0, Gt(0), meaning="radius of the support, px"),
}
SIGMA = {"sigma": option(1.0, Gt(0), keyword="sigma", meaning="of the window of the structure tensor, px")}
OVERLAP = {"overlap": option(0.5, Interval(ge=0, le=1), keyword="overlap")}


def _corner(response: str, summary: str, **parameters: Any) -> SkimageRow:
    return SkimageRow(
        f"corner_{response}",
        f"{summary}, by scikit-image",
        {**N_FEATURES, "response": option(response, choices=(response,)), **parameters, **PEAKS},
        run=_corners,
    )


def _blob(response: str, summary: str, **parameters: Any) -> SkimageRow:
    return SkimageRow(
        f"blob_{response}",
        f"{summary}, by scikit-image",
        {**N_FEATURES, "response": option(response, choices=(response,)), **parameters},
        run=_blobs,
    )


TABLE: dict[str, SkimageRow] = {
    "skimage-orb": SkimageRow(
        "ORB",
        "ORB: FAST corners in a pyramid, with binary oriented BRIEF descriptors, by scikit-image",
        {
            **N_FEATURES,
            "downscale": option(1.2, Gt(1), keyword="downscale"),
            "n_scales": option(8, Ge(1), keyword="n_scales"),
            "fast_n": option(9, Interval(ge=1, le=16), keyword="fast_n"),
            "fast_threshold": option(0.08, Ge(0), keyword="fast_threshold"),
            "harris_k": option(0.04, Ge(0), keyword="harris_k"),
            **DESCRIBE,
        },
        run=_orb,
    ),
    "skimage-sift": SkimageRow(
        "SIFT",
        "SIFT: blobs in a difference-of-Gaussian scale space, with float descriptors, by scikit-image",
        {
            **N_FEATURES,
            "upsampling": option(2, choices=(1, 2, 4), keyword="upsampling"),
            **own(n_octaves=8, n_scales=3, sigma_min=1.6, sigma_in=0.5, c_dog=0.04 / 3, c_edge=10.0, n_bins=36),
            **own(lambda_ori=1.5, c_max=0.8, lambda_descr=6.0, n_hist=4, n_ori=8),
            **DESCRIBE,
        },
        run=_sift,
    ),
    "skimage-censure": SkimageRow(
        "CENSURE",
        "CenSurE: extrema of centre-surround filters, by scikit-image",
        {
            **N_FEATURES,
            "min_scale": option(1, Ge(1), keyword="min_scale"),
            "max_scale": option(7, Ge(3), keyword="max_scale"),
            "mode": option("DoB", choices=("DoB", "Octagon", "STAR"), keyword="mode"),
            **own(non_max_threshold=0.15, line_threshold=10.0),
        },
        run=_censure,
    ),
    "skimage-harris": _corner(
        "harris",
        "Harris corners",
        method=option("k", choices=("k", "eps"), keyword="method"),
        **own(k=0.05, eps=1e-6),
        **SIGMA,
    ),
    "skimage-shi-tomasi": _corner("shi_tomasi", "Shi-Tomasi corners", **SIGMA),
    "skimage-foerstner": _corner(
        "foerstner",
        "Foerstner's corners",
        roundness=option(0.5, Interval(ge=0, le=1), meaning="least roundness of the error ellipse"),
        **SIGMA,
    ),
    "skimage-fast": _corner(
        "fast",
        "FAST corners",
        n=option(9, Interval(ge=1, le=16), keyword="n"),
        threshold=option(0.08, Ge(0), keyword="threshold"),
    ),
    "skimage-moravec": _corner("moravec", "Moravec's corners", window_size=option(1, Ge(1), keyword="window_size")),
    "skimage-kitchen-rosenfeld": _corner("kitchen_rosenfeld", "Kitchen and Rosenfeld's corners"),
    "skimage-log": _blob(
        "log",
        "Blobs: maxima of the Laplacian of Gaussian",
        **own(min_sigma=1.0, max_sigma=8.0, num_sigma=10, threshold=0.15, log_scale=False),
        **OVERLAP,
    ),
    "skimage-dog": _blob(
        "dog",
        "Blobs: maxima of the difference of Gaussians",
        **own(min_sigma=1.0, max_sigma=8.0, sigma_ratio=1.6, threshold=0.05),
        **OVERLAP,
    ),
}


@register_table
class SkimageDetector(Member, Detector):
    """One detector of scikit-image: a row of the table by name, and its parameters."""

    table = TABLE
    compiled = False
    describes = "describe"

    def detect_features(self, image: Image) -> Features:
        """Return the keypoints of `image`, best first, ties by position.

        Notes
        -----
        No support (a disc of radius `scale`) touches an invalid pixel, and no point lies outside the image.
        """
        values = self.parameters
        pixels = grey(image, values["normalise"])
        if min(image.shape) < MIN_SIDE or not image.mask.any() or pixels.min() == pixels.max():
            return Features.empty()
        try:
            found = TABLE[self.name].run(picture(image, values["normalise"]), values)
        except (RuntimeError, ValueError, IndexError):
            # Its way of saying that nothing was found, or that the image is smaller than a filter.
            return Features.empty()
        found = best_first(found.take(on_data(found, image)), values["n_features"])
        return found if values.get("describe", True) else replace(found, descriptors=None)
