"""Products as DataArrays of xarray: values with the coordinates and the place of the grid they lie on."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.io.data_arrays import DataArrayReader, is_data_array
from featreg.io.images import as_image
from featreg.io.raster_source import Source, Window, open_source
from featreg.products.resample import TILE, resample, resampled_window
from featreg.types import BoolArray, FloatArray, Geolocation

#: The coordinate that holds the place, as rioxarray and the CF conventions have it.
SYSTEM = "spatial_ref"


def to_data_array(
    values: NDArray[Any] | Any,
    geolocation: Geolocation | None,
    *,
    like: Any = None,
    name: str | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> Any:
    """Return an `xarray.DataArray` of values (H, W) of numpy or dask.

    Parameters
    ----------
    values : NaN where there is no data
    geolocation : where they lie
    like : a DataArray on the same grid, whose dimensions and coordinates the result gets, to the last bit; without one
        they follow from the geotransform, as rioxarray computes them
    name, attributes : of the result
    """
    xarray = sys.modules["xarray"]
    dims, coords = ("y", "x"), {}
    if is_data_array(like):
        reader = DataArrayReader(like)
        dims = (reader.rows, reader.columns)
        coords = {dim: reader.array.coords[dim] for dim in dims if dim in reader.array.coords}
    elif geolocation is not None and geolocation.transform is not None:
        a, b, c, d, e, f = geolocation.transform
        if b == d == 0:
            coords = {
                "y": np.arange(values.shape[0]) * e + (e * 0.5 + f),
                "x": np.arange(values.shape[1]) * a + (a * 0.5 + c),
            }
    if geolocation is not None:
        coords[SYSTEM] = xarray.Variable((), np.int64(0), _place(geolocation))
    facts = {**(attributes or {}), "_FillValue": np.asarray(np.nan, values.dtype)[()]}
    made = xarray.DataArray(values, dims=dims, coords=coords, name=name, attrs=facts)
    if geolocation is not None:
        made.encoding["grid_mapping"] = SYSTEM
    return made


def _place(geolocation: Geolocation) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if geolocation.crs:
        found = {"crs_wkt": geolocation.crs, "spatial_ref": geolocation.crs}
    if geolocation.transform is not None:
        a, b, c, d, e, f = geolocation.transform
        found["GeoTransform"] = " ".join(map(repr, (c, a, b, f, d, e)))
    elif geolocation.gcps is not None:
        features = [
            {
                "type": "Feature",
                "properties": {"id": str(k), "info": "", "row": y + 0.5, "col": x + 0.5},
                "geometry": {"type": "Point", "coordinates": [e, n, z]},
            }
            for k, (x, y, e, n, z) in enumerate(geolocation.gcps.tolist(), 1)
        ]
        found["gcps"] = json.dumps({"type": "FeatureCollection", "features": features})
    return found


def warped_data_array(
    model: Callable[[FloatArray], FloatArray],
    array: Any,
    shape: tuple[int, int],
    geolocation: Geolocation | None,
    *,
    like: Any,
    reading: Mapping[str, Any],
    resampling: str,
    attributes: Mapping[str, Any],
) -> Any:
    """Return a DataArray on another grid as one of amplitude or complex samples; of dask stays dask.

    Parameters
    ----------
    model : maps (N, 2) points of the new grid to pixels of `array`
    array : the DataArray
    shape, geolocation : (H, W) of the new grid, and where it lies
    like : a DataArray on that grid, or anything else
    reading : keywords of `featreg.as_image`
    resampling : as of `featreg.warp`
    attributes : of the result
    """
    name = None if array.name is None else str(array.name)
    if array.chunks is None:
        image = as_image(array, **reading)
        warped = resample(image, model, shape, resampling=resampling)
        values = blanked(warped.pixels, warped.mask)
    else:
        values = _lazy(model, open_source(array, **reading), shape, resampling)
    return to_data_array(values, geolocation, like=like, name=name, attributes=attributes)


def blanked(pixels: NDArray[Any], mask: BoolArray) -> NDArray[Any]:
    """Return pixels with NaN (complex: nan+nanj) where there is no data."""
    blank = np.complex64(complex(np.nan, np.nan)) if np.iscomplexobj(pixels) else np.float32(np.nan)
    return np.where(mask, pixels, blank)


def _lazy(model: Callable[[FloatArray], FloatArray], source: Source, shape: tuple[int, int], resampling: str) -> Any:
    """The warped samples as an array of dask, whose chunks are the tiles in which `resample` works."""
    import dask.array

    kind = np.complex64 if source.is_complex else np.float32

    def tile(block_info: Any = None) -> NDArray[Any]:
        (top, bottom), (left, right) = block_info[None]["array-location"]
        window = Window(left, top, right - left, bottom - top)
        return blanked(*resampled_window(source, model, window, resampling))

    chunks = tuple(tuple(min(TILE, n - start) for start in range(0, n, TILE)) for n in shape)
    blocks: Any = dask.array.map_blocks
    return blocks(tile, chunks=chunks, dtype=kind, meta=np.zeros((0, 0), kind))
