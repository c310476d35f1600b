"""Methods for radar images, and for an optical and a radar image, each beside the form in which it was published."""

from __future__ import annotations

import math
from collections.abc import Mapping

from featreg.presets.preset import Part, Preset

# Fewer and coarser than the paper's eight of 1.2: as many correct matches or more at scales from 0.6 to 1.6, measured,
# and less to compute.
_THREE_LEVELS = {"levels": 3, "factor": 1.3}
# Found in images reduced to so many pixels for each, features are as often right as with 60 on Sentinel-1 dates, and
# more results are trusted of change pairs with few.
_PIXELS = 75.0
_PAPER_OFAST = {
    "alpha": 2.0,
    "floor": 0.01,
    "quota_decay": 1.2,
    "support": 16.0,
    "edge": "eq5",
    "subpixel": "corner",
    "sigma": 2.0,
    "centroid": "edges",
    "clip": False,
    # The paper gives none; on edges that are not clipped half of the default finds as many corners.
    "threshold": 5,
}
# SIFT's descriptor covers 6 sigma, and OpenCV's keypoints carry sigma.
_PAPER_GABOR = {
    "orientations": 6,
    "harmonics": 4,
    "magnification": 6.0,
    "spread": 100.0,
    "step": 0.0625,
    "exact": True,
}
_PAPER_BRIEF = {"bits": 256, "radius": 16.0, "spread": 6.2, "sigma": 2.0}

_MULTI_SCALE = {"scales": 4, "sigma": 1.4}
_PAPER_BILATERAL = {"octaves": 3, "sigma": 1.6, "exact": True}
_PAPER_EXTREMA = {"quota_decay": 1.0, "orientation_scale": 1.0, "thin": False, "skip": 1, "second": 0.8}
_PAPER_HARRIS = {
    "alpha": 2.0,
    "integration": 2**0.5,
    "quota_decay": 1.0,
    "thin": False,
    "coarse": False,
    "second": 0.8,
    "subscale": False,
    "exact": True,
}

_PAPER_CONGRUENCY = {
    "scales": 4,
    "orientations": 6,
    "min_wavelength": 3.0,
    "multiplier": 1.6,
    "bandwidth": 0.75,
    "noise": 1.0,
    "floor": 1e-4,
    "view": "amplitude",
    "exact": True,
}
_PAPER_INDEX_MAP = {
    **_PAPER_CONGRUENCY,
    "patch": 96.0,
    "grid": 6,
    "soft": False,
    "weighted": False,
    "power": 1.0,
    "centred": False,
    "reindex": "dominant",
}

# The best of many alignments, and outlines that both images share, make chance look like less than it is: of 120 pairs
# of an optical and a SAR image of different places none passed 51 tie points or -84 (of 240, before the descriptor's
# last change, 53 and -93); of 40 true pairs 39 reach 212, -442 and 2.2 px. `drift` compares
# intensities, see _DENSE_TRUST: it refused two right pairs of these with windows that moved together by 8 and 11 px.
# `structure` compares what both show: of 38 pairs and 170 crops of them that the other gates trust, 202 within 5 px of
# the label had at most 4.9 px but for one with 5.6; of five that were 6 to 128 px off, four had 5.8 to 8.
_SEARCHED_TRUST = {
    "least_inliers": 60,
    "significance": -140.0,
    "uncertainty_px": 3.5,
    "held_out_px": 3.0,
    "drift_px": math.inf,
    "structure_px": 5.25,
}

# Of 38 optical-SAR pairs three were trusted that were 6 to 8 px off, with 38 to 51 tie points and 1e-35 to 1e-56 by
# chance; what optical-sar must reach refuses them.
_LNIFT_TRUST = {"least_inliers": 60, "significance": -140.0}

# Windows overlap by half. Between an optical and a SAR image they differ by 2 to 3 px where the model is right: of 38
# such pairs all have a `held_out` of at most 2.3 px, of 121 crops of them 2.8. Their intensities peak elsewhere than
# the images agree, so that windows of them drift by up to 15 px from right models. What keeps other places out is the
# matcher's own verification: of 544 pairs of other places none reaches its limit.
_DENSE_TRUST = {"least_inliers": 20, "held_out_px": 3.0, "held_out_rmse_px": 3.0, "drift_px": math.inf}

# As of sar-dense: templates overlap, and the intensities of an optical and a SAR image do not compare. What keeps other
# places out is the matcher's own test against chance.
_RAWG_TRUST = {"held_out_px": 3.0, "drift_px": math.inf}

