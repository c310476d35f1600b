"""Refinement: after a first model, guided sub-pixel tie points by local correlation, for every method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.interfaces import FailedFit, Model
from featreg.robust import irls
from featreg.sar.correlation import Peaks, local_correlations, peaks
from featreg.sar.speckle import despeckled
from featreg.types import BoolArray, FloatArray, Image, IntArray, Matches

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Refined:
    """What a refinement found.

    Parameters
    ----------
    matches : the new tie points, all within the residual limit of the model; `origin` names the match they came from
    model : fitted to them, or why not
    candidates : how many points were looked at
    correlated : how many of these had a sound correlation peak
    """

    matches: Matches
    model: Model | FailedFit
    candidates: int
    correlated: int


@dataclass(frozen=True)
class Refine:
    """Correlate the aligned images around the points that were detected, and fit the model again.

    Parameters
    ----------
    half : half the correlation window, px; it is 2 * half + 1 wide
    sigma : of the Gaussian that smooths the log-amplitude, px
    search : largest shift looked for around the first model, px; half of it around the second
    min_correlation : least height of a peak
    max_residual : largest distance of a kept tie point from the final model, px
    least_share : share of the points looked at that must be kept, or the refinement is not used

    Notes
    -----
    The secondary's despeckled log-amplitude is warped by the model onto the reference, so that windows need no
    resampling of their own. A first pass at half size finds shifts up to `search`, the model is fitted again, and a
    second pass at full size gives the positions. Points are those of the matches, filled up to the budget by the
    strongest gradient of each cell of a regular grid, so that the tie points spread over the image. The covariance of a
    tie point is (1 - rho^2) times the inverse curvature of its peak, times one variance factor for all, estimated
    from the residuals.
    """

    half: int = 24
    sigma: float = 1.0
    search: int = 6
    min_correlation: float = 0.35
    max_residual: float = 1.0
    least_share: float = 0.15

    def __post_init__(self) -> None:
        if self.half < 4 or self.search < 2 or not 0 < self.min_correlation < 1 or self.max_residual <= 0:
            raise ParameterError(
                "refine needs half >= 4, search >= 2, 0 < min_correlation < 1 and max_residual > 0, got "
                f"{self.half}, {self.search}, {self.min_correlation} and {self.max_residual}"
            )

    def least(self, candidates: int) -> int:
        """Fewest refined tie points, of so many looked at, for a refinement that is worth using."""
        return max(30, round(self.least_share * candidates))

    def run(self, reference: Image, secondary: Image, model: Model, matches: Matches, n_features: int) -> Refined:
        """Return at most `n_features` refined tie points around `model`; empty where the images do not correlate."""
        kind = type(model)
        none = Refined(Matches.empty(), FailedFit("no window of the two images correlates"), 0, 0)
        here = despeckled(reference, self.sigma)
        if min(reference.shape) < 4 * self.half:
            return none
        aligned, valid = align(secondary, model, reference, self.sigma)
        seeds, origin = self._seeds(here, valid, matches, n_features)
        # Pass one, at half size.
        small = [halved(m) for m in (here, aligned)]
        coarse = self._measure(*small, seeds // 2, self.half // 2, (self.search + 1) // 2)
        usable = coarse.sound & (coarse.height >= self.min_correlation)
        first, _ = self._fit(kind, seeds, model(seeds + 2 * coarse.shift), coarse, usable)
        if isinstance(first, FailedFit):
            return none
        # Pass two, at full size around the better model.
        aligned, valid = align(secondary, first, reference, self.sigma)
        inside = self._inside(valid, seeds)
        seeds, origin = seeds[inside], origin[inside]
        fine = self._measure(here, aligned, seeds, self.half, 2)
        usable = fine.sound & (fine.height >= self.min_correlation)
        there = first(seeds + fine.shift)
        final, weights = self._fit(kind, seeds, there, fine, usable)
        if isinstance(final, FailedFit):
            return none
        residuals = final.residuals(seeds.astype(np.float64), there)
        keep = usable & (weights > 0) & (residuals <= self.max_residual)
        covariance = (1 - fine.height[keep, None, None] ** 2) * np.linalg.inv(fine.curvature[keep])
        matches = Matches(
            seeds[keep],
            there[keep],
            fine.height[keep],
            covariance * _variance_factor(there[keep] - final(seeds[keep].astype(np.float64)), covariance),
            origin[keep],
        )
        return Refined(matches, final, len(seeds), int(usable.sum()))

    def _measure(self, first: F32, second: F32, at: IntArray, half: int, search: int) -> Peaks:
        height, width = first.shape
        reach = half + search + 1
        inside = ((at >= reach) & (at < np.array([width, height]) - reach)).all(axis=1)
        side = 2 * search + 1
        found = np.zeros((len(at), side, side))
        found[inside] = local_correlations(first, second, at[inside], half, search)
        return peaks(found)

    def _fit(
        self, kind: type[Model], seeds: IntArray, there: FloatArray, found: Peaks, usable: BoolArray
    ) -> tuple[Model | FailedFit, FloatArray]:
        """Robust fit weighted by the inverse variance of the peaks."""
        precision = np.linalg.det(np.where(usable[:, None, None], found.curvature, np.eye(2)))
        weights = np.sqrt(np.maximum(precision, 0)) / np.maximum(1 - found.height**2, 1e-3)
        prior = np.where(usable, weights, 0.0)
        if usable.sum() < max(3 * kind.minimum, 8):
            return FailedFit(f"only {int(usable.sum())} of {len(seeds)} windows correlate"), prior
        return irls(kind, seeds.astype(np.float64), there, weights=prior / prior.max(), scale_px=0.05)

    def _inside(self, valid: BoolArray, xy: IntArray) -> BoolArray:
        """Whether the whole window and search range around each point is valid."""
        import cv2

        reach = self.half + 4
        side = 2 * reach + 1
        clear = cv2.erode(valid.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0).astype(np.bool_)
        return np.asarray(clear[xy[:, 1], xy[:, 0]])

    def _seeds(self, here: F32, valid: BoolArray, matches: Matches, budget: int) -> tuple[IntArray, IntArray]:
        """Whole-pixel points to look at, without repeats: those of the matches first, then a fill-in of (-1) points."""
        height, width = here.shape
        at = np.clip(np.rint(matches.reference_xy), 0, [width - 1, height - 1]).astype(np.int64)
        origin = np.arange(len(at))
        clear = self._inside(valid, at)
        at, origin = at[clear], origin[clear]
        missing = budget - len(at)
        if missing > 0:
            fill = _strongest_of_cells(here, valid, missing, self.half + 4)
            fill = fill[self._inside(valid, fill)]
            at, origin = np.concatenate([at, fill]), np.concatenate([origin, np.full(len(fill), -1)])
        _, first = np.unique(at[:, 1] * width + at[:, 0], return_index=True)
        first = np.sort(first)[:budget]
        return at[first], origin[first]


def align(secondary: Image, model: Model, reference: Image, sigma: float) -> tuple[F32, BoolArray]:
    """Return the secondary's despeckled log-amplitude on the reference grid, and where both images are valid."""
    import cv2

    height, width = reference.shape
    view = despeckled(secondary, sigma)
    whole = secondary.all_valid
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    matrix = model.matrix
    mask = None if whole else secondary.mask.astype(np.uint8) * 255
    if matrix is not None and np.array_equal(matrix[2], [0, 0, 1]):
        warped = cv2.warpAffine(view, matrix[:2], (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        corners = np.ones(secondary.shape, np.uint8) * 255 if mask is None else mask
        valid = cv2.warpAffine(corners, matrix[:2], (width, height), flags=flags, borderValue=0) == 255
    else:
        x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        grid = model(np.column_stack([x.ravel(), y.ravel()])).reshape(height, width, 2).astype(np.float32)
        warped = cv2.remap(view, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        corners = np.ones(secondary.shape, np.uint8) * 255 if mask is None else mask
        valid = cv2.remap(corners, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR, borderValue=0) == 255
    return warped, valid & reference.mask


def halved(image: F32) -> F32:
    """Half the size by averaging 2 x 2 pixels; an odd last row or column is left out."""
    import cv2

    height, width = image.shape[0] // 2, image.shape[1] // 2
    small: F32 = cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    return small


def _strongest_of_cells(view: F32, valid: BoolArray, count: int, margin: int) -> IntArray:
    """The pixel of strongest gradient in each cell of a regular grid of about `count` cells inside the margin."""
    import cv2

    height, width = view.shape
    y0, y1, x0, x1 = margin, height - margin, margin, width - margin
    side = max(2, int(np.sqrt((y1 - y0) * (x1 - x0) / max(count, 1))))
    rows, cols = (y1 - y0) // side, (x1 - x0) // side
    if rows < 1 or cols < 1:
        return np.zeros((0, 2), np.int64)
    strength = cv2.magnitude(cv2.Sobel(view, cv2.CV_32F, 1, 0), cv2.Sobel(view, cv2.CV_32F, 0, 1))
    strength = np.where(valid, strength, -1)[y0 : y0 + rows * side, x0 : x0 + cols * side]
    cells = strength.reshape(rows, side, cols, side).swapaxes(1, 2).reshape(rows, cols, side * side)
    best = cells.argmax(axis=2)
    y = y0 + np.arange(rows)[:, None] * side + best // side
    x = x0 + np.arange(cols)[None, :] * side + best % side
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.int64)


def _variance_factor(residuals: FloatArray, covariance: FloatArray) -> float:
    """Factor that makes the median squared Mahalanobis length of the residuals what it is for two Gaussian errors."""
    if not len(residuals):
        return 1.0
    squared = np.einsum("ni,nij,nj->n", residuals, np.linalg.inv(covariance), residuals)
    return float(np.median(squared) / (2 * np.log(2)))
