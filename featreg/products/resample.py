"""The secondary image on the reference grid: ``output[p] = secondary[model(p)]``."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, suggest
from featreg.interfaces import FailedFit, Model
from featreg.io.source import Source
from featreg.io.window import Window
from featreg.products.deramping import Ramp, with_ramp, without_ramp
from featreg.products.lattice import Lattice, lattice_of
from featreg.results.registration import Registration
from featreg.types import BoolArray, FloatArray, Image, read_only

#: Pixels that one output value rests on, along each axis.
TAPS = {"nearest": 1, "bilinear": 2, "cubic": 4, "lanczos": 8}
TILE = 1024

logger = logging.getLogger(__name__)


def resample(
    image: Image,
    model: Callable[[FloatArray], FloatArray],
    shape: tuple[int, int],
    *,
    resampling: str = "lanczos",
    ramp: Ramp | None = None,
) -> Image:
    """Return `image` on another grid.

    Parameters
    ----------
    image : the secondary
    model : maps (N, 2) float64 points (x, y) of the new grid to points of `image`
    shape : (H, W) of the new grid
    resampling : "nearest", "bilinear", "cubic" (4 x 4 pixels) or "lanczos" (8 x 8)
    ramp : phase of complex samples that is taken out for the interpolation and put back, of
        `featreg.products.deramping.ramp_of`

    Returns
    -------
    Image
        (H, W), float32 or complex64 as `image`, without geolocation. A pixel is valid where all pixels of `image` it
        rests on are; at a pixel's centre that is this one alone. Where the model is not finite, pixels are invalid.

    Raises
    ------
    ParameterError
        An unknown resampling, or an impossible shape.
    InputError
        The model does not return as many points as it is given.

    Notes
    -----
    Positions are those of the model to 1e-4 px (0.01 px where it rests on an elevation model), weights are exact to
    4e-7, sums are made in float32. Lanczos is within 0.4 % up to a fifth of the Nyquist frequency and within 3 % up to
    0.7 of it, cubic within 0.5 % and 37 %: lanczos suits speckle and complex samples, cubic suits smooth maps.
    Amplitude is cut at 0, since cubic and lanczos swing below it beside bright points. A model that shrinks the image
    is not low-passed; complex samples with a Doppler centroid or a phase ramp far from 0 need `ramp`.

    References
    ----------
    R. G. Keys, Cubic convolution interpolation for digital image processing, IEEE Trans. ASSP, 1981,
    doi:10.1109/TASSP.1981.1163711
    """
    if resampling not in TAPS:
        raise ParameterError(f"unknown resampling '{resampling}', {suggest(resampling, TAPS)}")
    height, width = (int(n) for n in shape)
    if height < 1 or width < 1:
        raise ParameterError(f"shape must be (H, W) of at least 1 x 1, got {shape}")
    pixels: NDArray[Any] = np.empty((height, width), image.pixels.dtype)
    mask = np.empty((height, width), np.bool_)
    flat = image.pixels if ramp is None else without_ramp(image.pixels, ramp, 0, 0)
    whole = Support(flat, image.mask, resampling)
    for rows, cols in tiles(height, width):
        size = rows.stop - rows.start, cols.stop - cols.start
        lattice = lattice_of(model, cols.start, rows.start, size)
        values, good = whole.sample(lattice)
        if ramp is not None:
            values, good = with_ramp(values, good, ramp, lattice, TAPS[resampling] // 2)
        pixels[rows, cols], mask[rows, cols] = values, good
    if not image.is_complex:
        np.maximum(pixels, 0, out=pixels)
    # Interpolated 8-bit samples are no longer 8-bit: they swing beyond 255.
    dtype = image.source_dtype if resampling == "nearest" else str(pixels.dtype)
    return Image(read_only(pixels), read_only(mask), None, image.name, dtype, image.scale)


def resampled_window(
    source: Source, model: Callable[[FloatArray], FloatArray], window: Window, resampling: str
) -> tuple[NDArray[Any], BoolArray]:
    """Return a window of what `resample` makes of a whole image, from as much of a source as it rests on.

    Returns
    -------
    (h, w) float32 or complex64, and which of them are data
    """
    lattice = lattice_of(model, window.x, window.y, window.shape)
    box = support_box(lattice, source.shape, resampling)
    if box is None:
        kind = np.complex64 if source.is_complex else np.float32
        return np.zeros(lattice.shape, kind), np.zeros(lattice.shape, np.bool_)
    image = source.read(box)
    values, mask = Support(image.pixels, image.mask, resampling).sample(lattice.moved(-box.x, -box.y))
    return (values if source.is_complex else np.maximum(values, 0)), mask


class Support:
    """An image made ready for `sample`.

    Parameters
    ----------
    pixels : (H, W) float32 or complex64, finite
    mask : (H, W) bool, True = data
    resampling : a key of `TAPS`
    """

    def __init__(self, pixels: NDArray[Any], mask: BoolArray, resampling: str) -> None:
        from featreg.products.resample_kernels import weight_table

        self.taps = TAPS[resampling]
        self.channels = 2 if np.iscomplexobj(pixels) else 1
        self.dtype = pixels.dtype
        self.flat = np.ascontiguousarray(pixels).view(np.float32).ravel()
        self.mask = np.ascontiguousarray(mask)
        self.inner = _inner(self.mask, self.taps)
        self.table = weight_table(max(self.taps, 2))

    def sample(self, lattice: Lattice) -> tuple[NDArray[Any], BoolArray]:
        """Return the samples (h, w) at the positions of a lattice, 0 where they are not valid, and their mask."""
        from featreg.products.resample_kernels import interpolate

        values = np.empty((*lattice.shape, self.channels), np.float32)
        valid = np.empty(lattice.shape, np.bool_)
        x, y, step = lattice.x, lattice.y, lattice.step
        interpolate(self.flat, self.mask, self.inner, x, y, step, self.table, self.taps, self.channels, values, valid)
        return values.view(self.dtype)[..., 0], valid


def _inner(mask: BoolArray, taps: int) -> BoolArray:
    """Return where all of the `taps` x `taps` pixels around a position just right of and below a pixel are data."""
    import cv2

    if taps == 1:
        return mask
    before = taps // 2 - 1
    eroded = cv2.erode(
        mask.view(np.uint8),
        np.ones((taps, taps), np.uint8),
        anchor=(before, before),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=(0,),
    )
    return np.asarray(eroded).view(np.bool_)


def support_box(lattice: Lattice, shape: tuple[int, int], resampling: str) -> Window | None:
    """Return the pixels of an image of (H, W) on which the positions of a lattice rest; None where there are none."""
    bounds = lattice.bounds()
    if bounds is None:
        return None
    margin = TAPS[resampling] // 2 + 1
    left, top = (int(np.floor(np.clip(b, -1e9, 1e9))) - margin for b in bounds[:2])
    right, bottom = (int(np.ceil(np.clip(b, -1e9, 1e9))) + margin for b in bounds[2:])
    return Window(left, top, right - left + 1, bottom - top + 1).within(shape)


def tiles(height: int, width: int) -> Iterator[tuple[slice, slice]]:
    """Cut a grid so that the positions of one tile, not of a whole scene, are in memory."""
    for top in range(0, height, TILE):
        for left in range(0, width, TILE):
            yield slice(top, min(top + TILE, height)), slice(left, min(left + TILE, width))


def model_of(registration: Registration) -> Model:
    """Return the model of a registration, with a logged warning where it is not trusted.

    Raises
    ------
    InputError
        There is none.
    """
    model = registration.model
    if isinstance(model, FailedFit):
        raise InputError(f"the registration has no model ({model.reason}), so nothing can be warped")
    if registration.status != "ok":
        logger.warning(
            "the registration is %s (%s), warping with its best model", registration.status, registration.reason
        )
    return model


def stated_shape(like: tuple[int, ...]) -> tuple[int, int]:
    """Return (H, W) as a caller stated it; an `InputError` where it is none."""
    if len(like) != 2 or not all(isinstance(n, int | np.integer) and n > 0 for n in like):
        raise InputError(f"like must be the reference image or its (H, W), got {like}")
    return int(like[0]), int(like[1])
