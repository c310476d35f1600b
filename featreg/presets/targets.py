"""Methods whose tie points lie at extended targets or on a grid: OBCLS and what it is compared with."""

from __future__ import annotations

from collections.abc import Mapping

from featreg.presets.preset import Part, Preset

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


TARGETS: Mapping[str, Preset] = {
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
}
