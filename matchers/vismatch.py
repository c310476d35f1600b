"""A bridge to vismatch (formerly image-matching-models): any matcher of it by name, as a source of tie points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge

from featreg.errors import ParameterError, PluginUnavailableError, suggest
from featreg.interfaces import Matcher
from featreg.interop.opencv import MIN_SIDE, grey
from featreg.registry import register
from featreg.runtime.parameters import Count
from featreg.runtime.timing import stage
from featreg.types import BoolArray, FloatArray, Image, Matches

#: The names that the package has had, the present one first.
PACKAGES = ("vismatch", "imm", "matching")
CURE = "pip install vismatch, in an environment of its own: it needs a kornia older than 0.8.3 and torchvision"


def _package() -> str:
    """The first name under which a package with a `get_matcher` may be had, "" where none is installed."""
    for name in PACKAGES:
        try:
            # "matching" is a name that others use too, also for a module without parts.
            if find_spec(name) is not None and (name != "matching" or find_spec("matching.im_models") is not None):
                return name
        except (ImportError, ValueError):
            continue
    return ""


@register("vismatch", unavailable="" if _package() else f"vismatch is not installed; {CURE}")
@dataclass(frozen=True)
class Vismatch(Matcher):
    """Tie points of any matcher of vismatch by its name there; filters, model, blocks and trust are this package's.

    Parameters
    ----------
    network : the matcher's name in vismatch, such as "sift-lightglue", "roma", "minima-loftr"
    n_features : at most so many points, of the matchers that take such a limit
    device : where it runs, "cpu" or "cuda"
    threads : of the processor; 0 leaves it to torch
    half_pixel : where the matcher puts the centre of the first pixel, px: 0, or 0.5 for those that count from corners
    normalise : how amplitude becomes 8 bits; see `featreg.sar.normalise.to_uint8`

    Notes
    -----
    Its own RANSAC is not used: the tie points are those before it. The weights, and the terms under which they may be
    used, are each matcher's own; vismatch downloads them.
    """

    network: str = "sift-lightglue"
    n_features: Count = 2048
    device: str = "cpu"
    threads: Annotated[int, Ge(0)] = 1
    half_pixel: Annotated[float, Ge(0)] = 0.0
    normalise: str = "auto"

    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return the tie points on valid pixels, best first where the matcher tells a confidence.

        Raises
        ------
        PluginUnavailableError
            vismatch cannot be imported, or the matcher cannot be made, for want of its weights for example.
        ParameterError
            vismatch has no matcher of this name.
        """
        from featreg.interop.torch_arrays import inference

        made = _made(self.network, self.device, self.n_features)
        if min(*reference.shape, *secondary.shape) < MIN_SIDE:
            return _tie_points(np.zeros((0, 2)), np.zeros((0, 2)), None, reference, secondary)
        with stage("match"), inference(self.threads):
            pictures = [_colour(grey(image, self.normalise)) for image in (reference, secondary)]
            found = made(*pictures)
        ends = [np.asarray(found[f"matched_kpts{k}"], np.float64).reshape(-1, 2) - self.half_pixel for k in (0, 1)]
        return _tie_points(ends[0], ends[1], found.get("matched_confidences"), reference, secondary)


def _colour(picture: Any) -> Any:
    """(3, H, W) float32 tensor, 0 to 1."""
    from featreg.runtime.optional import import_torch

    return import_torch().from_numpy(np.repeat(picture[None].astype(np.float32) / 255, 3, axis=0))


@lru_cache(maxsize=2)
def _made(network: str, device: str, count: int) -> Any:
    name = _package()
    if not name:
        raise PluginUnavailableError(f"vismatch is not installed; {CURE}")
    try:
        package = import_module(name)
    except (ImportError, OSError) as error:
        raise PluginUnavailableError(f"{name} cannot be imported ({error}); {CURE}") from error
    known = list(getattr(package, "available_models", ()))
    if known and network not in known:
        raise ParameterError(f"vismatch has no matcher '{network}', {suggest(network, known)}")
    try:
        return package.get_matcher(network, device=device, max_num_keypoints=count)
    except Exception as error:  # whatever a matcher of others raises while it is made
        text = " ".join(str(error).split())[:200]
        raise PluginUnavailableError(f"vismatch cannot make its matcher '{network}': {text}") from error


def _tie_points(here: FloatArray, there: FloatArray, confidence: Any, reference: Image, secondary: Image) -> Matches:
    score = np.ones(len(here)) if confidence is None else np.asarray(confidence, np.float64).reshape(-1)
    keep = np.flatnonzero(_on_data(here, reference) & _on_data(there, secondary) & np.isfinite(score))
    keep = keep[np.argsort(-score[keep], kind="stable")]
    return Matches(here[keep], there[keep], score[keep])


def _on_data(xy: FloatArray, image: Image) -> BoolArray:
    """(M,) bool: the point lies on a valid pixel."""
    size = np.array(image.shape[::-1])
    at = np.rint(xy).astype(np.int64)
    inside = ((at >= 0) & (at < size)).all(axis=1)
    at = np.clip(at, 0, size - 1)
    return np.asarray(inside & image.mask[at[:, 1], at[:, 0]])
