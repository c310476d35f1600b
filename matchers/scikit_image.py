"""Tie points and filters by scikit-image: RANSAC over our models, phase correlation of windows, dense optical flow."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from annotated_types import Ge, Gt, Interval

from featreg.interfaces import Filter, FilterContext, Matcher
from featreg.interop.family import Member, Row, option, register_table
from featreg.interop.opencv import MIN_SIDE
from featreg.interop.scikit_image import SkimageRow, picture
from featreg.runtime.timing import stage
from featreg.types import BoolArray, FloatArray, Image, Matches


def _shift(reference: FloatArray, secondary: FloatArray, values: Mapping[str, Any]) -> tuple[FloatArray, float]:
    """(x, y) from a pixel of the first window to its place in the second, and 1 minus scikit-image's error."""
    from skimage.registration import phase_cross_correlation

    normalization = None if values["normalization"] == "none" else values["normalization"]
    moved, error, _ = phase_cross_correlation(
        reference, secondary, upsample_factor=values["upsample_factor"], normalization=normalization
    )
    # It returns how the second is to be moved, in rows and columns.
    return -np.asarray(moved, np.float64)[::-1], 1.0 - float(np.nan_to_num(error, nan=1.0))


def _grid(shape: tuple[int, int], step: int, rim: float) -> FloatArray:
    """(N, 2) points a step apart, none closer to the border than the rim."""
    y, x = (np.arange(rim, length - rim, step, dtype=np.float64) for length in shape)
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def _phase_correlation(reference: FloatArray, secondary: FloatArray, values: Mapping[str, Any]) -> Matches:
    side = min(values["window"], *reference.shape)
    whole = np.rint(_shift(reference, secondary, {**values, "upsample_factor": 1})[0]).astype(np.int64)
    half = side // 2
    here, there, scores = [], [], []
    for x, y in _grid((reference.shape[0], reference.shape[1]), values["step"], half).astype(np.int64):
        left, top = x - half, y - half
        moved = np.array([left, top]) + whole
        if (moved < 0).any() or (moved + side > np.array(secondary.shape[::-1])).any():
            continue
        a = reference[top : top + side, left : left + side]
        b = secondary[moved[1] : moved[1] + side, moved[0] : moved[0] + side]
        if np.ptp(a) == 0 or np.ptp(b) == 0:
            continue
        shift, score = _shift(a, b, values)
        centre = np.array([left, top]) + (side - 1) / 2
        here.append(centre)
        there.append(centre + whole + shift)
        scores.append(score)
    return Matches(np.array(here).reshape(-1, 2), np.array(there).reshape(-1, 2), np.array(scores))


def _flow(reference: FloatArray, secondary: FloatArray, values: Mapping[str, Any]) -> Matches:
    """Tie points on a grid of a dense flow, which starts at the whole images' shift."""
    from scipy.ndimage import gaussian_filter, map_coordinates, shift
    from skimage import registration

    whole = np.rint(_shift(reference, secondary, {"upsample_factor": 1, "normalization": "phase"})[0])
    near = shift(secondary, -whole[::-1], order=0, mode="nearest")
    kind = "ilk" if "radius" in values else "tvl1"
    names = ("radius", "num_warp", "gaussian", "prefilter") if kind == "ilk" else FLOW
    keywords = {name: values[name] for name in names}
    rows, columns = getattr(registration, f"optical_flow_{kind}")(reference, near, **keywords)
    y, x = np.mgrid[: reference.shape[0], : reference.shape[1]]
    warped = map_coordinates(near, [y + rows, x + columns], order=1, mode="nearest")
    error = gaussian_filter(np.abs(warped - reference), 4.0)
    here = _grid((reference.shape[0], reference.shape[1]), values["step"], values["step"] / 2)
    at = here.astype(np.int64)
    here = at.astype(np.float64)
    moved = np.column_stack([columns[at[:, 1], at[:, 0]], rows[at[:, 1], at[:, 0]]])
    return Matches(here, here + whole + moved, 1.0 - error[at[:, 1], at[:, 0]])


