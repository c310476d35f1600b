"""Two images on one grid: the secondary resampled by a model, and where whole windows are valid in both."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.interfaces import Model
from featreg.runtime.threads import in_parts
from featreg.sar.bridging import on_sample
from featreg.sar.correlation import Peaks
from featreg.sar.pyramid import clear
from featreg.types import BoolArray, FloatArray, Image, IntArray
from featreg.types.arrays import middle

F32 = NDArray[np.float32]

#: Pixels beyond a window that must be valid too: small shifts, and interpolation.
MARGIN = 4
#: In a window that must be whole the secondary is looked at so far apart, px; squares of 2 * MARGIN + 1 px, turned by
#: whatever angle, hold such a sample.
SAMPLED_PX = 6.0
#: Over so many px a model is taken as linear.
STEP_PX = 8.0
#: OpenCV resamples images of at most so many pixels a side; parts of a larger one have so many, px.
MOST_SIDE, PART_SIDE = 32_000, 4_096
#: An affine map that stretches more along an axis is left to OpenCV.
MOST_STRETCHED = 30.0


def resampled(view: F32, model: Model, shape: tuple[int, int]) -> F32:
    """Return the map `view` of the secondary on the (H, W) grid of the reference; its rim goes on outside it."""
    import cv2

    matrix = model.matrix
    if matrix is not None and np.array_equal(matrix[2], [0, 0, 1]) and _takes(view, matrix):
        return _sampled(np.ascontiguousarray(view), np.ascontiguousarray(matrix[:2]), shape)
    return np.asarray(warped(view, model, shape, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE), np.float32)


def _takes(view: F32, matrix: FloatArray) -> bool:
    """Whether a map and an affine map of it are such as `affine_kernels` takes."""
    return min(view.shape) >= 2 and view.size < 2**31 and bool(np.abs(matrix[:2, :2]).max() <= MOST_STRETCHED)


def _sampled(view: F32, affine: FloatArray, shape: tuple[int, int]) -> F32:
    """A map at the places to which an affine map (2, 3) takes a grid; of a large grid, threads share out the rows."""
    from featreg.sar.affine_kernels import sampled_affinely

    out = np.empty(shape, np.float32)
    flat, (height, width) = view.ravel(), view.shape

    def part(top: int, bottom: int) -> None:
        sampled_affinely(flat, height, width, affine, top, out[top:bottom])

    in_parts(part, *shape)
    return out


def warped(view: NDArray[Any], model: Model, shape: tuple[int, int], flags: int, border: int) -> NDArray[Any]:
    """Return a map of the secondary on the (H, W) grid of the reference, by OpenCV's kind of interpolation and rim."""
    import cv2

    size = (shape[1], shape[0])
    matrix = model.matrix
    if matrix is not None and np.array_equal(matrix[2], [0, 0, 1]) and max(*shape, *view.shape) <= MOST_SIDE:
        return cv2.warpAffine(view, matrix[:2], size, flags=flags | cv2.WARP_INVERSE_MAP, borderMode=border)
    x, y = np.meshgrid(np.arange(shape[1], dtype=np.float64), np.arange(shape[0], dtype=np.float64))
    return remapped(view, model(np.column_stack([x.ravel(), y.ravel()])).reshape(*shape, 2), flags, border)


