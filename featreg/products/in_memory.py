"""The secondary on the reference grid in memory: of arrays an array, of DataArrays a DataArray."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.io import ImageLike, as_image
from featreg.io.bands import BandLike
from featreg.io.data_arrays import DataArrayReader, is_data_array
from featreg.io.raster_files import is_same
from featreg.io.raster_source import located_source, open_source
from featreg.products.data_arrays import blanked, warped_data_array
from featreg.products.deramping import ramp_of, warn_of_ramp
from featreg.products.resample import model_of, resample, stated_shape
from featreg.results.registration import Registration
from featreg.types import Image


def warp(
    registration: Registration,
    secondary: ImageLike,
    *,
    like: ImageLike | tuple[int, int] | None = None,
    resampling: str = "lanczos",
    band: BandLike = None,
    deramp: bool = False,
) -> Any:
    """Return the secondary image on the reference grid.

    Parameters
    ----------
    registration : the result of `featreg.match`; its model is used even when it is not trusted (a warning is logged)
    secondary : path, 2-D array or `Image`, of the same grid as the secondary that was matched
    like : the reference (path, array or `Image`) or its (H, W), where the registration does not name its size; of a
        DataArray the result has the coordinates
    resampling : "nearest", "bilinear", "cubic" or "lanczos"
    band : of a file or DataArray of several bands; by default that which was matched
    deramp : interpolate complex samples without their phase ramp and put it back, as `featreg.warp_file` does

    Returns
    -------
    (H, W) float32 linear amplitude, whatever scale the file has, or complex64, read as that which was matched was
    (scale, calibration, stated value for no data; masks aside, which say where to match);
    NaN (complex: nan+nanj) where the secondary has no data. A numpy array; of a DataArray of xarray a DataArray with
    the coordinates, the coordinate system and the geotransform of the reference, lazy where the secondary is of dask

    Raises
    ------
    InputError
        There is no model, the reference's size is not known, or the secondary cannot be used or has another size than
        the one that was matched (`featreg.warp_file` takes other pixel sizes).
    ParameterError
        An unknown resampling; `deramp` without complex samples, or of a DataArray.
    """
    model = model_of(registration)
    shape, known = _reference_shape(registration, like), registration.secondary
    # Arrays have no names: one of the size of that which was matched is taken for it.
    path = str(secondary) if isinstance(secondary, str | Path) else "array"
    alike = known is not None and (known.path == path or is_same(known.path, path))
    reading: dict[str, Any] = dict(known.reading) if known is not None and alike else {}
    reading["band"] = known.band if band is None and known is not None else band
    if is_data_array(secondary):
        if deramp:
            raise ParameterError("deramp is for files and arrays; of a DataArray give its values")
        _check_size(DataArrayReader(secondary).shape, registration)
        place = None if registration.reference is None else registration.reference.geolocation
        facts = {"status": registration.status, "reason": registration.reason}
        facts["method"] = str(registration.provenance.get("method", ""))
        return warped_data_array(
            model, secondary, shape, place, like=like, reading=reading, resampling=resampling,
            attributes={f"featreg_{name}": text for name, text in facts.items()},
        )  # fmt: skip
    if isinstance(secondary, Image):
        reading = {}
    elif not isinstance(secondary, str | Path):
        reading["band"] = None
    image = as_image(secondary, **reading)
    _check_size(image.shape, registration)
    ramp = None
    if deramp:
        if not image.is_complex:
            raise ParameterError(f"{image.name}: holds {image.source_dtype} samples, deramp needs complex ones")
        is_file = isinstance(secondary, str | Path)
        ramp = ramp_of(open_source(secondary, **reading) if is_file else open_source(image))
    elif image.is_complex and resampling != "nearest" and isinstance(secondary, str | Path):
        warn_of_ramp(open_source(secondary, **reading))
    warped = resample(image, model, shape, resampling=resampling, ramp=ramp)
    return blanked(warped.pixels, warped.mask)


def _check_size(shape: tuple[int, int], registration: Registration) -> None:
    """Raise where an image cannot be the secondary that was matched."""
    known = registration.secondary
    if known is not None and known.path != "tie points" and known.shape != shape:
        raise InputError(
            f"the secondary has the shape {shape}, that of the result was {known.shape}; featreg.warp_file takes files "
            "of another pixel size"
        )


def _reference_shape(registration: Registration, like: ImageLike | tuple[int, int] | None) -> tuple[int, int]:
    if isinstance(like, tuple):
        return stated_shape(like)
    if isinstance(like, Image):
        return like.shape
    if isinstance(like, str | Path):
        return located_source(like).shape
    if is_data_array(like):
        return DataArrayReader(like).shape
    if like is not None:
        shape = np.shape(cast(Any, like))
        if len(shape) != 2:
            raise InputError(f"like must be the reference image or its (H, W), got an array of shape {shape}")
        return shape[0], shape[1]
    if registration.reference is None:
        raise InputError("the registration does not say the reference's size; give it as like=(H, W)")
    return registration.reference.shape