SAR: Mapping[str, Preset] = {
    "auto": Preset(
        "sar-orb, and sar-dense where that is not trusted; the other way round where the images differ in speckle",
        methods=("sar-orb", "sar-dense"),
    ),
    "sar-orb": Preset(
        "SAR-OFAST corners on a ROEWA edge pyramid, BRIEF in one common direction, GMS, FSC",
        detector=Part("sar-ofast", {**_THREE_LEVELS, "skip": 2}),
        descriptor=Part("brief", {**_THREE_LEVELS, "levels": 5}),
        nearest=Part("brute-force"),
    ),
    "sar-orb-paper": Preset(
        "SAR-OFAST, oriented BRIEF, GMS and FSC as in Wang et al. 2022",
        detector=Part("sar-ofast", _PAPER_OFAST),
        descriptor=Part("brief", _PAPER_BRIEF),
        nearest=Part("brute-force", {"mutual": False}),
        locate=False,
        refine=False,
        common_rotation=False,
    ),
    "sar-sift": Preset(
        "SAR-Harris corners of ratio gradients, ratio DAISY descriptors in one common direction, GMS, FSC",
        detector=Part("sar-harris"),
        descriptor=Part("ratio-daisy"),
        nearest=Part("brute-force"),
        pixels_per_feature=_PIXELS,
    ),
    "sar-sift-paper": Preset(
        "SAR-Harris and ratio descriptors after Dellinger et al. 2015, ratio test, RANSAC",
        detector=Part("sar-harris", _PAPER_HARRIS),
        # Samples half an alpha apart: a pixel where alpha is least.
        descriptor=Part("ratio-gloh", {"soft": False, "harmonics": 4, "step": 1 / 24, "exact": True}),
        nearest=Part("brute-force", {"mutual": False, "ratio": 0.8}),
        filters=(Part("ransac"),),
        locate=False,
        refine=False,
        common_rotation=False,
    ),
    "s-gof": Preset(
        "SAR-Harris corners, odd-Gabor ratio DAISY descriptors of one scale in one common direction, GMS, FSC",
        detector=Part("sar-harris"),
        descriptor=Part("gabor-daisy"),
        nearest=Part("brute-force"),
        pixels_per_feature=_PIXELS,
    ),
    "s-gof-paper": Preset(
        "All SIFT keypoints, odd-Gabor ratios of one scale, after Paul and Pati 2019, ratio of 0.85 (ours), RANSAC",
        detector=Part("sift"),
        descriptor=Part("gabor-odd", _PAPER_GABOR),
        nearest=Part("brute-force", {"mutual": False, "ratio": 0.85}),
        filters=(Part("ransac"),),
        locate=False,
        refine=False,
        common_rotation=False,
    ),
    "m-gof": Preset(
        "SAR-Harris corners, odd-Gabor ratio DAISY descriptors of four scales in one common direction, GMS, FSC",
        detector=Part("sar-harris"),
        descriptor=Part("gabor-daisy", _MULTI_SCALE),
        nearest=Part("brute-force"),
        pixels_per_feature=_PIXELS,
    ),
    "m-gof-paper": Preset(
        "All SIFT keypoints, odd-Gabor ratios of four scales, after Paul and Pati 2019, ratio of 0.85 (ours), RANSAC",
        detector=Part("sift"),
        descriptor=Part("gabor-odd", {**_MULTI_SCALE, **_PAPER_GABOR}),
        nearest=Part("brute-force", {"mutual": False, "ratio": 0.85}),
        filters=(Part("ransac"),),
        locate=False,
        refine=False,
        common_rotation=False,
    ),
    "bfsift": Preset(
        "Extrema of a fast bilateral scale space, its gradients' GLOH descriptors in one common direction, GMS, FSC",
        detector=Part("bf-sift"),
        descriptor=Part("bf-sift"),
        nearest=Part("brute-force"),
        pixels_per_feature=_PIXELS,
    ),
    "bfsift-paper": Preset(
        "SIFT in an exact bilateral scale space without the finest scale, after Wang et al. 2012, mutual, RANSAC",
        detector=Part("bf-sift", {**_PAPER_BILATERAL, **_PAPER_EXTREMA}),
        descriptor=Part("bf-sift", {**_PAPER_BILATERAL, "coarser": 1.0, "harmonics": 4, "step": 0.0625}),
        nearest=Part("brute-force"),
        filters=(Part("ransac"),),
        locate=False,
        refine=False,
        common_rotation=False,
    ),
    "rift": Preset(
        "Corner and edge points of phase congruency, maximum index map in one common direction, GMS, FSC",
        detector=Part("phase-congruency"),
        # A quarter less to compare than with five, and as many correct matches.
        descriptor=Part("max-index-map", {"levels": 4}),
        nearest=Part("brute-force"),
        pixels_per_feature=_PIXELS,
    ),
    "optical-sar": Preset(
        "RIFT's features at several ratios of the scales, for an optical and a SAR image at any rotation, FSC",
        matcher=Part("scale-search"),
        filters=(Part("fsc", {"threshold": 4.0}),),
        locate=False,
        refine=False,
        model="similarity",
        trust=_SEARCHED_TRUST,
    ),
    "sar-dense": Preset(
        "Orientation of ratio gradients correlated over any rotation, scale and shift, verified by windows, FSC",
        matcher=Part("orientation-correlation"),
        filters=(Part("fsc", {"threshold": 4.0}),),
        refine=False,
        trust=_DENSE_TRUST,
        for_unlike=True,
    ),
    "rift-paper": Preset(
        "RIFT after Li, Hu and Ai 2020, made rotation invariant as in RIFT2",
        # The least contrast is that of the authors' program, 0.05 of the greatest moment.
        detector=Part("phase-congruency", {**_PAPER_CONGRUENCY, "subpixel": "none", "threshold": 13}),
        descriptor=Part("max-index-map", _PAPER_INDEX_MAP),
        nearest=Part("brute-force", {"mutual": False}),
        filters=(Part("fsc"),),
        locate=False,
        refine=False,
        common_rotation=False,
    ),
    "lnift": Preset(
        "FAST corners and gradient histograms of locally normalised images, after Li et al. 2022, FSC",
        detector=Part("normalised-fast"),
        descriptor=Part("normalised-hog"),
        nearest=Part("brute-force"),
        filters=(Part("fsc"),),
        locate=False,
        refine=False,
        common_rotation=False,
        trust=_LNIFT_TRUST,
    ),
    "rawg": Preset(
        "Templates of angle-weighted ratio gradients near a model known beforehand, after RAWG 2025, FSC",
        matcher=Part("angle-weighted-templates"),
        filters=(Part("fsc", {"threshold": 4.0}),),
        locate=False,
        refine=False,
        trust=_RAWG_TRUST,
    ),
}
