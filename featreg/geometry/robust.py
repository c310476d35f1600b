"""Robust fits of any model: seeded sample consensus, and iteratively reweighted least squares.

Both give the same result for the same input and seed on every run and for any number of workers.
"""

from __future__ import annotations

import logging
import math
from typing import Annotated, Any, TypeVar

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine, Homography, Rigid, Similarity, Translation
from featreg.geometry.corrected import CorrectedModel
from featreg.interfaces import FailedFit, Model
from featreg.runtime.parameters import Count, Positive, Probability, checked
from featreg.types import BoolArray, FloatArray, IntArray, points

M = TypeVar("M", bound=Model)

#: Models whose hypotheses the compiled search makes itself, and by which kind.
KINDS: dict[type[Model], int] = {Translation: 0, Rigid: 1, Similarity: 2, Affine: 3, Homography: 4}
#: Tukey's constant for 95 % efficiency on two-dimensional Gaussian errors (4.685 is that of one dimension).
TUKEY = 5.123
#: Median length of a two-dimensional Gaussian error of unit standard deviation per axis, sqrt(2 ln 2).
MEDIAN_LENGTH = math.sqrt(2.0 * math.log(2.0))

logger = logging.getLogger(__name__)


@checked("")
def fit_consensus(
    model_class: type[M],
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    *,
    threshold: Positive,
    rng: np.random.Generator,
    candidates: NDArray[np.integer] | None = None,
    iterations: Count = 2000,
    confidence: Probability = 0.999,
    widening: Annotated[float, Ge(1)] = 4.0,
) -> tuple[M | FailedFit, BoolArray]:
    """Fit a model to the largest set of tie points that agree with each other.

    Parameters
    ----------
    model_class : the model to fit, a class or anything else with its `from_estimate` and `minimum`
    reference_xy, secondary_xy : (M, 2) float64 px
    threshold : largest residual of an inlier in the secondary image, px
    rng : the only source of randomness
    candidates : rows from which hypotheses are drawn (consensus always counts all), or None for all
    iterations : most hypotheses
    confidence : probability with which a sample without outliers has been drawn when the search stops early
    widening : factor on the threshold while a model that has no hypotheses of its own is sought; see Notes

    Returns
    -------
    model : least-squares model of the consensus, or a `FailedFit`
    inliers : (M,) bool, residual of that model at most the threshold; all False where the fit failed

    Raises
    ------
    InputError
        The points are not (M, 2) and finite.
    ParameterError
        A threshold, a number of iterations or a confidence that is impossible.

    Notes
    -----
    Hypotheses are judged by the truncated quadratic sum min(r^2 / t^2, 1) (MSAC [1]_). Each new best one is polished by
    least squares on its inliers before it decides how long to go on (local optimisation [2]_). Samples whose points lie
    closer together, or closer to one line, than two thresholds are skipped.

    Translation, rigid, similarity, affine and homography make their own hypotheses; a model that corrects a known map
    has those of its correction, on the mapped points. For every other model (polynomials) the hypotheses are affine,
    within `widening` thresholds; the model is then fitted to that consensus and verified again while the threshold
    narrows to its value. The deviation of such a model from an affine map must stay below `widening` thresholds on a
    good part of the points.

    A consensus of no more than the points that a model needs is no consensus, unless these are all there are. Whether a
    consensus is more than chance gives is for the trust gates to decide.

    References
    ----------
    .. [1] P. Torr, A. Zisserman, "MLESAC: a new robust estimator with application to estimating image geometry",
       Comput. Vis. Image Underst. 78(1), 2000, DOI 10.1006/cviu.1999.0832
    .. [2] O. Chum, J. Matas, J. Kittler, "Locally optimized RANSAC", DAGM 2003, DOI 10.1007/978-3-540-45243-0_31
    """
    reference, secondary = points(reference_xy, "reference_xy"), points(secondary_xy, "secondary_xy")
    if len(reference) != len(secondary):
        raise InputError(f"as many reference as secondary points are needed, got {len(reference)}, {len(secondary)}")
    if isinstance(model_class, type) and issubclass(model_class, CorrectedModel):
        return _fit_correction(
            model_class, reference, secondary, threshold=threshold, rng=rng, candidates=candidates,
            iterations=iterations, confidence=confidence, widening=widening,
        )  # fmt: skip
    none, count = np.zeros(len(reference), np.bool_), len(reference)
    if count < model_class.minimum:
        found = f"got {count}" if count else "none given"
        return FailedFit(f"too few points: {model_class.minimum} needed, {found}"), none
    # A model that needs fewer points than an affine one may still have its few.
    own = _kind(model_class)
    kind = (3 if count >= Affine.minimum else 0) if own is None else own
    widths = [threshold]
    if own is None:
        steps = max(1, math.ceil(math.log2(widening)))
        widths = [threshold * widening ** (1 - i / steps) for i in range(steps + 1)]
        logger.info("%s has no hypotheses of its own: affine ones within %g px", model_class, widths[0])
    rows = np.arange(count) if candidates is None else np.unique(np.asarray(candidates, np.int64))
    if len(rows) and not (rows[0] >= 0 and rows[-1] < count):
        raise ParameterError(f"candidates must be rows 0..{count - 1}, got {rows[0]}..{rows[-1]}")
    matrix = _search(kind, reference, secondary, rows, widths[0], rng, iterations, confidence)
    if matrix is None:
        return FailedFit(f"none of the samples tried agrees with any of {count} points within {threshold:g} px"), none
    mapped = np.column_stack([reference, np.ones(count)]) @ matrix.T
    with np.errstate(divide="ignore", invalid="ignore"):
        inliers = np.hypot(*(mapped[:, :2] / mapped[:, 2:] - secondary).T) <= widths[0]
    model: M | FailedFit = FailedFit("no consensus")
    for width in widths:
        model, inliers = _polish(model_class, reference, secondary, inliers, width)
        if isinstance(model, FailedFit):
            return model, none
    if inliers.sum() < min(count, model_class.minimum + 1):
        return FailedFit(
            f"no consensus: at most {int(inliers.sum())} of {count} points agree within {threshold:g} px, "
            f"and {model_class.minimum} always do"
        ), none
    return model, inliers


