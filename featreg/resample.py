"""The secondary image on the reference grid: ``output[p] = secondary[model(p)]``."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, suggest
from featreg.interfaces import FailedFit
from featreg.io import ImageLike, as_image
from featreg.types import FloatArray, Image, Registration

#: Pixels that one output value rests on, along each axis.
TAPS = {"nearest": 1, "bilinear": 2, "cubic": 4, "lanczos": 8}
TILE = 1024

logger = logging.getLogger(__name__)


def resample(
    image: Image, model: Callable[[FloatArray], FloatArray], shape: tuple[int, int], *, resampling: str = "lanczos"
) -> Image:
    """Return `image` on another grid.

    Parameters
    ----------
    image : the secondary
    model : maps (N, 2) float64 points (x, y) of the new grid to points of `image`
    shape : (H, W) of the new grid
    resampling : "nearest", "bilinear", "cubic" (4 x 4 pixels) or "lanczos" (8 x 8)

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
    Positions are exact (not rounded to a table), sums are made in float64. Lanczos is within 0.4 % up to a fifth of the
    Nyquist frequency and within 3 % up to 0.7 of it, cubic within 0.5 % and 37 %: lanczos suits speckle and complex
    samples, cubic suits smooth maps. Amplitude is cut at 0, since cubic and
    lanczos swing below it beside bright points. A model that shrinks the image is not low-passed; complex samples with
    a Doppler centroid or a phase ramp far from 0 need them removed before.

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
    from featreg.resample_kernels import interpolate

    pixels: NDArray[Any] = np.empty((height, width), image.pixels.dtype)
    source: NDArray[Any] = np.ascontiguousarray(image.pixels)
    known = np.ascontiguousarray(image.mask)
    mask = np.empty((height, width), np.bool_)
    zero = np.complex128(0) if image.is_complex else np.float64(0)
    for rows, cols in _tiles(height, width):
        xy = _mapped(model, rows, cols)
        values, valid = np.empty(len(xy), pixels.dtype), np.empty(len(xy), np.bool_)
        interpolate(source, known, image.all_valid, xy, TAPS[resampling], zero, values, valid)
        size = rows.stop - rows.start, cols.stop - cols.start
        pixels[rows, cols] = values.reshape(size)
        mask[rows, cols] = valid.reshape(size)
    if not image.is_complex:
        np.maximum(pixels, 0, out=pixels)
    # Interpolated 8-bit samples are no longer 8-bit: they swing beyond 255.
    dtype = image.source_dtype if resampling == "nearest" else str(pixels.dtype)
    return Image(pixels, mask, None, image.name, dtype, image.scale)


def _tiles(height: int, width: int) -> Iterator[tuple[slice, slice]]:
    """Cut the grid so that the positions of one tile, not of a whole scene, are in memory."""
    for top in range(0, height, TILE):
        for left in range(0, width, TILE):
            yield slice(top, min(top + TILE, height)), slice(left, min(left + TILE, width))


def _mapped(model: Callable[[FloatArray], FloatArray], rows: slice, cols: slice) -> FloatArray:
    """Return where the pixels of a tile lie in the secondary, (N, 2), row by row."""
    y, x = np.mgrid[rows, cols]
    given = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    xy = np.ascontiguousarray(model(given), dtype=np.float64)
    if xy.shape != given.shape:
        raise InputError(f"the model must return (N, 2) points for (N, 2) points, got {xy.shape} for {given.shape}")
    return xy


def warp(
    registration: Registration,
    secondary: ImageLike,
    *,
    like: ImageLike | tuple[int, int] | None = None,
    resampling: str = "lanczos",
) -> NDArray[np.float32] | NDArray[np.complex64]:
    """Return the secondary image on the reference grid.

    Parameters
    ----------
    registration : the result of `featreg.match`; its model is used even when it is not trusted (a warning is logged)
    secondary : path, 2-D array or `Image`, of the same grid as the secondary that was matched
    like : the reference (path, array or `Image`) or its (H, W), where the registration does not name its size
    resampling : "nearest", "bilinear", "cubic" or "lanczos"

    Returns
    -------
    (H, W) float32 linear amplitude, whatever scale the file has, or complex64; NaN (complex: nan+nanj) where the
    secondary has no data

    Raises
    ------
    InputError
        There is no model, the reference's size is not known, or the secondary cannot be used.
    ParameterError
        An unknown resampling.
    """
    model = registration.model
    if isinstance(model, FailedFit):
        raise InputError(f"the registration has no model ({model.reason}), so nothing can be warped")
    if registration.status != "ok":
        logger.warning(
            "the registration is %s (%s), warping with its best model", registration.status, registration.reason
        )
    image = as_image(secondary)
    warped = resample(image, model, _reference_shape(registration, like), resampling=resampling)
    blank = np.complex64(complex(np.nan, np.nan)) if image.is_complex else np.float32(np.nan)
    return np.where(warped.mask, warped.pixels, blank)


def _reference_shape(registration: Registration, like: ImageLike | tuple[int, int] | None) -> tuple[int, int]:
    if isinstance(like, tuple):
        if len(like) != 2 or not all(isinstance(n, int | np.integer) and n > 0 for n in like):
            raise InputError(f"like must be the reference image or its (H, W), got {like}")
        return int(like[0]), int(like[1])
    if isinstance(like, Image):
        return like.shape
    if isinstance(like, str | Path):
        return as_image(like).shape
    if like is not None:
        shape = np.shape(like)
        if len(shape) != 2:
            raise InputError(f"like must be the reference image or its (H, W), got an array of shape {shape}")
        return shape[0], shape[1]
    try:
        reference = registration.provenance["inputs"]["reference"]
        return int(reference["height"]), int(reference["width"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("the registration does not say the reference's size; give it as like=(H, W)") from error
