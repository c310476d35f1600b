"""Methods of other libraries: OpenCV, scikit-image, kornia, vismatch."""

from __future__ import annotations

from collections.abc import Mapping

from featreg.presets.preset import Part, Preset


def _opencv(name: str, *, ratio: float = 1.0) -> Preset:
    """A detector of OpenCV that describes its own points; a ratio below 1 stands for GMS, as is usual for L2 norms."""
    return Preset(
        f"OpenCV's {name.upper()}, detector and descriptor",
        detector=Part(name),
        nearest=Part("brute-force", {"mutual": False, "ratio": ratio}),
        filters=(Part("fsc"),) if ratio < 1 else (Part("gms"), Part("fsc")),
        locate=False,
    )


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


LIBRARIES: Mapping[str, Preset] = {
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
