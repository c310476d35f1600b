"""Measures of points and of a model against a known truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import ParameterError
from featreg.study.truth import Truth, TruthLike, read_truth
from featreg.types import BoolArray, FloatArray, points

#: Thresholds of the mean matching accuracy curve, px.
CURVE = tuple(range(1, 11))


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
