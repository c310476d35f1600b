"""The named methods: frozen data from which a pipeline is built, every part replaceable by a keyword."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Part:
    """One part of a method: the name of a plugin and the parameters that differ from its defaults."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Preset:
    """A method: either a detector, a descriptor (None where the detector describes) and a nearest, or a matcher.

    Or a choice of methods: `methods` names those that are tried in order until one is trusted, and the other fields say
    nothing. Those of them that are `for_unlike` images come first where the two differ much in their speckle, as an
    optical and a SAR image do.

    `filters` run in order; `locate` and `refine` say whether matches are measured again, and whether refinement is on,
    unless asked otherwise; `common_rotation` is that of `FeatureMatcher`, and so is `pixels_per_feature`, for whole
    images whose matches are measured again; `model` is fitted unless another is asked for (None: the package's
    default); `robust` is that of `Pipeline`; `trust` and `refinement` hold what differs from the defaults of
    `featreg.pipeline.trust.Limits` and `featreg.pipeline.refine.Refine`.
    """

    summary: str
    detector: Part | None = None
    descriptor: Part | None = None
    nearest: Part | None = None
    matcher: Part | None = None
    filters: tuple[Part, ...] = (Part("gms"), Part("fsc"))
    locate: bool = True
    refine: bool = True
    common_rotation: bool = True
    pixels_per_feature: float = 0.0
    model: str | None = None
    robust: bool = True
    trust: Mapping[str, Any] = field(default_factory=dict)
    refinement: Mapping[str, Any] = field(default_factory=dict)
    methods: tuple[str, ...] = ()
    for_unlike: bool = False

    @property
    def parts(self) -> tuple[tuple[str, Part], ...]:
        """(role, part) of those that make the tie points."""
        roles = ("detector", "descriptor", "nearest", "matcher")
        return tuple((role, part) for role in roles if (part := getattr(self, role)) is not None)


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
_PAPER_GABOR = {"orientations": 6, "harmonics": 4, "magnification": 6.0, "spread": 100.0}
_PAPER_BRIEF = {"bits": 256, "radius": 16.0, "spread": 6.2, "sigma": 2.0}

_MULTI_SCALE = {"scales": 4, "sigma": 1.4}
_PAPER_BILATERAL = {"octaves": 3, "sigma": 1.6, "exact": True}

