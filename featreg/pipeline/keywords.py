"""What `featreg.match` takes, declared once: what each keyword decides, and how the command line spells it.

The command line's options, the checks of an experiment, the digests under which results and keypoints are kept and the
suggestions in errors follow from here. Keywords that are not named here are parameters of
the method's parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

#: "method": the pipeline; "part": one part of it; "seed"; "image": how an image is read; "search": where tie points are
#: looked for; "blocks": of scenes only; "run": how the work is run, which never changes a result.
Decides = Literal["method", "part", "seed", "image", "search", "blocks", "run"]


@dataclass(frozen=True)
class Keyword:
    """One keyword of `featreg.match`.

    Parameters
    ----------
    name : of the keyword
    decides : what it decides
    option : of the command line; "" where it has none of its own, so that ``--set`` takes it
    """

    name: str
    decides: Decides
    option: str = ""


KEYWORDS = (
    Keyword("method", "method", "--method"),
    Keyword("model", "method", "--model"),
    Keyword("locate", "method", "--locate or --no-locate"),
    Keyword("refine", "method", "--refine or --no-refine"),
    Keyword("n_features", "method", "--n-features"),
    Keyword("detector", "part"),
    Keyword("descriptor", "part"),
    Keyword("nearest", "part"),
    Keyword("matcher", "part"),
    Keyword("filters", "part"),
    Keyword("common_rotation", "part"),
    Keyword("pixels_per_feature", "part"),
    Keyword("robust", "part"),
    Keyword("seed", "seed", "--seed"),
    Keyword("initial", "search", "--initial"),
    Keyword("prior", "search", "--prior"),
    Keyword("search_radius", "search", "--search-radius"),
    Keyword("reference_mask", "image", "--mask-reference"),
    Keyword("secondary_mask", "image", "--mask-secondary"),
    Keyword("nodata", "image", "--nodata"),
    Keyword("scale", "image", "--scale"),
    Keyword("calibrate", "image", "--calibrate"),
    Keyword("band", "image", "--band"),
    Keyword("reference_band", "image", "--reference-band"),
    Keyword("secondary_band", "image", "--secondary-band"),
    Keyword("focus", "image", "--focus"),
    Keyword("block", "blocks", "--block or --whole"),
    Keyword("dem", "blocks", "--dem"),
    Keyword("height", "blocks", "--height"),
    Keyword("split", "blocks", "--split"),
    Keyword("executor", "run"),
    Keyword("workers", "run", "--workers"),
    Keyword("scheduler", "run", "--scheduler"),
    Keyword("threads", "run"),
    Keyword("resume", "run", "--resume"),
    Keyword("progress", "run"),
    Keyword("cancel", "run"),
)
BY_NAME: Mapping[str, Keyword] = {keyword.name: keyword for keyword in KEYWORDS}


def names(*decides: Decides) -> list[str]:
    """The keywords that decide one of these."""
    return [keyword.name for keyword in KEYWORDS if keyword.decides in decides]


def of_pipeline(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Those keywords that build the pipeline: the method's, its parts' and their parameters."""
    return dict(_kept(keywords, "method", "part"))


def deciding(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Those keywords that can change a result."""
    return dict(_kept(keywords, "method", "part", "seed", "image", "search", "blocks"))


def of_keypoints(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Those keywords on which the keypoints of one image depend, those of its role apart: the pipeline's, how it is
    read, and as `block` whether it is in blocks, which others than that ask for as well, and how they are divided.
    """
    roles = ("reference_mask", "secondary_mask", "reference_band", "secondary_band")
    found = {name: value for name, value in _kept(keywords, "method", "part", "image") if name not in roles}
    asked = any(keywords.get(name) is not None for name in ("dem", "height", "split"))
    block, split = keywords.get("block"), keywords.get("split")
    if split == "proportional":
        found["split"] = split
    if block is None and (asked or keywords.get("model") == "rpc-bias"):
        block = True
    return found if block is None else {**found, "block": block}


def bands_of(keywords: Mapping[str, Any]) -> tuple[Any, Any]:
    """Which band of the reference and of the secondary is read, by `band` and by those of their roles."""
    common = keywords.get("band")
    first, second = (keywords.get(f"{role}_band") for role in ("reference", "secondary"))
    return common if first is None else first, common if second is None else second


def _kept(keywords: Mapping[str, Any], *decides: Decides) -> Iterator[tuple[str, Any]]:
    for name, value in keywords.items():
        if name not in BY_NAME or BY_NAME[name].decides in decides:
            yield name, value
