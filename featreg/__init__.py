"""featreg: SAR image features, matching and registration, every method a plugin behind one interface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from featreg._version import __version__

if TYPE_CHECKING:
    from featreg.comparison import compare
    from featreg.errors import FeatregError
    from featreg.evaluation import evaluate
    from featreg.experiments.experiment import Experiment
    from featreg.exports.formats import export
    from featreg.extraction import extractor
    from featreg.feature_matcher import FeatureMatcher
    from featreg.focusing import FocusResult, focus
    from featreg.interfaces import (
        Descriptor,
        Detector,
        FailedFit,
        Filter,
        FilterContext,
        Matcher,
        Model,
        Nearest,
    )
    from featreg.io import as_image
    from featreg.io.phase_history import PhaseHistory, read_phase_history
    from featreg.matching import fit, match
    from featreg.pipeline import Pipeline
    from featreg.products.warping import Product, warp_file
    from featreg.registry import available, create, register, register_family
    from featreg.resample import warp
    from featreg.sar.backprojection import GroundGrid, back_project, carrier
    from featreg.sar.coherence import coherence
    from featreg.tie_points import read_tie_points
    from featreg.types import Features, Image, Matches, Registration
    from featreg.warming import warm_up

# Public name -> module that defines it; each is imported when first asked for, so that `import featreg` is quick.
_HOMES = {
    "as_image": "io",
    "available": "registry",
    "back_project": "sar.backprojection",
    "carrier": "sar.backprojection",
    "coherence": "sar.coherence",
    "compare": "comparison",
    "create": "registry",
    "Descriptor": "interfaces",
    "Detector": "interfaces",
    "evaluate": "evaluation",
    "Experiment": "experiments.experiment",
    "export": "exports.formats",
    "extractor": "extraction",
    "FailedFit": "interfaces",
    "FeatregError": "errors",
    "FeatureMatcher": "feature_matcher",
    "Features": "types",
    "Filter": "interfaces",
    "FilterContext": "interfaces",
    "fit": "matching",
    "focus": "focusing",
    "FocusResult": "focusing",
    "GroundGrid": "sar.backprojection",
    "Image": "types",
    "match": "matching",
    "Matcher": "interfaces",
    "Matches": "types",
    "Model": "interfaces",
    "Nearest": "interfaces",
    "PhaseHistory": "io.phase_history",
    "Pipeline": "pipeline",
    "Product": "products.warping",
    "read_phase_history": "io.phase_history",
    "read_tie_points": "tie_points",
    "register": "registry",
    "register_family": "registry",
    "Registration": "types",
    "warm_up": "warming",
    "warp": "resample",
    "warp_file": "products.warping",
}

__all__ = [
    "Descriptor",
    "Detector",
    "Experiment",
    "FailedFit",
    "FeatregError",
    "FeatureMatcher",
    "Features",
    "Filter",
    "FilterContext",
    "FocusResult",
    "GroundGrid",
    "Image",
    "Matcher",
    "Matches",
    "Model",
    "Nearest",
    "PhaseHistory",
    "Pipeline",
    "Product",
    "Registration",
    "__version__",
    "as_image",
    "available",
    "back_project",
    "carrier",
    "coherence",
    "compare",
    "create",
    "evaluate",
    "export",
    "extractor",
    "fit",
    "focus",
    "match",
    "read_phase_history",
    "read_tie_points",
    "register",
    "register_family",
    "warm_up",
    "warp",
    "warp_file",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'featreg' has no attribute '{name}'")
    from importlib import import_module

    value = getattr(import_module(f"featreg.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
