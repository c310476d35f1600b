"""Two images as they are compared under a model: their logarithms in small samples, on the reference's grid."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from featreg.interfaces import Model
from featreg.runtime.threads import in_parts
from featreg.sar.filtered_rows import filtered_rows
from featreg.sar.speckle import filled_amplitude, log_amplitude, log_floor
from featreg.types import BoolArray, FloatArray, Image
from featreg.types.arrays import middle

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

#: Contrasts are logarithms less a Gaussian mean of so many samples; OpenCV's of float maps reaches to four standard
#: deviations.
SHADING, SHADING_REACH = 3.0, 12
#: Standard deviation of the Gaussian by which speckle is reduced, px, and most px of the secondary that a sample shows.
SMOOTHING, WIDEST = 1.0, 12
#: Between every so many samples along x and y a model is taken as bilinear.
APART = 8
#: Up to so many px around a pixel that are looked at one by one for invalid ones.
FAR_REACH = 8
#: Farther than any pixel, px; there lies what a model does not know.
NOWHERE_PX = 1e7


class View(NamedTuple):
    """The logarithm of an image, smoothed; its sample at x * scale + offset is the mean around the pixel x."""

    pixels: F32
    scale: float
    offset: float


def view_of(image: Image, unit: int, zoom: float) -> View:
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


def mapped(model: Model, size: tuple[int, int], step: int) -> tuple[FloatArray, float]:
    """Where a model maps the middles of every `APART`-th sample and of one more, (ny, nx, 2) px, and its median zoom.

    Far outside where it does not know.
    """
    across, down = ((np.arange(-(-n // APART) + 1) * APART + 0.5) * step - 0.5 for n in size)
    nodes = model(np.stack(np.meshgrid(across, down), -1).reshape(-1, 2)).reshape(len(down), len(across), 2)
    nodes = np.where(np.isfinite(nodes), np.clip(nodes, -NOWHERE_PX, NOWHERE_PX), -NOWHERE_PX)
    along, below = (np.diff(nodes, axis=axis) for axis in (1, 0))
    area = along[:-1, :, 0] * below[:, :-1, 1] - along[:-1, :, 1] * below[:, :-1, 0]
    return nodes, math.sqrt(middle(np.abs(area).ravel())) / (APART * step)


def usable(image: Image, without: BoolArray | None) -> U8:
    """(H, W) 1 for valid pixels but those `without`; of no size where all are."""
    if without is not None:
        return np.asarray(image.mask & ~without).view(np.uint8)
    return np.empty((0, 0), np.uint8) if image.all_valid else image.mask.view(np.uint8)


def sampled(
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

    second_mask = usable(secondary, without)
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

    # A sample takes as long as sixteen pixels of a light pass.
    in_parts(part, len(out), 16 * out.shape[1])
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
    first, second = np.empty(here.shape, np.float32), np.empty(here.shape, np.float32)

    def part(top: int, bottom: int) -> None:
        above = max(top - SHADING_REACH, 0)
        rows = slice(above, min(bottom + SHADING_REACH, height))
        inner = slice(top - above, bottom - above)
        if not whole:
            weight = valid[rows].astype(np.float32)
            per = weight[inner] / np.maximum(cv2.GaussianBlur(weight, (0, 0), SHADING)[inner], 1e-6)
        for view, out in ((here, first), (there, second)):
            shown = np.ascontiguousarray(view[rows]) if whole else view[rows] * weight
            mean = cv2.GaussianBlur(shown, (0, 0), SHADING)[inner]
            out[top:bottom] = shown[inner] - (mean if whole else mean * per)

    # The rows around a part that are looked at too make more than a few of them dear.
    in_parts(part, height, 4 * here.shape[1])
    return first, second
