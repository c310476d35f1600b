"""What trust looks at: measures of the tie points of a registration and of the model fitted to them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from featreg.errors import InputError
from featreg.geometry import (
    Affine,
    Homography,
    Predicted,
    Rigid,
    Similarity,
    Translation,
    dilution,
    local_linear,
    prediction,
)
from featreg.geometry.robust import KINDS, MEDIAN_LENGTH, TUKEY, irls
from featreg.geometry.uncertainty import Linearised, left_out_covariance, linearised
from featreg.interfaces import FailedFit, Model
from featreg.types import BoolArray, FloatArray, IntArray, Matches

# Side in px of the cells in which tie points are counted once.
DISTINCT_PX = 6.0
# Places along each side of an image at which a model is judged.
FIFTHS = np.linspace(0.0, 1.0, 5)
# Regions along each side of the tie points' bounding box that are left out in turn.
REGIONS = 4
# Tie points this near to a model tell how it is distorted; their errors in px are not told apart below the second.
NEAR_PX, AFFINE_SCALE_PX = 8.0, 0.6
# Most of them, the least that they tell, px, and the models that are freer than others by what an image pair may need.
MOST_NEAR, LEAST_MISFIT_PX, FREER_ROUNDS = 300, 1.0, 3
_FREER: Mapping[type[Model], type[Model]] = {Translation: Affine, Rigid: Affine, Similarity: Affine, Affine: Homography}
# The robust fits to halves of the tie points: errors in px below this are not told apart; their rounds.
SCALE_PX, HELD_OUT_ROUNDS = 0.3, 3


def distinct(reference_xy: FloatArray, secondary_xy: FloatArray) -> int:
    """Number of tie points once those that share a cell of 6 px, in either image, count as one."""
    here, there, _ = _counted(reference_xy, secondary_xy)
    return min(here, there)


def _counted(reference_xy: FloatArray, secondary_xy: FloatArray) -> tuple[int, int, int]:
    """Cells of 6 px of the reference that hold a tie point, those of the secondary, and different pairs of them."""
    from featreg.pipeline import trust_kernels as kernels

    out = np.empty(3, np.int64)
    kernels.counted(np.ascontiguousarray(reference_xy), np.ascontiguousarray(secondary_xy), DISTINCT_PX, out)
    here, there, pairs = out.tolist()
    return here, there, pairs


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
    kept = supported & putative
    if not kept.any():
        return 0.0
    here, there = matches.reference_xy[kept], matches.secondary_xy[kept]
    if putative.all():
        n = _counted(matches.reference_xy, matches.secondary_xy)[2]
    else:
        n = _counted(matches.reference_xy[putative], matches.secondary_xy[putative])[2]
    k = min(_counted(here, there))
    m = model.minimum
    if k <= m:
        return 0.0
    reach = max(3.0, _quantile(model.residuals(here, there), 0.95))
    p = min(1.0, math.pi * (reach + DISTINCT_PX / 2) ** 2 / (secondary_shape[0] * secondary_shape[1]))
    return math.log10(max(n - m, 1)) + _log10_choose(n, k) + _log10_choose(k, m) + (k - m) * math.log10(p)


def _quantile(values: FloatArray, share: float) -> float:
    """A quantile of some values as numpy interpolates it, in a quarter of the time."""
    place = share * (len(values) - 1)
    low = int(place)
    ranked = np.partition(values, (low, min(low + 1, len(values) - 1)))
    return float(ranked[low] + (place - low) * (ranked[min(low + 1, len(values) - 1)] - ranked[low]))


def _log10_choose(n: int, k: int) -> float:
    return (math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)) / math.log(10)


def predicted(
    model: Model,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    shape: tuple[int, int],
    weights: FloatArray | None = None,
) -> Predicted | FailedFit:
    """`featreg.geometry.prediction` over a 5 x 5 grid of an image of (H, W)."""
    return prediction(model, reference_xy, secondary_xy, weights, at=_grid(shape))


def model_uncertainty(
    known: Predicted | FailedFit,
    model: Model,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    shape: tuple[int, int],
) -> float:
    """Root mean square standard error in pixels of where a model maps the points at which it is `known`.

    Large where the tie points are few, huddle in one part of the image, have errors in common with their neighbours, or
    those of the matcher, (M, 2), follow a freer model that this one cannot hold. NaN where it cannot be told.
    """
    error = _overall(known if isinstance(known, FailedFit) else known.covariance)
    return math.hypot(error, misfit(model, reference_xy, secondary_xy, shape, error)) if math.isfinite(error) else error


def misfit(
    model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, shape: tuple[int, int], error: float
) -> float:
    """Root mean square in pixels over an image of (H, W) of what a freer model of the tie points does beyond a model.

    It is affine for translation, rigid and similarity models, a homography for affine ones, fitted robustly to the tie
    points within 8 px of the model, at most 300. Below 1 px, the `error` of the model in px or twice that of the
    freer one, it is none.
    """
    from featreg.pipeline import trust_kernels as kernels

    freer = _FREER.get(type(model))
    if freer is None:
        return 0.0
    near = np.flatnonzero(model.residuals(reference_xy, secondary_xy) <= NEAR_PX)
    near = near[:: max(1, -(-len(near) // MOST_NEAR))]
    here, there = (np.ascontiguousarray(xy[near]) for xy in (reference_xy, secondary_xy))
    grid = _grid(shape)
    weights = np.empty(len(near))
    moved = kernels.beyond(
        KINDS[freer], freer.minimum, here, there, TUKEY / MEDIAN_LENGTH, AFFINE_SCALE_PX * MEDIAN_LENGTH, FREER_ROUNDS,
        grid, model(grid), weights,
    )  # fmt: skip
    if not moved > max(error, LEAST_MISFIT_PX):
        return 0.0
    other = freer.from_estimate(here, there, weights)
    if isinstance(other, FailedFit):
        return 0.0
    used = weights > 0
    own = predicted(other, here[used], there[used], shape)
    sure = _overall(own if isinstance(own, FailedFit) else own.covariance)
    return math.sqrt(moved**2 - sure**2) if moved > 2 * sure else 0.0


def _grid(shape: tuple[int, int]) -> FloatArray:
    """(25, 2) points of a 5 x 5 grid over an image of (H, W)."""
    grid = np.empty((5, 5, 2))
    grid[:, :, 0] = FIFTHS * (shape[1] - 1)
    grid[:, :, 1] = FIFTHS[:, None] * (shape[0] - 1)
    return grid.reshape(-1, 2)


def linear_fit(
    model: Model,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    shape: tuple[int, int],
    weights: FloatArray | None = None,
) -> Linearised | FailedFit | None:
    """A fit made linear around its model, over a 5 x 5 grid of an image of (H, W); None without known derivatives."""
    try:
        return linearised(model, reference_xy, secondary_xy, weights, at=_grid(shape))
    except InputError:
        return None


def instability(known: Linearised | FailedFit | None, length: float = 0.0) -> float | None:
    """Root mean square error in pixels of where a model maps a 5 x 5 grid over an image, by leaving out regions.

    Each of 4 x 4 regions of the tie points' bounding box is left out in turn, or of 3 x 3 where the errors of tie
    points are correlated over a `length` in px of more than a quarter of it. NaN where it cannot be told; None for a
    model without known derivatives (a residual field, one of another package), which may follow each region by itself.
    """
    if known is None:
        return None
    if isinstance(known, FailedFit):
        return math.nan
    extent = float(np.ptp(known.here, axis=0).max())
    region = _regions(known.here, REGIONS - 1 if length * REGIONS > extent else REGIONS)
    return _overall(left_out_covariance(known, region))


def distortion(
    model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, shape: tuple[int, int]
) -> float | None:
    """Root mean square in pixels over an image of (H, W) of a stretch, shear or zoom that a model cannot hold.

    It is the symmetric part of what an affine model, fitted robustly to all tie points within 8 px of the model, does
    beyond it. A scene out of focus differs so: the rigid model then fits a part of it only, and turns by about as much.
    NaN where it cannot be told; None for a model that holds them.
    """
    if type(model).minimum >= Affine.minimum:
        return None
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


def at_centre(model: Model, shape: tuple[int, int]) -> FloatArray:
    """(2, 2) linear part of a model at the centre of an image of (H, W)."""
    return local_linear(model, np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2]))


def apart(model: Model, initial: Model, reference_xy: FloatArray) -> float:
    """Mean distance in pixels of two models over tie points; NaN without any."""
    return float(np.hypot(*(model(reference_xy) - initial(reference_xy)).T).mean()) if len(reference_xy) else math.nan


def _overall(covariance: FloatArray | FailedFit) -> float:
    """Root of the mean variance of points, both coordinates together; NaN where it is not known."""
    if isinstance(covariance, FailedFit):
        return math.nan
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()))


def held_out(kind: type[Model], reference_xy: FloatArray, secondary_xy: FloatArray) -> float:
    """Median residual in pixels of each half of the tie points from the model of the other; NaN if none fits.

    The halves are the two colours of a chessboard of 4 x 4 regions over the bounding box, so that neighbours, which
    share errors, do not vouch for each other. Models are fitted as those of the result are, robustly.
    """
    from featreg.pipeline import trust_kernels as kernels

    region = _regions(reference_xy)
    half = (region // REGIONS + region % REGIONS) % 2 == 0
    if not half.any() or half.all():
        return math.nan
    if kind in KINDS:
        here, there = np.ascontiguousarray(reference_xy), np.ascontiguousarray(secondary_xy)
        tuning, least = TUKEY / MEDIAN_LENGTH, SCALE_PX * MEDIAN_LENGTH
        found = kernels.held_out(KINDS[kind], kind.minimum, here, there, half, tuning, least, HELD_OUT_ROUNDS)
        return found if found >= 0 else math.nan
    residuals = []
    for fitted in (half, ~half):
        model, _ = irls(kind, reference_xy[fitted], secondary_xy[fitted], scale_px=SCALE_PX, iterations=HELD_OUT_ROUNDS)
        if isinstance(model, FailedFit):
            return math.nan
        residuals.append(model.residuals(reference_xy[~fitted], secondary_xy[~fitted]))
    return float(np.median(np.concatenate(residuals)))


def _regions(xy: FloatArray, along: int = REGIONS) -> IntArray:
    """(M,) number of the region in which each of (M, 2) points lies, of so many along each side of their box."""
    if not len(xy):
        return np.zeros(0, np.int64)
    low, high = xy.min(axis=0), xy.max(axis=0)
    place = ((xy - low) / np.maximum(high - low, 1e-9) * along).astype(np.int64)
    return np.asarray(np.minimum(place, along - 1) @ np.array([1, along]))