def _kind(model_class: Any) -> int | None:
    """The number by which the compiled loops know a model; None where they do not."""
    return next((k for known, k in KINDS.items() if known is model_class), None)


def _fit_correction(
    model_class: type[CorrectedModel],
    reference: FloatArray,
    secondary: FloatArray,
    *,
    candidates: NDArray[np.integer] | None,
    **search: Any,
) -> tuple[Any, BoolArray]:
    """Consensus of what a known map leaves to be corrected; points that it cannot map never count."""
    mapped = model_class.known(reference)
    good = np.asarray(np.isfinite(mapped).all(axis=1))
    if candidates is not None:
        chosen = np.zeros(len(good), np.bool_)
        chosen[candidates] = True
        candidates = np.flatnonzero(chosen[good])
    fitted, kept = fit_consensus(
        model_class.correction_kind, mapped[good], secondary[good], candidates=candidates, **search
    )
    inliers = np.zeros(len(good), np.bool_)
    inliers[good] = kept
    return fitted if isinstance(fitted, FailedFit) else model_class.with_correction(fitted), inliers


def _reweighted_correction(
    model_class: type[CorrectedModel],
    reference: FloatArray,
    secondary: FloatArray,
    prior: FloatArray,
    scale_px: float,
    iterations: int,
) -> tuple[Any, FloatArray] | None:
    """`irls` of what a known map, asked once, leaves to be corrected; None where it cannot map all points."""
    mapped = model_class.known(reference)
    if not np.isfinite(mapped).all():
        return None
    fitted, weights = irls(
        model_class.correction_kind, mapped, secondary, weights=prior, scale_px=scale_px, iterations=iterations
    )
    return fitted if isinstance(fitted, FailedFit) else model_class.with_correction(fitted), weights


def _search(
    kind: int,
    reference: FloatArray,
    secondary: FloatArray,
    rows: IntArray,
    threshold: float,
    rng: np.random.Generator,
    iterations: int,
    confidence: float,
) -> FloatArray | None:
    """Return the (3, 3) matrix of the best hypothesis, or None."""
    from featreg.geometry.robust_kernels import OUTLIER, search

    size = (1, 2, 2, 3, 4)[kind]
    if len(rows) < size:
        rows = np.arange(len(reference))
    if len(rows) < size:
        return None
    here, there = reference.mean(axis=0), secondary.mean(axis=0)
    flat = np.ascontiguousarray(np.concatenate([(reference - here).T, (secondary - there).T]))
    # Two thresholds, but no more than a tenth of what a small or narrow set of points spans.
    apart = np.array([min(2.0 * threshold, 0.1 * _narrow(flat[:2])), min(2.0 * threshold, 0.1 * _narrow(flat[2:]))])
    best = np.zeros(9)
    samples = rows[draw_samples(rng, len(rows), size, iterations)]
    found = np.empty(2, np.int64)
    search(kind, flat, samples, rows, threshold, apart, confidence, best, found)
    cost, looked = found.tolist()
    logger.debug("consensus: %d hypotheses, cost %.1f of %d", looked, cost / OUTLIER, len(reference))
    if not best.any():
        return None
    forth, back = np.eye(3), np.eye(3)
    forth[:2, 2], back[:2, 2] = -here, there
    return np.asarray(back @ best.reshape(3, 3) @ forth)


def _narrow(centred: FloatArray) -> float:
    """Standard deviation of (2, M) points along their narrow axis."""
    (a, b), (_, d) = (centred @ centred.T / centred.shape[1]).tolist()
    # The smaller eigenvalue of a symmetric (2, 2) matrix.
    return math.sqrt(max(0.5 * (a + d) - math.hypot(0.5 * (a - d), b), 0.0))


