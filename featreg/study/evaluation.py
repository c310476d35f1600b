"""Scores of a registration against a known truth: pure functions of what a result holds.

The measures are those of the SAR-ORB paper (section 3.1): NM, the matches that its filter keeps, at the positions
measured last where they were located; NCM, those of them
within 1.5 px of the truth; precision = NCM / NM; RMSE over the correct ones (Eq. 8); and the time. Beside them stands
what the user of a registration wants to know: how far the fitted model lies from the truth over the whole image.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError, ParameterError
from featreg.geometry import spread
from featreg.interfaces import FailedFit
from featreg.registry import entries
from featreg.results.registration import Registration
from featreg.results.stages import MEASURED
from featreg.study.truth import Truth, TruthLike, read_truth
from featreg.types import BoolArray, FloatArray, points

#: Thresholds of the mean matching accuracy curve, px.
CURVE = tuple(range(1, 11))


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


def match_errors(reference_xy: ArrayLike, secondary_xy: ArrayLike, truth: TruthLike) -> FloatArray:
    """Return the (M,) distances in pixels of matched points from the truth; NaN where the truth is not known."""
    known = read_truth(truth)
    return np.asarray(np.hypot(*(known(reference_xy) - points(secondary_xy, "secondary_xy")).T))


def score_errors(errors: ArrayLike, threshold: float = 1.5) -> tuple[int, int, float, float]:
    """Return (NM, NCM, precision, RMSE) of (M,) distances in pixels; NaN distances are not scored.

    A distance equal to the threshold is correct. The RMSE (Eq. 8) is over the correct ones, NaN where there are none.

    Raises
    ------
    ParameterError
        The threshold is not positive.
    """
    if not threshold > 0:
        raise ParameterError(f"threshold must be a positive number of pixels, got {threshold}")
    known = _known(errors)
    correct = known[known <= threshold]
    rmse = float(np.sqrt(np.mean(correct**2))) if len(correct) else np.nan
    return len(known), len(correct), len(correct) / len(known) if len(known) else 0.0, rmse


def grid_points(shape: tuple[int, int], count: int = 9, margin: float = 0.05) -> FloatArray:
    """Return the (count^2, 2) points of a grid from `margin` to 1 - `margin` of an image of shape (H, W)."""
    share = np.linspace(margin, 1 - margin, count)
    x, y = np.meshgrid(share * (shape[1] - 1), share * (shape[0] - 1))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def grid_rmse(
    model: Callable[[FloatArray], FloatArray], truth: TruthLike, shape: tuple[int, int], count: int = 9
) -> float:
    """Return the RMS distance in pixels of a model from the truth over `grid_points(shape, count)`.

    Grid points whose truth is not known do not count; NaN where none is known or the model gives none.
    """
    grid = grid_points(shape, count)
    wanted = read_truth(truth)(grid)
    known = np.isfinite(wanted).all(axis=1)
    if not known.any():
        return float("nan")
    return float(np.sqrt(np.mean(np.sum((np.asarray(model(grid[known])) - wanted[known]) ** 2, axis=1))))


def repeatable(
    reference_xy: ArrayLike,
    secondary_xy: ArrayLike,
    truth: TruthLike,
    shapes: tuple[tuple[int, int], tuple[int, int]],
    threshold: float = 1.5,
) -> tuple[int, int, int]:
    """Count the keypoints that both images show.

    Parameters
    ----------
    reference_xy, secondary_xy : (N, 2) and (M, 2) keypoints, in pixels
    truth : see `featreg.study.truth.read_truth`
    shapes : (H, W) of the reference and of the secondary
    threshold : px, greatest distance of a keypoint of the secondary from the truth of one of the reference

    Returns
    -------
    tuple
        (one-to-one correspondences, reference keypoints that the secondary shows, secondary keypoints in the area that
        the reference shows).

    Notes
    -----
    As Mikolajczyk and Schmid count it, but for one thing: points are compared by their distance, not by the overlap of
    their regions. A correspondence is a pair of mutually nearest points, so that a cluster counts once.
    """
    from scipy.spatial import cKDTree

    known = read_truth(truth)
    mapped = known(reference_xy)
    mapped = mapped[_inside(mapped, shapes[1])]
    there = points(secondary_xy, "secondary_xy")
    there = there[_shown(there, known, shapes)]
    if not len(mapped) or not len(there):
        return 0, len(mapped), len(there)
    distance, nearest = cKDTree(there).query(mapped)
    back = np.asarray(cKDTree(mapped).query(there)[1])
    mutual = back[nearest] == np.arange(len(mapped))
    return int(np.count_nonzero(mutual & (distance <= threshold))), len(mapped), len(there)


def _inside(xy: FloatArray, shape: tuple[int, int]) -> BoolArray:
    height, width = shape
    return np.asarray(((xy >= -0.5) & (xy <= (width - 0.5, height - 0.5))).all(axis=1))


def _shown(xy: FloatArray, truth: Truth, shapes: tuple[tuple[int, int], tuple[int, int]]) -> BoolArray:
    """Which secondary points the reference shows.

    A truth may have no inverse (a flow), so the outline of the reference is mapped, and the points are held to it.
    """
    import cv2

    height, width = shapes[0]
    x, y = np.linspace(0, width - 1, 65), np.linspace(0, height - 1, 65)
    sides = [(x, x * 0), (y * 0 + width - 1, y), (x[::-1], x * 0 + height - 1), (y * 0, y[::-1])]
    outline = truth(np.concatenate([np.stack(side, axis=1) for side in sides]))
    outline = outline[np.isfinite(outline).all(axis=1)]
    if len(outline) < 3 or not len(xy):
        return np.ones(len(xy), np.bool_)
    ring = np.asarray(outline, np.float32).reshape(-1, 1, 2)
    return np.array([cv2.pointPolygonTest(ring, (float(px), float(py)), False) >= 0 for px, py in xy], np.bool_)


def area_under_curve(errors: ArrayLike, limit: float) -> float:
    """Return the area under the share of errors within t, for t from 0 to `limit` px, divided by `limit`.

    An error that is infinite or NaN is never within. 0 where there are no errors.

    Notes
    -----
    The exact area under the steps, which is the mean of max(0, 1 - error / limit); a trapezium through the steps, as
    in some published code, gives a little more with few errors.
    """
    if not limit > 0:
        raise ParameterError(f"limit must be a positive number of pixels, got {limit}")
    array = np.nan_to_num(np.asarray(errors, dtype=np.float64).ravel(), nan=np.inf)
    return float(np.mean(np.maximum(0.0, 1 - array / limit))) if len(array) else 0.0


def matching_accuracy_curve(errors: ArrayLike, thresholds: Sequence[float] = CURVE) -> FloatArray:
    """Return the share of matches within each threshold (mean matching accuracy, by default at 1 to 10 px).

    NaN errors are not scored; zeros where there are no errors.
    """
    known = np.sort(_known(errors))
    counts = np.searchsorted(known, np.asarray(thresholds, dtype=np.float64), side="right")
    return counts / max(len(known), 1)


def _known(errors: ArrayLike) -> FloatArray:
    array = np.asarray(errors, dtype=np.float64).ravel()
    return array[~np.isnan(array)]


def _shape(registration: Registration, truth: Truth, image_shape: tuple[int, int] | None) -> tuple[int, int] | None:
    said = None if registration.reference is None else registration.reference.shape
    shape = image_shape or said or truth.shape
    if shape is None:
        return None
    if truth.shape is not None and tuple(shape) != truth.shape:
        raise InputError(f"the flow is {truth.shape} (H, W), the reference image {tuple(shape)}")
    return int(shape[0]), int(shape[1])
