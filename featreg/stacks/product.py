"""The images of a stack on the grid of its reference: arrays, GeoTIFFs, one cube."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.io import as_image
from featreg.io.writers import replacing, write_geotiff
from featreg.products.resample import resample
from featreg.stacks.run import reading_of
from featreg.types import Image

if TYPE_CHECKING:
    from featreg.stacks.stack import Stack


def warped(stack: Stack, folder: str | Path | None, resampling: str) -> list[Any]:
    """Return `Stack.warp`."""
    if len(stack.images) != len(stack.models):
        raise InputError("the images of this stack are not at hand; register it anew, or name files that still exist")
    target = None if folder is None else Path(folder)
    if target is not None:
        target.mkdir(parents=True, exist_ok=True)
    reading = reading_of(stack.provenance.get("options", {}))

    def read(image: Any) -> Image:
        # What is no file was read already.
        return as_image(image, **(reading if isinstance(image, str) else {}))

    place = read(stack.images[stack.reference]).geolocation
    out: list[Any] = []
    for i, (image, model) in enumerate(zip(stack.images, stack.models, strict=True)):
        if model is None:
            out.append(None)
            continue
        aligned = resample(read(image), model, stack.shape, resampling=resampling)
        blank = np.complex64(complex(np.nan, np.nan)) if aligned.is_complex else np.float32(np.nan)
        values = np.where(aligned.mask, aligned.pixels, blank)
        if target is None:
            out.append(values)
            continue
        path = target / f"{i:03d}_{Path(stack.names[i]).stem.replace(' ', '_')}.tif"
        write_geotiff(path, values, place, None if aligned.is_complex else float("nan"))
        out.append(path)
    return out


def cube(stack: Stack, resampling: str) -> Any:
    """Return `Stack.to_xarray`."""
    try:
        import xarray as xr
    except ImportError as error:
        raise ParameterError("a cube needs xarray: pip install 'featreg[xarray]'") from error
    arrays = warped(stack, None, resampling)
    kept = [i for i, values in enumerate(arrays) if values is not None]
    table = stack.to_dataframe().iloc[kept]
    height, width = stack.shape
    columns = ("dx", "dy", "rotation_deg", "scale", "standard_error", "closure")
    data: dict[str, Any] = {"amplitude": (("date", "y", "x"), np.stack([arrays[i] for i in kept]))}
    data |= {name: (("date",), table[name].to_numpy(np.float64)) for name in columns}
    coordinates = {"date": table["image"].to_numpy(str), "y": np.arange(height), "x": np.arange(width)}
    cubed = xr.Dataset(data, coords=coordinates)
    if np.iscomplexobj(cubed["amplitude"]):
        cubed = cubed.rename({"amplitude": "complex_samples"})
    cubed.attrs["reference"] = stack.names[stack.reference]
    return cubed


def write_cube(stack: Stack, path: Path, resampling: str) -> None:
    """Write `Stack.to_file`."""
    made = cube(stack, resampling)
    if path.suffix not in (".nc", ".zarr"):
        raise InputError(f"{path}: the name of a cube must end in .nc or .zarr")
    try:
        if path.suffix == ".zarr":
            made.to_zarr(path, mode="w")
            return
        with replacing(path, inputs=stack.names) as temporary:
            # Complex samples are no type of NetCDF, but one of HDF5.
            made.to_netcdf(temporary, engine="h5netcdf", invalid_netcdf="complex_samples" in made)
    except (ImportError, ValueError) as error:
        raise ParameterError(f"{path}: cannot be written ({error}); pip install h5netcdf or zarr") from error
