"""Which pixels are data: masks from arrays, mask files and polygons."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError
from featreg.io.arrays import is_array, plain_array
from featreg.io.nodata import holds_nodata
from featreg.io.opening import read_raster
from featreg.types import BoolArray, FloatArray

MaskLike = str | Path | NDArray[Any] | Sequence[ArrayLike]


def as_mask(mask: MaskLike, shape: tuple[int, int], name: str) -> BoolArray:
    """Return a new (H, W) bool mask, True = valid.

    Parameters
    ----------
    mask : (H, W) bool or numbers (non-zero = valid, NaN and what the array itself holds for masked = invalid), an array
        of numpy, dask, xarray or pandas or a picture of Pillow; the path of such an image, or one polygon or a list
        of polygons, each (K, 2) of (x, y) in pixels; see `inside_polygons`
    shape : (H, W) of the image
    name : what the image is called in messages

    Raises
    ------
    InputError
        Another size than the image, or neither a mask nor polygons.
    """
    if isinstance(mask, str | Path):
        raster = read_raster(mask)
        valid = _nonzero(raster.samples, shape, f"mask {mask} of {name}")
        hole = holds_nodata(raster.samples, raster.nodata)
        for more in (raster.mask, None if hole is None else ~hole):
            if more is not None:
                valid &= more
        return valid
    if is_array(mask):
        samples, shown = plain_array(mask)
        if samples.ndim == 2 and (samples.shape == shape or samples.shape[1] != 2):
            valid = _nonzero(samples, shape, f"mask of {name}")
            return valid if shown is None else valid & shown
        mask = samples
    return inside_polygons(polygons_of(mask, name), shape)


def _nonzero(samples: NDArray[Any], shape: tuple[int, int], what: str) -> BoolArray:
    if samples.dtype.kind not in "buifc":
        raise InputError(f"{what}: holds {samples.dtype} values; bool or numbers are needed (non-zero = valid)")
    if samples.shape != shape:
        given = " x ".join(map(str, samples.shape[::-1]))
        raise InputError(f"{what}: is {given} pixels (width x height), the image is {shape[1]} x {shape[0]}")
    valid = samples != 0
    if samples.dtype.kind in "fc":
        valid &= ~np.isnan(samples)
    return np.asarray(valid)


def polygons_of(mask: Any, name: str) -> list[FloatArray]:
    """Return one polygon or a list of them as a list of (K, 2) float64; an `InputError` where it is neither."""
    wanted = "a mask is an (H, W) array, a file, a (K, 2) polygon of (x, y) with K >= 3, or a list of polygons"
    try:
        single = np.ndim(mask[0]) == 1
        polygons = [np.asarray(p, dtype=np.float64) for p in ([mask] if single else mask)]
    except (TypeError, ValueError, IndexError, KeyError) as error:
        raise InputError(f"mask of {name}: cannot use {type(mask).__name__}; {wanted}") from error
    for polygon in polygons:
        if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3 or not np.isfinite(polygon).all():
            raise InputError(f"mask of {name}: cannot use a polygon of shape {polygon.shape}; {wanted}, all finite")
    return polygons


def inside_polygons(polygons: Sequence[FloatArray], shape: tuple[int, int]) -> BoolArray:
    """Return an (H, W) bool array: True where the centre of a pixel lies inside any polygon (even-odd rule).

    A centre exactly on a left or upper edge is inside, on a right or lower edge outside, so that polygons which share
    an edge share no pixel.
    """
    height, width = shape
    inside = np.zeros(shape, np.bool_)
    for polygon in polygons:
        # Each edge flips, in every row it crosses, all pixels from its crossing to the right.
        flips = np.zeros((height, width + 1), np.uint8)
        for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            first, last = np.clip(np.ceil([min(y0, y1), max(y0, y1)]), 0, height).astype(int)
            rows = np.arange(first, last)
            if len(rows):
                crossing = np.ceil(x0 + (rows - y0) * ((x1 - x0) / (y1 - y0)))
                flips[rows, np.clip(crossing, 0, width).astype(int)] ^= 1
        inside |= np.bitwise_xor.accumulate(flips, axis=1)[:, :width].astype(np.bool_)
    return inside