def draw_samples(rng: np.random.Generator, count: int, size: int, samples: int) -> IntArray:
    """Draw `samples` sets of `size` different numbers below `count`, each set with the same probability.

    Returns
    -------
    (samples, size) int64
    """
    drawn = rng.integers(0, count - np.arange(size), (samples, size)).T.copy()
    earlier: list[IntArray] = []  # those of each set, from below
    for number in drawn:
        # Of the numbers not drawn yet, take the one of this rank: step over each smaller one, from below.
        for other in earlier:
            number += number >= other
        larger = number
        for i, other in enumerate(earlier):
            earlier[i], larger = np.minimum(other, larger), np.maximum(other, larger)
        earlier.append(larger)
    return np.ascontiguousarray(drawn.T)


def _polish(
    model_class: type[M], reference: FloatArray, secondary: FloatArray, inliers: BoolArray, threshold: float
) -> tuple[M | FailedFit, BoolArray]:
    """Fit to the inliers and select them again until the set is stable or the truncated cost no longer falls."""
    best: tuple[M | FailedFit, BoolArray] = FailedFit("no consensus"), inliers
    lowest = math.inf
    for _ in range(10):
        # A tenth of the time that indexing rows by a mask takes.
        rows = np.flatnonzero(inliers)
        model = model_class.from_estimate(reference.take(rows, axis=0), secondary.take(rows, axis=0))
        if isinstance(model, FailedFit):
            return (model, inliers) if lowest == math.inf else best
        residuals = model.residuals(reference, secondary)
        now = residuals <= threshold
        cost = float(np.sum((residuals[now] / threshold) ** 2)) + float((~now).sum())
        if cost >= lowest:
            break
        best, lowest = (model, now), cost
        if (now == inliers).all():
            break
        inliers = now
    return best


@checked("")
def irls(
    model_class: type[M],
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    *,
    weights: FloatArray | None = None,
    scale_px: Positive = 0.1,
    iterations: Count = 30,
) -> tuple[M | FailedFit, FloatArray]:
    """Fit a model by iteratively reweighted least squares with Tukey's biweight.

    Parameters
    ----------
    model_class : the model to fit
    reference_xy, secondary_xy : (M, 2) float64 px; most of them good, for the first fit is a plain one
    weights : (M,) prior weights of the squared residuals (inverse variances), or None for equal ones
    scale_px : smallest standard deviation per axis that the errors are taken to have, px
    iterations : most fits

    Returns
    -------
    model : the model, or a `FailedFit`
    weights : (M,) float64, prior weight times biweight of the final residuals; 0 = left out

    Raises
    ------
    ParameterError
        A scale or a number of iterations that is not positive.

    Notes
    -----
    The scale is the median residual length over sqrt(2 ln 2), its value for Gaussian errors in two dimensions, taken
    anew in each round and never below `scale_px`; the biweight (1 - (r / c s)^2)^2 has c = 5.123, 95 % efficiency in
    two dimensions. With prior weights the residuals are first multiplied by the square roots of the weights over
    their mean. The rounds of translation, rigid, similarity, affine and homography are compiled.
    """
    reference, secondary = points(reference_xy, "reference_xy"), points(secondary_xy, "secondary_xy")
    prior = np.ones(len(reference)) if weights is None else np.asarray(weights, np.float64)
    if isinstance(model_class, type) and issubclass(model_class, CorrectedModel):
        corrected = _reweighted_correction(model_class, reference, secondary, prior, scale_px, iterations)
        if corrected is not None:
            return corrected
    kind = _kind(model_class)
    if kind is not None and prior.ndim == 1 and len(reference) == len(secondary) == len(prior) > 0:
        from featreg.geometry.reweighting_kernels import reweighted

        final = np.empty(len(reference))
        least, tuning = scale_px * MEDIAN_LENGTH, TUKEY / MEDIAN_LENGTH
        if reweighted(kind, model_class.minimum, reference, secondary, prior, tuning, least, iterations, final):
            fitted = model_class.from_estimate(reference, secondary, final)
            return fitted, (np.zeros(len(reference)) if isinstance(fitted, FailedFit) else final)
    return plain_irls(model_class, reference, secondary, prior, scale_px, iterations)


def plain_irls(
    model_class: type[M],
    reference: FloatArray,
    secondary: FloatArray,
    prior: FloatArray,
    scale_px: float,
    iterations: int,
) -> tuple[M | FailedFit, FloatArray]:
    """`irls` of any model, which is fitted anew in each round; it also puts into words why a fit fails."""
    model = model_class.from_estimate(reference, secondary, prior)
    if isinstance(model, FailedFit):
        return model, np.zeros(len(reference))
    used = prior > 0
    root = np.sqrt(prior / prior[used].mean())
    final = prior
    for _ in range(iterations):
        residuals = root * model.residuals(reference, secondary)
        scale = max(float(np.median(residuals[used])) / MEDIAN_LENGTH, scale_px)
        before, final = final, prior * np.maximum(1.0 - (residuals / (TUKEY * scale)) ** 2, 0.0) ** 2
        again = model_class.from_estimate(reference, secondary, final)
        if isinstance(again, FailedFit):
            return again, np.zeros(len(reference))
        model = again
        if np.abs(final - before).max() <= 1e-9 * prior.max():
            break
    return model, final