def remapped(view: NDArray[Any], at: FloatArray, flags: int, border: int) -> NDArray[Any]:
    """Return a map at (H, W, 2) positions; sides beyond those that OpenCV takes part by part."""
    import cv2

    if max(*at.shape, *view.shape) <= MOST_SIDE:
        grid = at.astype(np.float32)
        return cv2.remap(view, grid[..., 0], grid[..., 1], flags, borderMode=border)
    out = np.empty(at.shape[:2], view.dtype)
    last = np.array(view.shape[::-1]) - 1
    for top in range(0, at.shape[0], PART_SIDE):
        for left in range(0, at.shape[1], PART_SIDE):
            here = slice(top, top + PART_SIDE), slice(left, left + PART_SIDE)
            part = np.nan_to_num(at[here], nan=-PART_SIDE)
            # Two pixels more for the interpolation; what lies outside the map sees its rim.
            x0, y0 = np.clip(np.floor(part.min(axis=(0, 1))) - 2, 0, last).astype(int).tolist()
            x1, y1 = np.clip(np.ceil(part.max(axis=(0, 1))) + 2, 0, last).astype(int).tolist()
            grid = (part - [x0, y0]).astype(np.float32)
            piece = np.ascontiguousarray(view[y0 : y1 + 1, x0 : x1 + 1])
            out[here] = cv2.remap(piece, grid[..., 0], grid[..., 1], flags, borderMode=border)
    return out


def halved(image: F32) -> F32:
    """Half the size by averaging 2 x 2 pixels; an odd last row or column is left out."""
    import cv2

    height, width = image.shape[0] // 2, image.shape[1] // 2
    small = cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def shared_pixels(reference: Image, secondary: Image, model: Model) -> BoolArray:
    """(H, W) pixels of the reference that are valid in both images, the secondary resampled by a model."""
    import cv2

    valid = clear(secondary, 1).view(np.uint8)
    there = warped(valid, model, reference.shape, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)
    return np.asarray(there.view(np.bool_) & reference.mask)


def affine_matrix(model: Model) -> FloatArray | None:
    """The (2, 3) map of a model that is affine, or None."""
    matrix = model.matrix
    return matrix[:2] if matrix is not None and matrix[2].tolist() == [0, 0, 1] else None


def linear_parts(model: Model, xy: FloatArray) -> FloatArray:
    """(N, 2, 2) linear part of a model at each of (N, 2) points."""
    affine = affine_matrix(model)
    if affine is not None:
        return np.broadcast_to(affine[:, :2], (len(xy), 2, 2))
    mapped = model(xy)
    return np.stack([(model(xy + step) - mapped) / STEP_PX for step in STEP_PX * np.eye(2)], axis=-1)


def local_affines(model: Model, xy: FloatArray) -> FloatArray:
    """(N, 2, 3) affine maps that a model is close to around each of (N, 2) points, and equal to there."""
    linear = linear_parts(model, xy)
    affine = np.empty((len(xy), 2, 3))
    affine[:, :, :2] = linear
    affine[:, :, 2] = model(xy) - np.einsum("nij,nj->ni", linear, xy)
    return affine


def inverted(matrices: FloatArray) -> FloatArray:
    """(N, 2, 2) inverses, infinite or NaN where there is none; a tenth of the time of numpy's."""
    a, b, c, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], -2) / (a * d - b * c)[:, None, None])


def peak_covariance(found: Peaks, model: Model, xy: FloatArray) -> FloatArray:
    """(N, 2, 2) px^2 covariances of sound peaks around points (N, 2) of the reference, up to a factor they share.

    It is (1 - rho^2) times the inverse curvature of the peak, brought to the pixels of the secondary by the linear part
    of the model.
    """
    from featreg.pipeline.located_kernels import covariances

    affine = affine_matrix(model)
    linear = linear_parts(model, xy) if affine is None else np.ascontiguousarray(affine[None, :, :2])
    out = np.empty((len(found.height), 2, 2))
    covariances(found.height, np.ascontiguousarray(found.curvature), np.ascontiguousarray(linear), out)
    return out


def variance_factor(residuals: FloatArray, covariance: FloatArray) -> float:
    """Factor that makes the median squared Mahalanobis length of the residuals what it is for two Gaussian errors.

    Parameters
    ----------
    residuals, covariance : (N, 2) px and (N, 2, 2) px^2
    """
    if not len(residuals):
        return 1.0
    from featreg.pipeline.located_kernels import squared_lengths

    squared = np.empty(len(residuals))
    squared_lengths(np.ascontiguousarray(residuals), np.ascontiguousarray(covariance), squared)
    return middle(squared) / (2 * math.log(2))


