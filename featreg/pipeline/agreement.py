"""Whether the images themselves agree with a model: everywhere, by no second motion, and by no other model as well.

The secondary is resampled by the model onto the reference, both are made four times smaller, and compared: window by
window over shifts of up to 24 px, and as a whole over all shifts and half a turn. Nothing here depends on tie points,
so it sees what filters and refinement have dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Model
from featreg.pipeline.aligned import MOST_SIDE, remapped
from featreg.runtime.threads import side_by_side
from featreg.sar.correlation import Peaks, local_correlations, peaks
from featreg.sar.speckle import despeckled, despeckled_halved
from featreg.types import BoolArray, FloatArray, Image, IntArray

F32 = NDArray[np.float32]

#: The images are compared by samples of 4 px a side, of 2 px where one is shorter than SHORT px, less a Gaussian mean
#: of SHADING samples.
STEP, SHORT, SHADING = 4, 240, 3.0
#: Half of a window, largest shift looked for, in samples, and most windows along each side of the image; they lie at
#: least half a window apart.
HALF, SEARCH, SIDE = 8, 6, 12
#: Least correlation of a window that speaks for the model, and of one that speaks against it.
FOR, AGAINST = 0.4, 0.5
#: A window speaks against the model where its peak lies farther away than this, px, and explains so many times better.
FAR_PX, BETTER = 1.75, 1.15
#: Displacements of neighbouring windows that move together differ by less than this, px.
TOGETHER_PX = 2.5
#: Fewest windows by which a drift is told, and displacements from their common field that are not told apart, px.
LEAST_DRIFT, DRIFT_SCALE_PX = 8, 2.0
#: Along each axis, how far a refinement may have moved what it was given, px: so many models it chose from.
CHOSEN_PX = 6.0
#: Shifts of the whole image within this many samples of none belong to the peak of the model itself.
LOBE = 4
#: Images of more samples a side are correlated as a whole by samples of twice the side.
MOST_WHOLE = 600
#: Fewest windows with something to say, and least share of those that both images hold.
LEAST_WINDOWS, LEAST_SPEAKING = 12, 1 / 3
#: So near to the edge, px, rounding decides what lies inside.
EDGE_PX = 1e-6
#: A window has structure where neighbouring samples correlate by this much; speckle alone has 0.0 to 0.2.
STRUCTURE = 0.2


@dataclass(frozen=True, eq=False)
class Windows:
    """What the windows say.

    Parameters
    ----------
    xy : (N, 2) float64 px, their centres in the reference
    moved : (N, 2) float64 px, displacement of each in the reference's frame beyond the model
    at_model : (N,) float64 correlation where the model maps
    height : (N,) float64 correlation where it is highest
    agree, contradict : (N,) bool, those that speak for the model and against it
    inside : (N,) bool, those that both images hold
    peaked : (N,) bool, those of them with a peak away from the rim of the search that is high enough to speak against
    reach : half the side of a window, px
    """

    xy: FloatArray
    moved: FloatArray
    at_model: FloatArray
    height: FloatArray
    agree: BoolArray
    contradict: BoolArray
    inside: BoolArray
    peaked: BoolArray
    reach: float

    @property
    def contradicting(self) -> float | None:
        """Share of the windows that speak at all which speak against the model; None where too few do."""
        against, speaking = int(self.contradict.sum()), int((self.agree | self.contradict).sum())
        enough = max(LEAST_WINDOWS, LEAST_SPEAKING * int(self.inside.sum()))
        return against / speaking if speaking >= enough else None

    @property
    def drift(self) -> float | None:
        """Root mean square in px of the affine field that most displacements share; None where few windows have one.

        A model that tie points in one part of the image determine is wrong elsewhere by what grows with the distance:
        few windows there move as their neighbours do, but all of them together.
        """
        here = self.xy[self.peaked]
        if len(here) < LEAST_DRIFT:
            return None
        there = here + self.moved[self.peaked]
        field, _ = irls(Affine, here, there, scale_px=DRIFT_SCALE_PX, iterations=10)
        if isinstance(field, FailedFit):
            return None
        return float(np.sqrt(((field(here) - here) ** 2).sum(axis=1).mean()))

    def log10_chance(self, parameters: int) -> float:
        """Expected number, as log10, of models of so many parameters for which as many windows speak by chance.

        As `featreg.pipeline.trust_measures.log10_chance` of tie points: n windows look by themselves, k of them have
        their peak within `FAR_PX` of the model, each by chance with the share of that disc in the search, and the model
        is one of those that a refinement may have chosen.
        """
        count = int(self.inside.sum())
        if not self.agree.any():
            return 0.0
        # Windows lie half a window apart: a square of s x s of them covers the area of ((s + 1) / 2)^2.
        n = (math.sqrt(count) + 1) ** 2 / 4
        k = n * int(self.agree.sum()) / count
        search = (2 * SEARCH + 1) * 2 * self.reach / (2 * HALF + 1)
        p = math.pi * FAR_PX**2 / search**2
        models = 0.5 * parameters * math.log10(max(1.0, (2 * CHOSEN_PX + 1) ** 2 / (math.pi * FAR_PX**2)))
        choose = (math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)) / math.log(10)
        return models + choose + k * math.log10(p)


@dataclass(frozen=True, eq=False)
class Agreement:
    """Two images on the reference's grid, made smaller.

    Parameters
    ----------
    here, there : (h, w) float32 local contrast of the logarithms, the secondary resampled by the model; 0 where invalid
    valid : (h, w) bool
    step : side of a sample, px
    """

    here: F32
    there: F32
    valid: BoolArray
    step: int

    @classmethod
    def of(cls, reference: Image, secondary: Image, model: Model, without: BoolArray | None = None) -> Agreement | None:
        """Compare two images under a model; None where they are too small, or share too little.

        `without` are (H, W) pixels at the same place in both that do not count.
        """
        import cv2

        step = STEP if min(reference.shape) >= SHORT else STEP // 2
        size = (reference.shape[1] // step, reference.shape[0] // step)
        if min(size) < 2 * (HALF + SEARCH + 1) + 4:
            return None
        if without is None and reference.all_valid and secondary.all_valid:
            valid = _inside(model, size, step, secondary.shape)
        else:
            usable = [image.mask if without is None else image.mask & ~without for image in (reference, secondary)]
            covered = cv2.min(_covered(usable[1], model, reference.shape), usable[0].view(np.uint8) * np.uint8(255))
            valid = smaller(covered, step) == 255
        if np.count_nonzero(valid) < (2 * HALF + 1) ** 2:
            return None
        # Of the smoothed secondary every other pixel of the reference's grid is enough.
        stride = step // 2
        # Made here, its rows are shared out to threads; within one of two things side by side they would not be.
        smooth = despeckled(secondary)

        def seen() -> F32:
            view = sampled(smooth, model, reference.shape, stride)
            return contrast(smaller(view, step // stride), valid)

        here, there = side_by_side([lambda: contrast(smaller(despeckled_halved(reference), step // 2), valid), seen])
        return cls(here, there, valid, step)

    @cached_property
    def windows(self) -> Windows:
        """What the windows say, each 17 samples wide, on a regular grid."""
        import cv2

        reach = HALF + SEARCH + 1
        height, width = self.here.shape
        gx, gy = (
            np.linspace(reach, n - reach - 1, min(SIDE, (n - 2 * reach - 1) // HALF + 1)).astype(np.int64)
            for n in (width, height)
        )
        grid = (len(gy), len(gx))
        at = np.stack(np.meshgrid(gx, gy), -1).reshape(-1, 2)
        correlations = local_correlations(self.here, self.there, at, HALF, SEARCH)
        found = peaks(correlations)
        at_model = np.maximum(correlations[:, SEARCH, SEARCH], -1.0)
        share = cv2.boxFilter(self.valid.astype(np.float32), -1, (2 * HALF + 1,) * 2, borderType=cv2.BORDER_CONSTANT)
        inside = share[at[:, 1], at[:, 0]] > 0.9
        moved = self.step * found.shift
        speaks = inside & found.sound & (found.height >= FOR)
        far = np.hypot(*moved.T) > FAR_PX
        contradict = speaks & far & (found.height >= AGAINST) & _better(found, at_model)
        contradict &= _neighbours(moved, contradict, grid) >= 1
        xy = (at.astype(np.float64) + 0.5) * self.step - 0.5
        peaked = inside & found.sound & (found.height >= AGAINST)
        return Windows(
            xy, moved, at_model, found.height, speaks & ~far, contradict, inside, peaked,
            (HALF + 0.5) * self.step,
        )  # fmt: skip

    @cached_property
    def elsewhere(self) -> float | None:
        """Mean correlation at the model of the half of the structured samples around which the images agree least.

        Over squares of 36 px. None where less than a tenth of the samples that both images hold has structure.
        """
        squares = self.here * self.here, self.there * self.there
        least = (_structure(view, square) for view, square in zip((self.here, self.there), squares, strict=True))
        structured = self.valid & (np.minimum(*least) >= STRUCTURE)
        if np.count_nonzero(structured) < 0.1 * np.count_nonzero(self.valid):
            return None
        power = _mean(squares[0], HALF // 2) * _mean(squares[1], HALF // 2)
        local = _mean(self.here * self.there, HALF // 2) / np.sqrt(np.maximum(power, 1e-20))
        ranked = np.sort(local[structured])
        return float(ranked[: len(ranked) // 2 + 1].mean())

    @cached_property
    def whole(self) -> tuple[float, float, tuple[float, float], float]:
        """Correlation of the whole images, of large ones by samples of twice the side.

        Returns
        -------
        model, other, shift, turned : correlation coefficient at the model, the highest at any other shift, that shift
            (dx, dy) in px, and the highest after half a turn
        """
        import cv2

        here, there, step, side = self.here, self.there, self.step, LOBE
        if max(here.shape) > MOST_WHOLE:
            here, there, step, side = smaller(here, 2), smaller(there, 2), 2 * step, side // 2
        # OpenCV's transform takes two thirds of the time of numpy's.
        shape = tuple(fast_length(2 * n) for n in here.shape)
        a, b = (cv2.dft(_framed(view, shape)) for view in (here, there))
        norm = float(np.sqrt(np.vdot(here, here) * np.vdot(there, there))) + 1e-30
        straight = cv2.idft(cv2.mulSpectrums(b, a, 0, conjB=True), flags=cv2.DFT_SCALE) / norm
        turned = float(cv2.idft(cv2.mulSpectrums(a, b, 0), flags=cv2.DFT_SCALE).max()) / norm
        straight = np.roll(straight, (side, side), (0, 1))
        lobe = straight[: 2 * side + 1, : 2 * side + 1]
        model = float(lobe.max())
        lobe[:] = -1.0
        row, col = divmod(int(straight.argmax()), straight.shape[1])
        other = float(straight[row, col])
        dy, dx = (step * float((i - side + n // 2) % n - n // 2) for i, n in zip((row, col), shape, strict=True))
        return model, other, (dx, dy), turned


def smaller(view: NDArray[Any], step: int) -> NDArray[Any]:
    """A (H, W) map averaged to samples of `step` px; odd last rows and columns are left out."""
    import cv2

    height, width = view.shape[0] // step, view.shape[1] // step
    return np.asarray(cv2.resize(view[: step * height, : step * width], (width, height), interpolation=cv2.INTER_AREA))


def sampled(view: F32, model: Model, shape: tuple[int, int], stride: int) -> F32:
    """The map `view` of the secondary at the centres of squares of `stride` px of a reference of (H, W).

    Squares that do not fit are left out; the rim of the secondary goes on outside it.
    """
    import cv2

    size = (shape[1] // stride, shape[0] // stride)
    matrix = model.matrix
    if matrix is not None and np.array_equal(matrix[2], [0, 0, 1]) and max(*size, *view.shape) <= MOST_SIDE:
        middle = (stride - 1) / 2
        into = (matrix @ [[stride, 0, middle], [0, stride, middle], [0, 0, 1]])[:2]
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(view, into, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float32)
    across, down = (np.arange(n, dtype=np.float64) * stride + (stride - 1) / 2 for n in size)
    at = model(np.stack(np.meshgrid(across, down), -1).reshape(-1, 2)).reshape(*size[::-1], 2)
    return np.asarray(remapped(view, at, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE), np.float32)


def contrast(view: F32, valid: BoolArray) -> F32:
    """A map less its local mean over the valid samples; 0 elsewhere."""
    import cv2

    if valid.all():
        return np.asarray(view - cv2.GaussianBlur(view, (0, 0), SHADING), np.float32)
    weight = valid.astype(np.float32)
    mean = cv2.GaussianBlur(view * weight, (0, 0), SHADING) / np.maximum(
        cv2.GaussianBlur(weight, (0, 0), SHADING), 1e-6
    )
    return np.asarray((view - mean) * weight, np.float32)


def fast_length(n: int) -> int:
    """The smallest number from n on without a prime factor above 5, of which a transform is quick."""
    while True:
        left = n
        for prime in (2, 3, 5):
            while left % prime == 0:
                left //= prime
        if left == 1:
            return n
        n += 1


def _inside(model: Model, size: tuple[int, int], step: int, shape: tuple[int, int]) -> BoolArray:
    """(h, w) samples of `step` px whose corners a model maps into an image of (H, W)."""
    across, down = (np.arange(n + 1, dtype=np.float64) * step - 0.5 for n in size)
    if model.matrix is not None and np.array_equal(model.matrix[2], [0, 0, 1]):
        # An affine map takes a rectangle into another where it takes the corners there.
        corners = model(np.array([[x, y] for x in across[[0, -1]] for y in down[[0, -1]]]))
        if ((corners >= -0.5 + EDGE_PX) & (corners <= np.array(shape[::-1]) - 0.5 - EDGE_PX)).all():
            return np.ones(size[::-1], np.bool_)
    at = model(np.stack(np.meshgrid(across, down), -1))
    u, v = at[..., 0], at[..., 1]
    good: BoolArray = (u >= -0.5) & (u <= shape[1] - 0.5) & (v >= -0.5) & (v <= shape[0] - 0.5)
    return np.asarray(good[1:, 1:] & good[1:, :-1] & good[:-1, 1:] & good[:-1, :-1])


def _framed(view: F32, shape: tuple[int, ...]) -> F32:
    """A map in the upper left corner of a larger one of zeros."""
    out = np.zeros(shape, np.float32)
    out[: view.shape[0], : view.shape[1]] = view
    return out


def _covered(mask: BoolArray, model: Model, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """(H, W) uint8, 255 for the pixels of the reference that the model maps onto valid ones of the secondary."""
    import cv2

    framed = np.zeros((mask.shape[0] + 2, mask.shape[1] + 2), np.uint8)
    np.multiply(mask, np.uint8(255), out=framed[1:-1, 1:-1])
    matrix = model.matrix
    if matrix is not None and np.array_equal(matrix[2], [0, 0, 1]) and max(*shape, *framed.shape) <= MOST_SIDE:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        into = matrix[:2] + np.array([[0, 0, 1], [0, 0, 1]])
        return np.asarray(cv2.warpAffine(framed, into, shape[::-1], flags=flags), np.uint8)
    x, y = np.meshgrid(np.arange(shape[1], dtype=np.float64), np.arange(shape[0], dtype=np.float64))
    at = (model(np.column_stack([x.ravel(), y.ravel()])) + 1).reshape(*shape, 2)
    return np.asarray(remapped(framed, at, cv2.INTER_LINEAR, cv2.BORDER_CONSTANT), np.uint8)


def _better(found: Peaks, at_model: FloatArray) -> BoolArray:
    """Whether the peak explains a window so much better than the model that it is no accident of noise."""
    left = 1 - np.minimum(found.height, 0.995) ** 2
    return np.asarray((1 - np.maximum(at_model, 0) ** 2) > BETTER * left)


def _neighbours(moved: FloatArray, which: BoolArray, grid: tuple[int, int]) -> IntArray:
    """(N,) how many of the neighbours above, below, left and right are of `which` and move alike."""
    field, there = moved.reshape(*grid, 2), which.reshape(grid)
    count = np.zeros(grid, np.int64)
    for axis in (0, 1):
        alike = np.hypot(*np.moveaxis(np.diff(field, axis=axis), -1, 0)) <= TOGETHER_PX
        first, second = (there.take(range(i, grid[axis] - 1 + i), axis) for i in (0, 1))
        pad = [(0, 0), (0, 0)]
        pad[axis] = (0, 1)
        count += np.pad(alike & second, pad)
        pad[axis] = (1, 0)
        count += np.pad(alike & first, pad)
    return count.ravel()


def _structure(view: F32, square: F32) -> F32:
    """(h, w) correlation of neighbouring samples in the window around each; `square` is that of the view."""
    around = np.pad(view, ((0, 1), (0, 1)), mode="wrap")
    beside = around[:-1, 1:] + around[1:, :-1]
    return np.asarray(_mean(beside * view, HALF) / np.maximum(2 * _mean(square, HALF), 1e-12), np.float32)


def _mean(view: F32, half: int) -> F32:
    """(h, w) mean over the square of 2 * half + 1 samples around each."""
    import cv2

    return np.asarray(cv2.blur(view, (2 * half + 1, 2 * half + 1)), np.float32)
