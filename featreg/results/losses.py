"""Where the tie points of a registration were lost, in words: what a reason says where nothing is left to judge."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from featreg.results.input_image import InputImage
from featreg.results.stages import MEASURED

#: What the tie points that a stage keeps have in common.
STAGES: Mapping[str, str] = {
    "identical": "moves, or lies where the images differ",
    "initial": "lies within the search radius of the initial model",
    "prior": "lies where the prior of its block says",
    "gms": "moves as its neighbours do",
    "fsc": "agrees with others on a model",
    "ransac": "agrees with others on a model",
    "mad": "fits a model of the others",
}

#: A stage that keeps less than this share of what it sees is named beside the one that left nothing.
FEW = 0.1


def chain(putative: int, kept: Mapping[str, int]) -> str:
    """Return how many tie points there were and how many each stage kept, up to the first that kept none.

    Parameters
    ----------
    putative : tie points of the matcher
    kept : stage -> tie points left after it, in the order in which the stages ran
    """
    said = [f"{putative} putative"]
    for name, count in kept.items():
        if name not in MEASURED:
            said.append(f"{count} after {name}")
            if not count:
                break
    return ", ".join(said)


def why_no_fit(
    putative: int, kept: Mapping[str, int], needed: int, reason: str, stages: Mapping[str, str] | None = None
) -> str:
    """Return why no model could be fitted: which stage left too few tie points, or `reason` where enough were left.

    Parameters
    ----------
    putative, kept : as in `chain`
    needed : tie points that the model needs
    reason : of the fit that failed
    stages : what the tie points that a stage keeps have in common, in place of `STAGES`
    """
    if not putative:
        return "there is no putative tie point"
    meanings = {**STAGES, **(stages or {})}
    left, last, before = putative, "", ""
    for name, count in kept.items():
        if 0 < count < FEW * left and name in meanings:
            before = f"; {name} kept {count} of {left} (each {meanings[name]})"
        if count < left:
            left, last = count, name
        if not left:
            break
    if not left:
        none = f" (none {meanings[last]})" if last in meanings else ""
        return f"no tie point is left after {last}{none}: {chain(putative, kept)}{before}"
    if left < needed:
        after = f" left after {last}" if last else " given"
        some = "one tie point is" if left == 1 else f"{left} tie points are"
        return f"only {some}{after}, the model needs {needed}: {chain(putative, kept)}{before}"
    return f"{reason} ({chain(putative, kept)})"


def image_words(role: str, image: InputImage) -> str:
    """Return the size of an image and the share of its pixels that are data, where that is known."""
    height, width = image.shape
    size = f"the {role} has {width} x {height} pixels"
    if image.valid_pixels is None:
        return size
    share = image.valid_pixels / (height * width)
    if share == 1:
        return f"{size}, all of them data"
    left = f"{percent(share)} of the {role}'s {width} x {height} pixels"
    return f"mask, nodata and samples that are no number leave {left}"


def percent(share: float) -> str:
    """Return a share in percent, without rounding what is left or lacking to nothing."""
    if 0 < share < 0.001:
        return "less than 0.1 %"
    if 0.999 < share < 1:
        return "all but less than 0.1 %"
    return f"{100 * share:.3g} %"


def block_words(statuses: Sequence[str], reasons: Sequence[str]) -> str:
    """Return how many blocks of a scene were not matched, and why: each kind of reason with its count."""
    said = []
    for status in ("skipped", "failed"):
        mine = [reason for other, reason in zip(statuses, reasons, strict=True) if other == status]
        if mine:
            # What stands after the colon differs from block to block.
            kinds = Counter(reason.split(":")[0] if status == "skipped" else reason for reason in mine)
            listed = ", ".join(f"{count} x {kind}" for kind, count in kinds.most_common(3))
            verb = "failed" if status == "failed" else "were skipped"
            said.append(f"{len(mine)} of {len(statuses)} blocks {verb} ({listed})")
    return "; ".join(said)


def heights_words(heights: Mapping[str, Any] | None) -> str:
    """Return what heights of the ground a scene's prior took, as the record of its result has them."""
    if not heights:
        return ""
    if heights.get("type") == "constant":
        return f"with the ground at {heights.get('metres', 0):g} m everywhere"
    return "with the heights of the elevation model"