FLOW = ("attachment", "tightness", "num_warp", "num_iter", "tol", "prefilter")
STEP = {"step": option(16, Ge(1), meaning="distance of the tie points along both axes, px")}
PREFILTER = {"prefilter": option(False, keyword="prefilter", meaning="median filter of the flow before each warp")}
MATCHERS: dict[str, SkimageRow] = {
    "skimage-phase-correlation": SkimageRow(
        "phase_cross_correlation",
        "Phase correlation of windows on a grid, around the shift of the whole images, by scikit-image",
        {
            "window": option(64, Ge(MIN_SIDE), meaning="side of a window, px"),
            "step": option(32, Ge(1), meaning="distance of the windows along both axes, px"),
            "upsample_factor": option(20, Ge(1), keyword="upsample_factor", meaning="shifts are found to 1/factor px"),
            "normalization": option("phase", choices=("phase", "none"), keyword="normalization"),
        },
        run=_phase_correlation,
    ),
    "skimage-ilk": SkimageRow(
        "optical_flow_ilk",
        "Tie points of a dense flow by the iterative method of Lucas and Kanade, by scikit-image",
        {
            **STEP,
            "radius": option(7, Ge(1), keyword="radius", meaning="of the window around a pixel, px"),
            "num_warp": option(10, Ge(1), keyword="num_warp"),
            "gaussian": option(False, keyword="gaussian"),
            **PREFILTER,
        },
        run=_flow,
    ),
    "skimage-tvl1": SkimageRow(
        "optical_flow_tvl1",
        "Tie points of a dense flow of least total variation (TV-L1), by scikit-image",
        {
            **STEP,
            "attachment": option(15.0, Gt(0), keyword="attachment"),
            "tightness": option(0.3, Gt(0), keyword="tightness"),
            "num_warp": option(5, Ge(1), keyword="num_warp"),
            "num_iter": option(10, Ge(1), keyword="num_iter"),
            "tol": option(1e-4, Gt(0), keyword="tol"),
            **PREFILTER,
        },
        run=_flow,
    ),
}
FILTERS: dict[str, Row] = {
    "skimage-ransac": Row(
        "ransac",
        "RANSAC over all matches with any of our models, by scikit-image",
        {
            "threshold": option(3.0, Gt(0), meaning="largest distance from the model of a match that is kept, px"),
            "max_trials": option(2000, Ge(1), keyword="max_trials"),
            "confidence": option(
                0.999, Interval(ge=0, lt=1), keyword="stop_probability",
                meaning="with which a sample of good matches has been drawn when the search stops early",
            ),
        },
    )
}  # fmt: skip


@register_table
class SkimageMatcher(Member, Matcher):
    """One source of tie points of scikit-image: a row of the table by name, and its parameters."""

    table = MATCHERS
    compiled = False

    @property
    def reach(self) -> float:
        """Half a window, or what a flow moves at most by its radius and warps."""
        values = self.parameters
        return values["window"] / 2 if "window" in values else 64.0

    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return tie points on a grid of the reference, best first, none of them on an invalid pixel.

        Notes
        -----
        For images that are nearly aligned but for a shift: the larger image is cut to the other's size at the top left.
        """
        values = self.parameters
        rows, columns = np.minimum(reference.shape, secondary.shape)
        if min(rows, columns) < MIN_SIDE:
            return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
        with stage("match"):
            a, b = (picture(image, values["normalise"])[:rows, :columns] for image in (reference, secondary))
            found: Matches = MATCHERS[self.name].run(a, b, values)
        keep = _valid(found.reference_xy, reference) & _valid(found.secondary_xy, secondary)
        kept = np.flatnonzero(keep)
        return found.take(kept[np.argsort(-found.score[kept], kind="stable")])


def _valid(xy: FloatArray, image: Image) -> BoolArray:
    """(M,) bool: the point lies on a valid pixel."""
    at = np.rint(xy).astype(np.int64)
    size = np.array(image.shape[::-1])
    inside = ((at >= 0) & (at < size)).all(axis=1)
    at = np.clip(at, 0, size - 1)
    return np.asarray(inside & image.mask[at[:, 1], at[:, 0]])


@register_table
class SkimageFilter(Member, Filter):
    """scikit-image's RANSAC as a filter: a row of the table by name, and its parameters."""

    table = FILTERS
    compiled = False

    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        """Return the inliers of the best model; all False where there is none."""
        from skimage.measure import ransac

        none = np.zeros(len(matches), np.bool_)
        model = context.model
        # One match more than the model needs is the least that says anything.
        if len(matches) <= model.minimum:
            return none

        class Fitted:
            """Our model in the words of scikit-image."""

            @classmethod
            def from_estimate(cls, reference_xy: Any, secondary_xy: Any) -> Any:
                made = cls()
                made.model = model.from_estimate(reference_xy, secondary_xy)
                return made if made.model else made.model

            def __init__(self) -> None:
                self.model: Any = None

            def estimate(self, reference_xy: Any, secondary_xy: Any) -> bool:
                self.model = model.from_estimate(reference_xy, secondary_xy)
                return bool(self.model)

            def residuals(self, reference_xy: Any, secondary_xy: Any) -> Any:
                return self.model.residuals(reference_xy, secondary_xy)

        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "No inliers found")
            _, inliers = ransac(
                (np.array(matches.reference_xy), np.array(matches.secondary_xy)),
                Fitted,
                min_samples=model.minimum,
                residual_threshold=self.parameters["threshold"],
                max_trials=self.parameters["max_trials"],
                stop_probability=self.parameters["confidence"],
                rng=context.rng,
            )
        if inliers is None or np.count_nonzero(inliers) <= model.minimum:
            return none
        return np.asarray(inliers, np.bool_)
