"""Whether the images themselves agree with a model: everywhere, by no second motion, and by no other model as well.

The secondary is sampled by the model on the reference's grid, a quarter of its size, and both are compared: window by
window over shifts of up to 24 px, and as a whole over all shifts and half a turn. Nothing here depends on tie points,
so it sees what filters and refinement have dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.geometry.robust import KINDS, MEDIAN_LENGTH, TUKEY
from featreg.interfaces import Model
from featreg.runtime.threads import in_parts, side_by_side
from featreg.sar.correlation import Peaks, local_correlations, peaks
from featreg.sar.filtered_rows import filtered_rows
from featreg.sar.speckle import filled_amplitude, log_amplitude, log_floor
from featreg.types import BoolArray, FloatArray, Image, IntArray
from featreg.types.arrays import middle

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

#: The images are compared by samples of 4 px a side, of 2 px where one is shorter than SHORT px, less a Gaussian mean
#: of SHADING samples.
STEP, SHORT, SHADING = 4, 240, 3.0
#: OpenCV's Gaussian of float maps reaches to four standard deviations.
SHADING_REACH = 12
#: Standard deviation of the Gaussian by which speckle is reduced, px, and most px of the secondary that a sample shows.
SMOOTHING, WIDEST = 1.0, 12
#: Between every so many samples along x and y a model is taken as bilinear.
APART = 8
#: Up to so many px around a pixel that are looked at one by one for invalid ones.
FAR_REACH = 8
#: Farther than any pixel, px; there lies what a model does not know.
NOWHERE_PX = 1e7
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
        nodes, zoom = _mapped(model, size, step)
        unit = step // 2
        views = _view(reference, unit, 1.0), _view(secondary, unit, zoom)
        there, valid = _sampled(secondary, views[1], nodes, zoom, size, step, _usable(reference, without), without)
        if np.count_nonzero(valid) < (2 * HALF + 1) ** 2:
            return None
        here = np.ascontiguousarray(views[0].pixels[1::2, 1::2][: size[1], : size[0]])
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


class View(NamedTuple):
    """The logarithm of an image, smoothed; its sample at x * scale + offset is the mean around the pixel x."""

    pixels: F32
    scale: float
    offset: float


def _view(image: Image, unit: int, zoom: float) -> View:
    """An image by samples of `unit` px, 1 or 2: the mean over 2 * unit * zoom px, beside what reduces speckle."""
    import cv2

    from featreg.pipeline import agreement_kernels as kernels

    if unit == 1:
        logs = log_amplitude(image)
    else:
        logs = np.empty((image.shape[0] // 2, image.shape[1] // 2), np.float32)
        amplitude, floor = np.ascontiguousarray(filled_amplitude(image)), log_floor(image)

        def part(first: int, stop: int) -> None:
            kernels.halved_logarithms(amplitude[2 * first : 2 * stop], floor, logs[first:stop])

        in_parts(part, len(logs), image.shape[1])
    wide = max(1, min(round(2 * zoom), WIDEST // unit))
    reach = math.ceil(2 * SMOOTHING / unit)
    gaussian = cv2.getGaussianKernel(2 * reach + 1, SMOOTHING / unit).ravel()
    taps = np.convolve(gaussian, np.full(wide, 1 / wide)).astype(np.float32)
    # The middle of an even number of taps lies half a sample before that which OpenCV takes.
    return View(
        filtered_rows(lambda rows: cv2.sepFilter2D(rows, -1, taps, taps), logs, len(taps)),
        1 / unit,
        0.5 / unit - 0.5 + (0.5 if wide % 2 == 0 else 0.0),
    )


def _mapped(model: Model, size: tuple[int, int], step: int) -> tuple[FloatArray, float]:
    """Where a model maps the middles of every `APART`-th sample and of one more, (ny, nx, 2) px, and its median zoom.

    Far outside where it does not know.
    """
    across, down = ((np.arange(-(-n // APART) + 1) * APART + 0.5) * step - 0.5 for n in size)
    nodes = model(np.stack(np.meshgrid(across, down), -1).reshape(-1, 2)).reshape(len(down), len(across), 2)
    nodes = np.where(np.isfinite(nodes), np.clip(nodes, -NOWHERE_PX, NOWHERE_PX), -NOWHERE_PX)
    along, below = (np.diff(nodes, axis=axis) for axis in (1, 0))
    area = along[:-1, :, 0] * below[:, :-1, 1] - along[:-1, :, 1] * below[:, :-1, 0]
    return nodes, math.sqrt(middle(np.abs(area).ravel())) / (APART * step)


def _usable(image: Image, without: BoolArray | None) -> U8:
    """(H, W) 1 for valid pixels but those `without`; of no size where all are."""
    if without is not None:
        return np.asarray(image.mask & ~without).view(np.uint8)
    return np.empty((0, 0), np.uint8) if image.all_valid else image.mask.view(np.uint8)


def _sampled(
    secondary: Image,
    view: View,
    nodes: FloatArray,
    zoom: float,
    size: tuple[int, int],
    step: int,
    first_mask: U8,
    without: BoolArray | None,
) -> tuple[F32, BoolArray]:
    """A view of the secondary at the samples of the reference, and which of these are valid in both."""
    import cv2

    from featreg.pipeline import agreement_kernels as kernels

    second_mask = _usable(secondary, without)
    reach = max(1, math.ceil(step / 2 * zoom))
    if second_mask.size and reach > FAR_REACH:
        # A model gone wrong may zoom by anything: along one axis after the other, and no farther than the image.
        side = 2 * min(reach, max(second_mask.shape)) + 1
        for shape in ((1, side), (side, 1)):
            second_mask = np.asarray(cv2.erode(second_mask, np.ones(shape, np.uint8)), np.uint8)
        reach = 0
    out, valid = np.empty(size[::-1], np.float32), np.empty(size[::-1], np.bool_)
    tall, wide = view.pixels.shape
    tiles = np.ones(tuple(-(-n // kernels.TILE) for n in second_mask.shape), np.uint8)
    kernels.clear_tiles(second_mask, tiles)
    pixels, sides = view.pixels.ravel(), np.array(secondary.shape)

    def part(first: int, stop: int) -> None:
        kernels.sampled(
            pixels, tall, wide, view.scale, view.offset, nodes, APART, step, first_mask, second_mask, tiles, reach,
            sides, first, stop, out, valid,
        )  # fmt: skip

    in_parts(part, *out.shape)
    return out, valid


def smaller(view: NDArray[Any], step: int) -> NDArray[Any]:
    """A (H, W) map averaged to samples of `step` px; odd last rows and columns are left out."""
    import cv2

    height, width = view.shape[0] // step, view.shape[1] // step
    return np.asarray(cv2.resize(view[: step * height, : step * width], (width, height), interpolation=cv2.INTER_AREA))


def contrasts(here: F32, there: F32, valid: BoolArray) -> tuple[F32, F32]:
    """Two maps less their local means over the valid samples; 0 elsewhere."""
    import cv2

    whole, height = bool(valid.all()), here.shape[0]
    first, second = np.empty_like(here), np.empty_like(there)

    def part(top: int, bottom: int) -> None:
        above = max(top - SHADING_REACH, 0)
        rows = slice(above, min(bottom + SHADING_REACH, height))
        inner = slice(top - above, bottom - above)
        if not whole:
            weight = valid[rows].astype(np.float32)
            per = weight[inner] / np.maximum(cv2.GaussianBlur(weight, (0, 0), SHADING)[inner], 1e-6)
        for view, out in ((here, first), (there, second)):
            shown = view[rows] if whole else view[rows] * weight
            mean = cv2.GaussianBlur(shown, (0, 0), SHADING)[inner]
            out[top:bottom] = shown[inner] - (mean if whole else mean * per)

    in_parts(part, *here.shape)
    return first, second


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
