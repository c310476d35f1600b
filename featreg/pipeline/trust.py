"""The one place that decides whether a registration can be trusted.

The limits were calibrated on pairs of unrelated SAR images (whole ones and random crops of different places): none may
come out "ok". `benchmarks/trust.py` repeats the calibration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from featreg.errors import InputError
from featreg.geometry import (
    Affine,
    decompose,
    dilution,
    local_linear,
    prediction_covariance,
    refitted_covariance,
    regional_covariance,
)
from featreg.geometry.cells import cells, spread
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Model
from featreg.runtime.parameters import checked
from featreg.types import BoolArray, FloatArray, Gate, Matches

# Side of the cells in which tie points are counted once.
DISTINCT_PX = 6.0
# Regions along each side of the tie points' bounding box that are left out in turn.
REGIONS = 4
# Tie points this near to a model tell how it is distorted; their errors in px are not told apart below the second.
NEAR_PX, AFFINE_SCALE_PX = 8.0, 0.6


@checked("trust")
@dataclass(frozen=True)
class Limits:
    """What a trusted registration must reach.

    Parameters
    ----------
    least_inliers : distinct tie points
    least_spread : share of the cells of an 8 x 8 grid over the reference that hold an inlier
    significance : log10 of the expected number of equally good models among chance matches, at most
    held_out_px : median residual of tie points that were left out of the fit, at most
    scale : the model's scale lies between 1 / scale and scale
    uncertainty_px : root mean square over the image of the model's own standard error, at most
    stability_px : root mean square over the image of the model's jackknife error, regions of tie points left out, at
        most
    anisotropy : largest ratio of the model's two scales
    distortion_px : root mean square over the image of what a stretch, shear or zoom of the tie points adds to a
        translation, rigid or similarity model, at most; inf for no such gate
    dilution : error of the model over the image for an error of one pixel per place of tie points, at most; inf for no
        such gate
    block_share : of a scene's blocks with content, the share that must hold a final tie point
    held_out_rmse_px : of a scene, RMSE of each half of its blocks from the model of the other, at most
    block_error_px : of a scene, median distance of a block's own tie points from the model, at most, in all blocks but
        the worst twentieth
    """

    least_inliers: int = 12
    least_spread: float = 0.05
    significance: float = -8.0
    held_out_px: float = 2.0
    scale: float = 2.5
    anisotropy: float = 1.5
    uncertainty_px: float = 2.0
    block_share: float = 0.1
    held_out_rmse_px: float = 2.0
    block_error_px: float = 2.0
    stability_px: float = 1.5
    distortion_px: float = math.inf
    dilution: float = math.inf


def assess(
    matches: Matches,
    putative: BoolArray,
    supported: BoolArray,
    inliers: BoolArray,
    model: Model | FailedFit,
    reference_shape: tuple[int, int],
    secondary_shape: tuple[int, int],
    limits: Limits,
    initial: Model | None = None,
    search_radius: float | None = None,
    further: Mapping[str, Gate] | None = None,
) -> tuple[str, str, Mapping[str, Gate]]:
    """Judge a registration.

    Parameters
    ----------
    matches : all tie points
    putative : (M,) rows that came from the matcher
    supported : (M,) rows that survived all filters before refinement
    inliers : (M,) the final set
    model : the final model
    reference_shape, secondary_shape : (H, W); of the secondary, the area over which a wrong match may lie
    limits : what must be reached
    initial, search_radius : a model known beforehand, if any, and how far from it in pixels the result may lie
    further : gates of the caller, which count as these do

    Returns
    -------
    status, reason, gates : "ok" or "unreliable", why, and every gate with its value
    """
    if isinstance(model, FailedFit):
        return "unreliable", f"no model could be fitted: {model.reason}", {}
    gates: dict[str, Gate] = {}

    def gate(name: str, value: float, meaning: str, low: float | None = None, high: float | None = None) -> None:
        known = math.isfinite(value)
        passed = known and (low is None or value >= low) and (high is None or value <= high)
        gates[name] = Gate(float(value) if known else None, bool(passed), low, high, meaning)

    here, there = matches.reference_xy[inliers], matches.secondary_xy[inliers]
    gate("inliers", distinct(here, there), "distinct tie points", low=limits.least_inliers)
    gate(
        "spread", spread(here, reference_shape), "share of the image's cells with a tie point", low=limits.least_spread
    )
    gate(
        "significance",
        log10_chance(matches, putative, supported, model, secondary_shape),
        "log10 of the expected number of models as good by chance",
        high=limits.significance,
    )
    gate(
        "held_out",
        held_out(type(model), here, there),
        "median residual of points left out, px",
        high=limits.held_out_px,
    )
    gate(
        "uncertainty",
        model_uncertainty(model, here, there, reference_shape),
        "standard error of the model over the image, px",
        high=limits.uncertainty_px,
    )
    unstable = instability(model, here, there, reference_shape)
    if unstable is not None:
        gate(
            "stability",
            unstable,
            "error of the model over the image by leaving out regions of tie points, px",
            high=limits.stability_px,
        )
    if math.isfinite(limits.distortion_px) and type(model).minimum < Affine.minimum:
        gate(
            "distortion",
            distortion(model, matches.reference_xy, matches.secondary_xy, reference_shape),
            "stretch or shear between the images that the model cannot hold, px over the image",
            high=limits.distortion_px,
        )
    if math.isfinite(limits.dilution):
        gate(
            "dilution",
            dilution_over(model, here, there, reference_shape),
            "error of the model over the image for one pixel of error per place with tie points",
            high=limits.dilution,
        )
    height, width = reference_shape
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    linear = local_linear(model, centre)[0]
    determinant = float(np.linalg.det(linear))
    gate("determinant", determinant, "of the model's linear part; the images are mirrored where negative", low=0.0)
    gate("scale", math.sqrt(abs(determinant)), "scale at the centre", low=1 / limits.scale, high=limits.scale)
    gate("anisotropy", decompose(linear).anisotropy, "ratio of the two scales at the centre", high=limits.anisotropy)
    if initial is not None:
        apart = float(np.hypot(*(model(here) - initial(here)).T).mean()) if len(here) else math.nan
        gate("prior", apart, "mean distance from the initial model, px", high=search_radius)
    gates.update(further or {})
    failed = [f"{name} {_text(g)}" for name, g in gates.items() if not g.passed]
    if failed:
        return "unreliable", "; ".join(failed), gates
    return "ok", "", gates


def _text(gate: Gate) -> str:
    value = "undefined" if gate.value is None else f"{gate.value:.3g}"
    if gate.low is not None and (gate.value is None or gate.value < gate.low):
        return f"{value} is below {gate.low:.3g} ({gate.meaning})"
    return f"{value} is above {gate.high:.3g} ({gate.meaning})"


def distinct(reference_xy: FloatArray, secondary_xy: FloatArray) -> int:
    """Number of tie points once those that share a cell of 6 px, in either image, count as one."""
    return min(len(np.unique(cells(xy, DISTINCT_PX))) for xy in (reference_xy, secondary_xy))


def log10_chance(
    matches: Matches, putative: BoolArray, supported: BoolArray, model: Model, secondary_shape: tuple[int, int]
) -> float:
    """Expected number, as log10, of models that as many matches support by chance (an a-contrario test).

    Parameters
    ----------
    matches : all tie points
    putative, supported : (M,) rows that came from the matcher, and those of them that survived the filters
    model : fitted to the supported ones
    secondary_shape : (H, W)

    Returns
    -------
    log10 of (n - m) C(n, k) C(k, m) p^(k - m) for k distinct supported of n distinct putative matches, m those that
    the model needs, p the chance that a random point of the secondary falls within reach of where the model maps.

    Notes
    -----
    L. Moisan, B. Stival, "A probabilistic criterion to detect rigid point matches between two images and estimate the
    fundamental matrix", IJCV 57 (2004), DOI 10.1023/B:VISI.0000013094.38752.54. Distinct: matches whose reference and
    secondary points fall on a common 6 px cell count once, because one structure is found on several levels.
    """
    kept = matches.take(supported & putative)
    if not len(kept):
        return 0.0
    n = _moves(matches.take(putative))
    k = min(_moves(kept), distinct(kept.reference_xy, kept.secondary_xy))
    m = model.minimum
    if k <= m:
        return 0.0
    reach = max(3.0, float(np.percentile(model.residuals(kept.reference_xy, kept.secondary_xy), 95)))
    p = min(1.0, math.pi * (reach + DISTINCT_PX / 2) ** 2 / (secondary_shape[0] * secondary_shape[1]))
    return math.log10(max(n - m, 1)) + _log10_choose(n, k) + _log10_choose(k, m) + (k - m) * math.log10(p)


def _moves(matches: Matches) -> int:
    """Number of distinct (reference cell, secondary cell) pairs."""
    pairs = np.column_stack([cells(xy, DISTINCT_PX) for xy in (matches.reference_xy, matches.secondary_xy)])
    order = np.lexsort(pairs.T)
    return int((np.diff(pairs[order], axis=0) != 0).any(axis=1).sum()) + 1 if len(pairs) else 0


def _log10_choose(n: int, k: int) -> float:
    return (math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)) / math.log(10)


def model_uncertainty(
    model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, shape: tuple[int, int]
) -> float:
    """Root mean square standard error in pixels of where a model maps a 5 x 5 grid over an image of (H, W).

    Large where the tie points are few, or huddle in one part of the image. NaN where it cannot be told.
    """
    try:
        covariance = prediction_covariance(model, reference_xy, secondary_xy, at=_grid(shape))
    except InputError:
        covariance = refitted_covariance(model, reference_xy, secondary_xy, at=_grid(shape))
    return _overall(covariance)


def _grid(shape: tuple[int, int]) -> FloatArray:
    """(25, 2) points of a 5 x 5 grid over an image of (H, W)."""
    x, y = np.meshgrid(np.linspace(0, shape[1] - 1, 5), np.linspace(0, shape[0] - 1, 5))
    return np.column_stack([x.ravel(), y.ravel()])


def instability(
    model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, shape: tuple[int, int]
) -> float | None:
    """Root mean square error in pixels of where a model maps a 5 x 5 grid over an image, by leaving out regions.

    Each of 4 x 4 regions of the tie points' bounding box is left out in turn. On real pairs the true error is 1.5 times
    this value in the median, and 4 times `model_uncertainty`. NaN where it cannot be told; None for a model without
    known derivatives (a residual field, one of another package), which may follow each region by itself.
    """
    if not len(reference_xy):
        return math.nan
    low, high = reference_xy.min(axis=0), reference_xy.max(axis=0)
    place = ((reference_xy - low) / np.maximum(high - low, 1e-9) * REGIONS).astype(np.int64)
    region = np.minimum(place, REGIONS - 1) @ np.array([1, REGIONS])
    try:
        covariance = regional_covariance(model, reference_xy, secondary_xy, region, at=_grid(shape))
    except InputError:
        return None
    return _overall(covariance)


def distortion(model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, shape: tuple[int, int]) -> float:
    """Root mean square in pixels over an image of (H, W) of a stretch, shear or zoom that a model cannot hold.

    It is the symmetric part of what an affine model, fitted robustly to all tie points within 8 px of the model, does
    beyond it. A scene out of focus differs so: the rigid model then fits a part of it only, and turns by about as much.
    NaN where it cannot be told.
    """
    near = model.residuals(reference_xy, secondary_xy) <= NEAR_PX
    affine, _ = irls(Affine, reference_xy[near], secondary_xy[near], scale_px=AFFINE_SCALE_PX, iterations=10)
    if isinstance(affine, FailedFit):
        return math.nan
    beyond = affine.matrix[:2, :2] @ np.linalg.inv(local_linear(model, reference_xy[near].mean(axis=0)))
    strain = (beyond + beyond.T) / 2 - np.eye(2)
    # A square of side s has the root mean square distance s / sqrt(6) from its centre.
    return float(np.sqrt((strain**2).sum() / 2 * (shape[0] ** 2 + shape[1] ** 2) / 12))


def dilution_over(model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, shape: tuple[int, int]) -> float:
    """`featreg.geometry.dilution` over a 5 x 5 grid of an image of (H, W)."""
    try:
        return dilution(model, reference_xy, secondary_xy, at=_grid(shape))
    except InputError:
        return 0.0


def _overall(covariance: FloatArray | FailedFit) -> float:
    """Root of the mean variance of points, both coordinates together; NaN where it is not known."""
    if isinstance(covariance, FailedFit):
        return math.nan
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()))


def held_out(kind: type[Model], reference_xy: FloatArray, secondary_xy: FloatArray) -> float:
    """Median residual in pixels of each half of the tie points from the model of the other half; NaN if none fits."""
    half = np.arange(len(reference_xy)) % 2 == 0
    residuals = []
    for fitted in (half, ~half):
        model = kind.from_estimate(reference_xy[fitted], secondary_xy[fitted])
        if isinstance(model, FailedFit):
            return math.nan
        residuals.append(model.residuals(reference_xy[~fitted], secondary_xy[~fitted]))
    return float(np.median(np.concatenate(residuals)))
