"""Whether the images themselves agree with a model: everywhere, by no second motion, and by no other model as well.

The secondary is sampled by the model on the reference's grid, a quarter of its size, and both are compared: window by
window over shifts of up to 24 px, and as a whole over all shifts and half a turn. Nothing here depends on tie points,
so it sees what filters and refinement have dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.geometry.robust import KINDS, MEDIAN_LENGTH, TUKEY
from featreg.interfaces import Model
from featreg.pipeline.compared_views import contrasts, mapped, sampled, smaller, usable, view_of
from featreg.runtime.threads import side_by_side
from featreg.sar.correlation import Peaks, local_correlations, peaks
from featreg.types import BoolArray, FloatArray, Image, IntArray

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

#: The images are compared by samples of 4 px a side, of 2 px where one is shorter than SHORT px.
STEP, SHORT = 4, 240
#: Half of a window, largest shift looked for, in samples, and most windows along each side of the image; they lie at
#: least half a window apart.
HALF, SEARCH, SIDE = 8, 6, 12
#: Least correlation of a window that speaks for the model, and of one that speaks against it.
FOR, AGAINST = 0.4, 0.5
#: A window speaks against the model where its peak lies farther away than this, px, and explains so many times better.
FAR_PX, BETTER = 1.75, 1.15
#: Displacements of neighbouring windows that move together differ by less than this, px.
TOGETHER_PX = 2.5
#: Fewest windows by which a drift is told, displacements from their common field that are not told apart, px, and the
#: rounds of its robust fit.
LEAST_DRIFT, DRIFT_SCALE_PX, DRIFT_ROUNDS = 8, 2.0, 10
#: Along each axis, how far a refinement may have moved what it was given, px: so many models it chose from.
CHOSEN_PX = 6.0
#: Shifts of the whole image within this many samples of none belong to the peak of the model itself.
LOBE = 4
#: Images of more samples a side are correlated as a whole by samples of twice the side.
MOST_WHOLE = 600
#: Fewest windows with something to say, and least share of those that both images hold.
LEAST_WINDOWS, LEAST_SPEAKING = 12, 1 / 3
#: Structure is looked at around every so many samples.
EVERY = 2
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
        from featreg.pipeline import trust_kernels as kernels

        here = self.xy[self.peaked]
        if len(here) < LEAST_DRIFT:
            return None
        found = kernels.beyond(
            KINDS[Affine], Affine.minimum, here, here + self.moved[self.peaked], TUKEY / MEDIAN_LENGTH,
            DRIFT_SCALE_PX * MEDIAN_LENGTH, DRIFT_ROUNDS, here, here, np.empty(len(here)),
        )  # fmt: skip
        return found if found >= 0 else None

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
        step = STEP if min(reference.shape) >= SHORT else STEP // 2
        size = (reference.shape[1] // step, reference.shape[0] // step)
        if min(size) < 2 * (HALF + SEARCH + 1) + 4 or min(secondary.shape) < 2 * step:
            return None
        nodes, zoom = mapped(model, size, step)
        unit = step // 2
        views = side_by_side(
            [partial(view_of, reference, unit, 1.0), partial(view_of, secondary, unit, zoom)], reference.pixels.size
        )
        there, valid = sampled(secondary, views[1], nodes, zoom, size, step, usable(reference, without), without)
        if np.count_nonzero(valid) < (2 * HALF + 1) ** 2:
            return None
        here = views[0].pixels[1::2, 1::2][: size[1], : size[0]]
        return cls(*contrasts(here, there, valid), valid, step)

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
        correlations = self._correlations(gx, gy, at)
        found = peaks(correlations)
        at_model = np.maximum(correlations[:, SEARCH, SEARCH], -1.0)
        counts = cv2.integral(self.valid.view(np.uint8))
        (x0, y0), (x1, y1) = (at - HALF).T, (at + HALF + 1).T
        inside = counts[y1, x1] - counts[y0, x1] - counts[y1, x0] + counts[y0, x0] > 0.9 * (2 * HALF + 1) ** 2
        moved = self.step * found.shift
        speaks = inside & found.sound & (found.height >= FOR)
        far = np.hypot(*moved.T) > FAR_PX
        contradict = speaks & far & (found.height >= AGAINST) & _better(found, at_model)
        if contradict.any():
            contradict &= _neighbours(moved, contradict, grid) >= 1
        xy = (at.astype(np.float64) + 0.5) * self.step - 0.5
        peaked = inside & found.sound & (found.height >= AGAINST)
        return Windows(
            xy, moved, at_model, found.height, speaks & ~far, contradict, inside, peaked,
            (HALF + 0.5) * self.step,
        )  # fmt: skip

    def _correlations(self, gx: IntArray, gy: IntArray, at: IntArray) -> FloatArray:
        """Those of the windows around (N, 2) points, which are a grid of columns and rows, for every shift."""
        from featreg.pipeline import agreement_kernels as kernels

        # What lies between windows that are far apart need not be summed.
        if max(np.diff(gx).max(initial=0), np.diff(gy).max(initial=0)) > 2 * HALF:
            return local_correlations(self.here, self.there, at, HALF, SEARCH)
        found = np.empty((len(at), 2 * SEARCH + 1, 2 * SEARCH + 1))
        kernels.grid_correlations(
            self.here.ravel(), self.there.ravel(), self.here.shape[1], gx, gy, HALF, SEARCH, found
        )
        return found

    @cached_property
    def elsewhere(self) -> float | None:
        """Mean correlation at the model of the half of the structured samples around which the images agree least.

        Over squares of 36 px. None where less than a tenth of the samples that both images hold has structure.
        """
        from featreg.pipeline import agreement_kernels as kernels

        valid = self.valid[::EVERY, ::EVERY]
        local, structure = np.empty(valid.shape, np.float32), np.empty(valid.shape, np.float32)
        kernels.likenesses(self.here, self.there, HALF // 2, HALF, EVERY, local, structure)
        structured = valid & (structure >= STRUCTURE)
        if np.count_nonzero(structured) < 0.1 * np.count_nonzero(valid):
            return None
        alike = local[structured]
        half = len(alike) // 2
        return float(np.partition(alike, half)[: half + 1].mean(dtype=np.float64))

    @cached_property
    def whole(self) -> tuple[float, float, tuple[float, float], float]:
        """Correlation of the whole images, of large ones by samples of twice the side.

        Returns
        -------
        model, other, shift, turned : correlation coefficient at the model, the highest at any other shift, that shift
            (dx, dy) in px, and the highest after half a turn

        Notes
        -----
        Shifts by which less than a quarter of an image's side is left in common add to others, by which a quarter to a
        half is: the sums of either are small.
        """
        import cv2

        here, there, step, side = self.here, self.there, self.step, LOBE
        if max(here.shape) > MOST_WHOLE:
            here, there, step, side = smaller(here, 2), smaller(there, 2), 2 * step, side // 2
        # OpenCV's transform takes two thirds of the time of numpy's.
        shape = tuple(fast_length(n + n // 2) for n in here.shape)
        a, b = side_by_side([partial(_spectrum, view, shape) for view in (here, there)], 4 * here.size)
        norm = float(np.sqrt(np.vdot(here, here) * np.vdot(there, there))) + 1e-30
        straight, turned_over = side_by_side(
            [partial(_product, b, a, True), partial(_product, a, b, False)], 4 * here.size
        )
        turned = cv2.minMaxLoc(turned_over)[1] / norm
        model = -math.inf
        for rows in (slice(0, side + 1), slice(-side, None)):
            for columns in (slice(0, side + 1), slice(-side, None)):
                lobe = straight[rows, columns]
                model = max(model, float(lobe.max()))
                lobe[:] = -math.inf
        _, other, _, place = cv2.minMaxLoc(straight)
        dx, dy = (step * float((i + n // 2) % n - n // 2) for i, n in zip(place, shape[::-1], strict=True))
        return model / norm, other / norm, (dx, dy), turned


def fast_length(n: int) -> int:
    """The smallest multiple of 8 from n on without a prime factor above 5, of which a transform is quick.

    OpenCV's transform of 225 x 225 samples takes 1.6 times as long as that of 240 x 240.
    """
    n = -(-n // 8) * 8
    while True:
        left = n
        for prime in (2, 3, 5):
            while left % prime == 0:
                left //= prime
        if left == 1:
            return n
        n += 8


def _product(first: F32, second: F32, conjugate: bool) -> F32:
    """What two spectra are multiplied, the second conjugate for a correlation."""
    import cv2

    return np.asarray(cv2.idft(cv2.mulSpectrums(first, second, 0, conjB=conjugate), flags=cv2.DFT_SCALE), np.float32)


def _spectrum(view: F32, shape: tuple[int, ...]) -> F32:
    """The transform of a map in the upper left corner of a larger one of zeros."""
    import cv2

    out = np.zeros(shape, np.float32)
    out[: view.shape[0], : view.shape[1]] = view
    return np.asarray(cv2.dft(out), np.float32)


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
