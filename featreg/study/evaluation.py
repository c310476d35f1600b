"""Scores of a registration against a known truth: pure functions of what a result holds.

The measures are those of the SAR-ORB paper (section 3.1): NM, the matches that its filter keeps, at the positions
measured last where they were located; NCM, those of them
within 1.5 px of the truth; precision = NCM / NM; RMSE over the correct ones (Eq. 8); and the time. Beside them stands
what the user of a registration wants to know: how far the fitted model lies from the truth over the whole image.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.geometry import spread
from featreg.interfaces import FailedFit
from featreg.registry import entries
from featreg.results.registration import Registration
from featreg.results.stages import MEASURED
from featreg.study.measures import grid_rmse, match_errors, score_errors
from featreg.study.truth import Truth, TruthLike, read_truth
from featreg.types import BoolArray


@dataclass(frozen=True)
class Scores:
    """How good one registration is.

    Parameters
    ----------
    stage : the stage whose tie points are scored
    threshold : px, greatest distance from the truth of a correct match
    nm : matches at that stage whose truth is known
    ncm : correct ones among them
    precision : ncm / nm; 0 where there are none, for a method that finds nothing is not precise
    rmse : px, over the correct matches; NaN where there are none
    grid_rmse : px, model against truth on a 9 x 9 grid over the reference; NaN without a model or without image size
    unscored : matches at that stage where the truth is not known
    inliers : final tie points
    spread : share of an 8 x 8 grid's cells that hold a final tie point; NaN without image size
    time_s : s, sum over the stages of the pipeline
    model_failed : no model could be fitted
    status : "ok" or "unreliable", as the registration says
    truth_residual_px : px, RMS of marked points about their own affine; None for other truths
    """

    stage: str
    threshold: float
    nm: int
    ncm: int
    precision: float
    rmse: float
    grid_rmse: float
    unscored: int
    inliers: int
    spread: float
    time_s: float
    model_failed: bool
    status: str
    truth_residual_px: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Name -> value, in the order above; NaN stays NaN."""
        return dataclasses.asdict(self)


def evaluate(
    registration: Registration,
    truth: TruthLike,
    threshold: float = 1.5,
    stage: str | None = None,
    image_shape: tuple[int, int] | None = None,
) -> Scores:
    """Score a registration against a truth.

    Parameters
    ----------
    registration : what `match` returned, or was read from its JSON
    truth : see `featreg.study.truth.read_truth`
    threshold : px, greatest distance of a correct match
    stage : a filter's name, "locate", "refine", "putative" or "inliers"; by default "locate" where the method locates,
        else the last before the first filter that looks at all tie points at once (FSC, RANSAC, MAD, ...), else all
        putative matches
    image_shape : (H, W) of the reference, where the result does not say it

    Returns
    -------
    Scores

    Raises
    ------
    InputError
        The result lacks the stage, the truth cannot be used, or a flow has another size than the reference.
    ParameterError
        The threshold is not positive.

    Notes
    -----
    Distances are taken in the secondary image, between the matched point and the truth of the reference point; the
    paper's Eq. 8 does not say in which of the two, and at scales near one it makes no difference.
    """
    known = read_truth(truth)
    name = default_stage(registration) if stage is None else stage
    rows = stage_mask(registration, name)
    shape = _shape(registration, known, image_shape)
    matches, model = registration.matches, registration.model
    errors = match_errors(matches.reference_xy[rows], matches.secondary_xy[rows], known)
    nm, ncm, precision, rmse = score_errors(errors, threshold)
    failed = isinstance(model, FailedFit)
    return Scores(
        stage=name,
        threshold=float(threshold),
        nm=nm,
        ncm=ncm,
        precision=precision,
        rmse=rmse,
        grid_rmse=np.nan if isinstance(model, FailedFit) or shape is None else grid_rmse(model, known, shape),
        unscored=len(errors) - nm,
        inliers=int(registration.inliers.sum()),
        spread=np.nan if shape is None else spread(matches.reference_xy[registration.inliers], shape),
        time_s=computing_time(registration.timings),
        model_failed=failed,
        status=registration.status,
        truth_residual_px=known.residual_px,
    )


def default_stage(registration: Registration) -> str:
    """Return the stage at which NM is counted.

    "locate" where the matches were measured again; else the last before the first global filter, else "putative".
    """
    if "locate" in registration.stages:
        return "locate"
    local = list(takewhile(lambda name: not _is_global(registration, name), registration.stages))
    return local[-1] if local else "putative"


def _is_global(registration: Registration, stage: str) -> bool:
    """Whether a stage looks at all tie points at once, as the result says, or the registry where it does not."""
    said = registration.provenance.get("global_filters")
    if stage in MEASURED:
        return True
    if said is not None:
        return stage in said
    return any(entry.name == stage and not getattr(entry.factory, "local", False) for entry in entries("filter"))


def stage_mask(registration: Registration, stage: str | None = None) -> BoolArray:
    """Return the (M,) bool mask of the tie points at a stage, by default that of `default_stage`.

    Raises
    ------
    InputError
        The result has no such stage; the text names those it has.
    """
    name = default_stage(registration) if stage is None else stage
    if name in registration.stages:
        return registration.stages[name]
    if name == "putative":
        return registration.putative
    if name == "inliers":
        return registration.inliers
    known = ", ".join(["putative", *registration.stages, "inliers"])
    raise InputError(f"the result has no stage '{name}'; it has {known}")


def computing_time(timings: Mapping[str, float]) -> float:
    """Return the seconds of all stages together."""
    return float(timings["total"] if "total" in timings else sum(timings.values()))


def _shape(registration: Registration, truth: Truth, image_shape: tuple[int, int] | None) -> tuple[int, int] | None:
    said = None if registration.reference is None else registration.reference.shape
    shape = image_shape or said or truth.shape
    if shape is None:
        return None
    if truth.shape is not None and tuple(shape) != truth.shape:
        raise InputError(f"the flow is {truth.shape} (H, W), the reference image {tuple(shape)}")
    return int(shape[0]), int(shape[1])