class WholeWindows:
    """Tests of whether the window around a point is valid, with a margin: in the reference, and in the secondary.

    Parameters
    ----------
    reference, secondary : the images
    model : reference -> secondary, by which the secondary is resampled
    half : half the window, px

    Notes
    -----
    Bridged samples may lie in a window, but not at the point itself.
    """

    def __init__(self, reference: Image, secondary: Image, model: Model, half: int) -> None:
        self.reach = half + MARGIN
        self.reference, self.secondary, self.model = reference, secondary, model
        self._clear = None if reference.all_valid else clear(reference, self.reach)

    @property
    def share(self) -> float:
        """The share of the places with room for a window in the reference at which it is valid there."""
        if self._clear is None:
            return 1.0
        height, width = (n - 2 * self.reach for n in self.reference.shape)
        return float(np.count_nonzero(self._clear)) / (height * width) if min(height, width) > 0 else 0.0

    def in_reference(self, xy: IntArray) -> BoolArray:
        """(N,) of (N, 2) whole pixels inside the reference."""
        if self._clear is None:
            room = np.array(self.reference.shape[::-1]) - self.reach
            good = ((xy >= self.reach) & (xy < room)).all(axis=1)
        else:
            good = self._clear[xy[:, 1], xy[:, 0]]
        return np.asarray(good & on_sample(xy, self.reference))

    def in_secondary(self, xy: IntArray) -> BoolArray:
        """(N,) of (N, 2) whole pixels inside the reference, for the windows of the resampled secondary around them."""
        if not self.secondary.all_valid:
            good = self._whole_in_secondary(xy)
            if self.secondary.filled is not None:
                good[good] = on_sample(self.model(xy[good].astype(np.float64)), self.secondary)
            return good
        reach = self.reach
        height, width = self.secondary.shape
        corners = np.array([[-reach, -reach], [reach, -reach], [-reach, reach], [reach, reach]], np.float64)
        around = self.model((xy[:, None, :] + corners).reshape(-1, 2)).reshape(-1, 4, 2)
        return np.asarray(((around >= 0) & (around <= [width - 1, height - 1])).all(axis=(1, 2)))

    def _whole_in_secondary(self, xy: IntArray) -> BoolArray:
        """(N,) whether the resampled secondary is valid in the windows around points, as far as the grid goes.

        What is invalid is grown to squares of 2 * MARGIN + 1 px first, so that samples every `SAMPLED_PX` meet it.
        """
        from featreg.sar.window_kernels import whole_windows

        good = np.zeros(len(xy), np.bool_)
        if not len(xy):
            return good
        affine = affine_matrix(self.model)
        maps = local_affines(self.model, xy.astype(np.float64)) if affine is None else affine[None].copy()
        stretch = np.abs(maps[:, :, :2]).sum(axis=2)
        # What a model does not know of one window says nothing of the others.
        most = min(float(stretch[np.isfinite(stretch)].max(initial=1.0)), 10.0)
        parts = math.ceil(2 * self.reach * most / SAMPLED_PX)
        valid, sums = self.secondary.derive(_summed_clear)
        middles = np.ascontiguousarray(xy, np.int64)
        whole_windows(valid, sums, maps, middles, self.reach, parts, *self.reference.shape, good)
        return good

    def __call__(self, xy: IntArray) -> BoolArray:
        """(N,) of (N, 2) whole pixels inside the reference: both."""
        good = self.in_reference(xy)
        good[good] = self.in_secondary(xy[good])
        return good


def _summed_clear(image: Image) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """(H, W) whether an image is valid in the square of `MARGIN` px around, and (H + 1, W + 1) sums of that."""
    import cv2

    valid = np.ascontiguousarray(clear(image, MARGIN)).view(np.uint8)
    return valid, np.asarray(cv2.integral(valid), np.int32)