_PAPER_CONGRUENCY = {
    "scales": 4,
    "orientations": 6,
    "min_wavelength": 3.0,
    "multiplier": 1.6,
    "bandwidth": 0.75,
    "noise": 1.0,
    "floor": 1e-4,
    "view": "amplitude",
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


def _opencv(name: str, *, ratio: float = 1.0) -> Preset:
    """A detector of OpenCV that describes its own points; a ratio below 1 stands for GMS, as is usual for L2 norms."""
    return Preset(
        f"OpenCV's {name.upper()}, detector and descriptor",
        detector=Part(name),
        nearest=Part("brute-force", {"mutual": False, "ratio": ratio}),
        filters=(Part("fsc"),) if ratio < 1 else (Part("gms"), Part("fsc")),
        locate=False,
    )


# Peaks are sought within a patch, so that chance agrees more easily than over the whole image, to which the gate holds
# it; true pairs of real apertures reach -25 to -240 and 0.07 to 0.25 px, wrong ones -21 and 0.8 px at best.
# A defocused secondary is distorted by 0.7 to 2.5 px, true pairs of real apertures by 0.3 px at most (0.6 px where they
# are half as long); with a dilution above 1 the tie points huddle in a quarter of the scene.
_TARGETS_TRUST = {
    "least_inliers": 8, "significance": -20.0, "uncertainty_px": 0.3, "distortion_px": 0.6, "dilution": 1.0
}  # fmt: skip
# Hundreds of refined tie points, none of them far from the model: less is wrong already.
_REFINED_TRUST = {"distortion_px": 0.3, "dilution": 0.9}
# Centroids are associated over the whole image, so that chance has all of it.
_SIGNIFICANCE = {"c": -12.0, "cc": -20.0}
# The published threshold leaves few tie points, and a single pass pulls the rotation towards 0: results whose own error
# is above this were wrong by 0.25 to 1.2 degrees.
_PAPER_TRUST = {"least_inliers": 8, "uncertainty_px": 0.4, "dilution": 1.0}
# The first fit is to a consensus, so that half of the tie points may be wrong.
_FROM_CONSENSUS = Part("mad", {"start": "consensus"})
# Between the targets there is speckle, of which neighbouring apertures share nothing: few windows correlate.
_FEW_WINDOWS = {"least_share": 0.05}


def _targets(tie_points: str, summary: str, *, refine: bool) -> Preset:
    """OBCLS at its best: association by vote, passes on the aligned image, cancellation from a consensus."""
    return Preset(
        summary,
        matcher=Part("target-centroids", {"tie_points": tie_points}),
        filters=(_FROM_CONSENSUS,),
        locate=False,
        refine=refine,
        model="rigid",
        trust={**_TARGETS_TRUST, **_REFINED_TRUST, "significance": _SIGNIFICANCE[tie_points]}
        if refine
        else _TARGETS_TRUST,
        refinement=_FEW_WINDOWS,
    )


def _paper_obcls(matcher: Part, summary: str, *, cancellation: bool = True) -> Preset:
    """Tie points, outlier cancellation and constrained least squares as published by Pallotta et al."""
    return Preset(
        summary,
        matcher=matcher,
        filters=(Part("mad", {"threshold": "mad", "cancellation": cancellation}),),
        locate=False,
        refine=False,
        model="rigid",
        robust=False,
        trust=_PAPER_TRUST,
    )


_PAPER_TARGETS = {"association": "nearest", "passes": 1, "patch": 64, "subpixel": False, "zeros_are_data": True}
_PAPER_GRID = {"tie_points": "cc", "patch": 64, "step": 32, "subpixel": False, "zeros_are_data": True}


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


def _kornia(summary: str, detector: Part, descriptor: Part | None, nearest: Part) -> Preset:
    """Parts of kornia; its ways of matching have tests of their own, which stand for GMS."""
    return Preset(
        f"{summary}, by kornia",
        detector=detector,
        descriptor=descriptor,
        nearest=nearest,
        filters=(Part("fsc"),),
        locate=False,
    )


_SMNN = Part("kornia-smnn")


#: What `featreg.match` takes where nothing is said.
DEFAULT_METHOD = "sar-orb"

#: Every method by name; `featreg.register_preset` adds to it.
PRESETS: dict[str, Preset] = {
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
        "SAR-Harris and ratio descriptors as in Dellinger et al. 2015, ratio test, RANSAC",
        detector=Part(
            "sar-harris",
            {"alpha": 2.0, "integration": 2**0.5, "quota_decay": 1.0, "thin": False, "coarse": False, "second": 0.8},
        ),
        descriptor=Part("ratio-gloh", {"soft": False, "harmonics": 4}),
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
        "SIFT keypoints, all of them, odd-Gabor ratio descriptors of one scale, after Paul and Pati 2019, RANSAC",
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
        "SIFT keypoints, all of them, odd-Gabor ratio descriptors of four scales, after Paul and Pati 2019, RANSAC",
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
        detector=Part(
            "bf-sift", {**_PAPER_BILATERAL, "quota_decay": 1.0, "orientation_scale": 1.0, "thin": False, "skip": 1}
        ),
        descriptor=Part("bf-sift", {**_PAPER_BILATERAL, "coarser": 1.0, "harmonics": 4}),
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
        "RIFT as in Li, Hu and Ai 2020, made rotation invariant as in RIFT2",
        detector=Part("phase-congruency", {**_PAPER_CONGRUENCY, "subpixel": "none"}),
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
    "c-obcls": _targets("c", "Centroids of extended targets associated by vote, cancellation", refine=True),
    "cc-obcls": _targets(
        "cc", "Complex correlation of patches at extended targets associated by vote, cancellation", refine=True
    ),
    "rc-obcls": _targets(
        "rc", "Amplitude correlation of patches at extended targets associated by vote, cancellation", refine=False
    ),
    "cls": Preset(
        "Amplitude correlation of patches on a uniform grid, outlier cancellation",
        matcher=Part("patch-grid"),
        filters=(_FROM_CONSENSUS,),
        locate=False,
        model="rigid",
        trust=_REFINED_TRUST,
        refinement=_FEW_WINDOWS,
    ),
    "c-obcls-paper": _paper_obcls(
        Part("target-centroids", {**_PAPER_TARGETS, "tie_points": "c"}), "C-OBCLS as in Pallotta et al."
    ),
    "cc-obcls-paper": _paper_obcls(
        Part("target-centroids", {**_PAPER_TARGETS, "tie_points": "cc"}), "CC-OBCLS as in Pallotta et al."
    ),
    "rc-obcls-paper": _paper_obcls(
        Part("target-centroids", {**_PAPER_TARGETS, "tie_points": "rc"}), "RC-OBCLS as in Pallotta et al."
    ),
    "cls-paper": _paper_obcls(
        Part("patch-grid", _PAPER_GRID),
        "Complex correlation on a uniform patch grid, after Pallotta et al. 2021",
        cancellation=False,
    ),
    "orb": _opencv("orb"),
    "akaze": _opencv("akaze"),
    "brisk": _opencv("brisk"),
    "sift": _opencv("sift", ratio=0.85),
    "kaze": _opencv("kaze", ratio=0.85),
    "skimage-orb": Preset(
        "scikit-image's ORB, detector and descriptor, mutual, GMS, FSC",
        detector=Part("skimage-orb"),
        nearest=Part("brute-force"),
    ),
    "skimage-sift": Preset(
        "scikit-image's SIFT, detector and descriptor, ratio test, FSC",
        detector=Part("skimage-sift"),
        nearest=Part("brute-force", {"mutual": False, "ratio": 0.85}),
        filters=(Part("fsc"),),
    ),
    "skimage-censure-brief": Preset(
        "scikit-image's CenSurE and upright BRIEF, mutual, GMS, FSC",
        detector=Part("skimage-censure", {"non_max_threshold": 0.02}),
        descriptor=Part("skimage-brief"),
        nearest=Part("brute-force"),
    ),
    "skimage-daisy": Preset(
        "scikit-image's Foerstner corners and upright DAISY, mutual, GMS, FSC",
        detector=Part("skimage-foerstner"),
        descriptor=Part("skimage-daisy"),
        nearest=Part("brute-force"),
    ),
    "kornia-dog-sift": _kornia(
        "Differences of Gaussians, RootSIFT in one common direction, ratio test both ways",
        Part("kornia-dog"),
        Part("kornia-sift"),
        _SMNN,
    ),
    "kornia-hessian-mkd": _kornia(
        "Hessian blobs, kernel descriptors in one common direction, AdaLAM",
        Part("kornia-hessian"),
        Part("kornia-mkd"),
        Part("kornia-adalam"),
    ),
    "kornia-gftt-sift": _kornia(
        "Shi-Tomasi corners, RootSIFT in one common direction, AdaLAM",
        Part("kornia-gftt"),
        Part("kornia-sift"),
        Part("kornia-adalam"),
    ),
    "kornia-dog-hardnet": _kornia(
        "Differences of Gaussians, HardNet, ratio test both ways",
        Part("kornia-dog"),
        Part("kornia-hardnet", {"magnification": 2.0}),
        _SMNN,
    ),
    "kornia-keynet-hardnet": _kornia(
        "Key.Net, HardNet, ratio test both ways", Part("kornia-keynet"), Part("kornia-hardnet"), _SMNN
    ),
    "kornia-disk-lightglue": _kornia(
        "DISK, LightGlue", Part("kornia-disk"), None, Part("kornia-lightglue", {"features": "disk"})
    ),
    "kornia-aliked-lightglue": _kornia(
        "ALIKED, LightGlue", Part("kornia-aliked"), None, Part("kornia-lightglue", {"features": "aliked"})
    ),
    "kornia-xfeat": _kornia("XFeat, mutual nearest neighbours", Part("kornia-xfeat"), None, Part("brute-force")),
    "xfeat-lighterglue": _kornia(
        "XFeat, LighterGlue", Part("kornia-xfeat"), None, Part("kornia-lightglue", {"features": "xfeat"})
    ),
    "kornia-dedode": _kornia("DeDoDe, ratio test both ways", Part("kornia-dedode"), None, _SMNN),
    "vismatch": Preset(
        "Any matcher of vismatch by its name (matcher.network), FSC",
        matcher=Part("vismatch"),
        filters=(Part("fsc"),),
        locate=False,
    ),
    "kornia-loftr": Preset("LoFTR, by kornia", matcher=Part("kornia-loftr"), filters=(Part("fsc"),), locate=False),
}
