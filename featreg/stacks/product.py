"""The images of a stack on the grid of its reference: arrays, GeoTIFFs, one cube; window by window."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, suggest
from featreg.io.gdal_errors import quiet
from featreg.io.raster_source import Source, Window, open_source
from featreg.io.writers import geolocation_profile, replacing
from featreg.products.data_arrays import SYSTEM, blanked, to_data_array
from featreg.products.files import TILE, bounded_cache, rasterio_window, windows_of
from featreg.products.resample import TAPS, resampled_window
from featreg.stacks.work import reading_of
from featreg.types import Geolocation

if TYPE_CHECKING:
    from featreg.stacks.stack import Stack

#: Columns of the table that a cube holds for each date.
COLUMNS = ("dx", "dy", "rotation_deg", "scale", "standard_error", "closure")


def warped(stack: Stack, folder: str | Path | None, resampling: str) -> list[Any]:
    """Return `Stack.warp`."""
    place = _place(stack)
    target = None if folder is None else Path(folder)
    out: list[Any] = []
    for i in range(len(stack.models)):
        source = _source(stack, i)
        if source is None:
            out.append(None)
        elif target is None:
            out.append(_whole(stack, i, source, resampling))
        else:
            _made(target)
            path = target / f"{i:03d}_{Path(stack.names[i]).stem.replace(' ', '_')}.tif"
            _write_tiff(path, stack, i, source, place, resampling)
            out.append(path)
    return out


def _made(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"'{folder}': cannot be made ({error.strerror or error}); give a folder") from error


def cube(stack: Stack, resampling: str) -> Any:
    """Return `Stack.to_xarray`."""
    made, name, kept = _frame(stack)
    sources = {i: _source(stack, i) for i in kept}
    arrays = [_whole(stack, i, source, resampling) for i, source in sources.items() if source is not None]
    made[name] = (("date", "y", "x"), np.stack(arrays))
    return made


def write_cube(stack: Stack, path: Path, resampling: str) -> None:
    """Write `Stack.to_file`: the table by xarray, the samples window by window."""
    if path.suffix not in (".nc", ".zarr"):
        raise InputError(f"{path}: the name of a cube must end in .nc or .zarr")
    made, name, kept = _frame(stack)
    kind = np.dtype(np.complex64 if name == "complex_samples" else np.float32)
    shape = (len(kept), *stack.shape)
    try:
        opened = _open_netcdf if path.suffix == ".nc" else _open_zarr
        with opened(made, path, stack, kind) as create:
            samples = create(name, shape, (1, *(min(TILE, n) for n in stack.shape)))
            for k, i in enumerate(kept):
                source = _source(stack, i)
                if source is not None:
                    for window, values in _windows(stack, i, source, resampling):
                        rows = slice(window.y, window.y + window.height)
                        samples[k, rows, window.x : window.x + window.width] = values
    except ImportError as error:
        library = "h5netcdf" if path.suffix == ".nc" else "zarr"
        raise ParameterError(f"{path}: writing it needs {library}: pip install 'featreg[xarray]'") from error


def _source(stack: Stack, image: int) -> Source | None:
    """What the samples of an image are read from; None where it was left out."""
    if len(stack.images) != len(stack.models):
        raise InputError("the images of this stack are not at hand; register it anew, or name files that still exist")
    if stack.models[image] is None:
        return None
    given = stack.images[image]
    # What is no file was read already.
    return open_source(given, **(reading_of(stack.provenance.get("options", {})) if isinstance(given, str) else {}))


def _place(stack: Stack) -> Geolocation | None:
    source = _source(stack, stack.reference)
    return None if source is None else source.geolocation


def _windows(stack: Stack, image: int, source: Source, resampling: str) -> Iterator[tuple[Window, NDArray[Any]]]:
    """The windows of an image on the grid of the reference, NaN where it has no data."""
    if resampling not in TAPS:
        raise ParameterError(f"unknown resampling '{resampling}', {suggest(resampling, TAPS)}")
    model = stack.models[image]
    if model is not None:
        for window in windows_of(stack.shape):
            yield window, blanked(*resampled_window(source, model, window, resampling))


def _whole(stack: Stack, image: int, source: Source, resampling: str) -> NDArray[Any]:
    out = np.empty(stack.shape, np.complex64 if source.is_complex else np.float32)
    for window, values in _windows(stack, image, source, resampling):
        out[window.y : window.y + window.height, window.x : window.x + window.width] = values
    return out


def _write_tiff(
    path: Path, stack: Stack, image: int, source: Source, place: Geolocation | None, resampling: str
) -> None:
    import rasterio

    height, width = stack.shape
    profile: dict[str, Any] = {"driver": "GTiff", "height": height, "width": width, "count": 1}
    profile |= {"dtype": "complex64"} if source.is_complex else {"dtype": "float32", "nodata": float("nan")}
    profile |= {"compress": "deflate", "bigtiff": "if_safer", **geolocation_profile(place)}
    if min(height, width) >= TILE:
        profile |= {"tiled": True, "blockxsize": TILE, "blockysize": TILE}
    with (
        replacing(path, inputs=stack.names) as temporary,
        quiet(),
        bounded_cache(),
        rasterio.open(temporary.absolute(), "w", **profile) as dataset,
    ):
        for window, values in _windows(stack, image, source, resampling):
            dataset.write(values, 1, window=rasterio_window(window))


def _frame(stack: Stack) -> tuple[Any, str, list[int]]:
    """The cube without its samples, how these are called, and the numbers of its dates."""
    try:
        import xarray as xr
    except ImportError as error:
        raise ParameterError("a cube needs xarray: pip install 'featreg[xarray]'") from error
    kept = [i for i, model in enumerate(stack.models) if model is not None]
    kinds = {source.is_complex for i in kept if (source := _source(stack, i)) is not None}
    if len(kinds) > 1:
        raise InputError("some images are complex and some are not, a cube is of one kind; warp them to a folder")
    table = stack.to_dataframe().iloc[kept]
    place = _place(stack)
    # Its coordinates are those of any product on this grid.
    grid = to_data_array(np.broadcast_to(np.float32(0), stack.shape), place)
    coordinates = {str(name): grid.coords[name] for name in grid.coords}
    for name, length in zip(("y", "x"), stack.shape, strict=True):
        coordinates.setdefault(name, np.arange(length))
    made = xr.Dataset(
        {name: (("date",), table[name].to_numpy(np.float64)) for name in COLUMNS},
        coords={"date": table["image"].to_numpy(str), **coordinates},
        attrs={"reference": stack.names[stack.reference]},
    )
    return made, "complex_samples" if True in kinds else "amplitude", kept


@contextmanager
def _open_netcdf(made: Any, path: Path, stack: Stack, kind: Any) -> Iterator[Any]:
    import h5netcdf

    with replacing(path, inputs=stack.names) as temporary:
        made.to_netcdf(temporary, engine="h5netcdf")
        # Complex samples are no type of NetCDF, but one of HDF5.
        with h5netcdf.File(temporary, "a", invalid_netcdf=kind.kind == "c") as file:

            def create(name: str, shape: Any, chunks: Any) -> Any:
                blank = {} if kind.kind == "c" else {"fillvalue": np.float32(np.nan)}
                variable = file.create_variable(
                    name, ("date", "y", "x"), kind, chunks=chunks, compression="gzip", **blank
                )
                _described(variable.attrs, made)
                return variable

            yield create


@contextmanager
def _open_zarr(made: Any, path: Path, stack: Stack, kind: Any) -> Iterator[Any]:
    import shutil

    import zarr

    from featreg.io.writers import refuse_input

    refuse_input(path, stack.names)
    if path.exists() and not (path / "zarr.json").is_file() and not (path / ".zgroup").is_file():
        raise InputError(f"{path}: exists and is no Zarr store, give another name")
    half = path.with_name(f".{path.name}.tmp")
    shutil.rmtree(half, ignore_errors=True)
    try:
        made.to_zarr(half, mode="w", zarr_format=2, consolidated=False)
        group = zarr.open_group(half, mode="a", zarr_format=2)

        def create(name: str, shape: Any, chunks: Any) -> Any:
            blank = complex(np.nan, np.nan) if kind.kind == "c" else float("nan")
            array = group.create_array(name, shape=shape, chunks=chunks, dtype=kind, fill_value=blank)
            array.attrs["_ARRAY_DIMENSIONS"] = ["date", "y", "x"]
            _described(array.attrs, made)
            return array

        yield create
        zarr.consolidate_metadata(str(half), zarr_format=2)
        # The store appears whole: what was there makes room at the last moment.
        shutil.rmtree(path, ignore_errors=True)
        half.rename(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); give another folder") from error
    finally:
        shutil.rmtree(half, ignore_errors=True)


def _described(attributes: Any, made: Any) -> None:
    if SYSTEM in made.coords:
        attributes["grid_mapping"] = SYSTEM
