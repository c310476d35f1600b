"""Files appear whole or not at all, never in place of an input; arrays to GeoTIFF."""

from __future__ import annotations

import os
import re
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import FeatregError, InputError
from featreg.io.gdal_errors import quiet, reason
from featreg.runtime.files import check_ending, temporary_path
from featreg.types import Geolocation

#: Bytes that a folder is asked to take when a file could not be written.
PROBE = 1 << 20
#: Lines that libtiff writes on stderr, past every error handler.
LIBTIFF = re.compile(rb"_?tiff\w*:", re.IGNORECASE)

_stderr_lock = threading.Lock()


@contextmanager
def replacing(path: str | Path, *, inputs: Iterable[Any] = ()) -> Iterator[Path]:
    """Give a temporary path to write to, and move what was written there to `path` at the end.

    Parameters
    ----------
    path : an existing file is replaced
    inputs : files that must not be replaced; what is no path is passed over

    Raises
    ------
    InputError
        `path` is a folder or an input, or the file cannot be written. Errors of `OSError` and of rasterio inside the
        block become this one.
    """
    path = Path(path)
    refuse_input(path, inputs)
    if path.is_dir():
        raise InputError(f"{path}: is a directory, the name of a file is needed")
    full = ""
    try:
        with temporary_path(path) as temporary, _libtiff_silent():
            try:
                yield temporary
            except Exception:
                # Libraries seldom say why they could not write; asked while what they wrote is still there.
                full = _refusal(temporary.parent)
                raise
    except Exception as error:
        if isinstance(error, FeatregError) or not (full or _of_writing(error)):
            raise
        message = f"{path}: cannot be written ({full or reason(error)}); give a file in an existing, writable folder"
        raise InputError(message) from error


def _refusal(folder: Path) -> str:
    """What the system says to another megabyte in a folder; empty where it takes it."""
    try:
        with (folder / "probe").open("wb") as file:
            file.write(bytes(PROBE))
            file.flush()
            os.fsync(file.fileno())
        (folder / "probe").unlink()
    except OSError as error:
        return error.strerror or str(error)
    return ""


@contextmanager
def _libtiff_silent() -> Iterator[None]:
    """Keep libtiff from writing lines of its own on stderr, where no one watches progress there.

    What other libraries write meanwhile comes when it is over.
    """
    if not _stderr_lock.acquire(blocking=False):
        yield
        return
    try:
        kept = None
        with suppress(OSError):
            kept = None if os.isatty(2) else os.dup(2)
        if kept is None:
            yield
            return
        with tempfile.TemporaryFile() as held:
            os.dup2(held.fileno(), 2)
            try:
                yield
            finally:
                os.dup2(kept, 2)
                os.close(kept)
                held.seek(0)
                lines = [line for line in held.read().splitlines(True) if not LIBTIFF.match(line)]
                with suppress(OSError):
                    os.write(2, b"".join(lines))
    finally:
        _stderr_lock.release()


def _of_writing(error: Exception) -> bool:
    if isinstance(error, OSError | ValueError | TypeError):
        return True
    return type(error).__module__.partition(".")[0] in ("rasterio", "sqlite3", "pyarrow")


def refuse_input(path: Path, inputs: Iterable[Any]) -> None:
    """Raise an `InputError` where writing `path` would replace one of the files it is made from."""
    for given in inputs:
        if isinstance(given, str | Path) and path.exists() and Path(given).exists() and path.samefile(given):
            raise InputError(f"{path}: would replace an input, give another name for the output")


def write_geotiff(
    path: str | Path,
    array: NDArray[Any],
    geolocation: Geolocation | None = None,
    nodata: float | None = None,
) -> None:
    """Write an (H, W) array as a GeoTIFF; the file appears whole or not at all.

    Parameters
    ----------
    path : an existing file is replaced
    array : (H, W) integer, float or complex; bool is written as uint8, float16 as float32
    geolocation : transform and CRS, or ground control points, and RPC coefficients to store
    nodata : the value of pixels that are not data

    Raises
    ------
    InputError
        The array is not 2-D and numeric, or the file cannot be written.
    """
    path = Path(path)
    check_ending(path, ".tif", ".tiff")
    if array.ndim != 2 or not array.size or array.dtype.kind not in "buifc":
        raise InputError(
            f"{path}: cannot write {array.dtype} {array.shape}, a non-empty (H, W) numeric array is needed"
        )
    array = array.astype({"bool": np.uint8, "float16": np.float32}.get(array.dtype.name, array.dtype), copy=False)
    import rasterio

    height, width = array.shape
    profile = {"driver": "GTiff", "height": height, "width": width, "count": 1, "dtype": array.dtype.name}
    profile |= {"compress": "deflate", "tiled": min(height, width) >= 256, "bigtiff": "if_safer", "nodata": nodata}
    with (
        replacing(path) as temporary,
        quiet(),
        rasterio.open(temporary.absolute(), "w", **profile, **geolocation_profile(geolocation)) as dataset,
    ):
        dataset.write(array, 1)


def geolocation_profile(geolocation: Geolocation | None) -> dict[str, Any]:
    """Return the geolocation as rasterio's keywords."""
    if geolocation is None:
        return {}
    from rasterio.control import GroundControlPoint
    from rasterio.crs import CRS
    from rasterio.rpc import RPC
    from rasterio.transform import Affine

    keywords: dict[str, Any] = {} if geolocation.crs is None else {"crs": geolocation.crs}
    if geolocation.transform is not None:
        keywords["transform"] = Affine(*geolocation.transform)
    elif geolocation.gcps is not None:
        # rasterio writes no control points without a coordinate system, but takes an empty one.
        keywords.setdefault("crs", CRS())
        # Our points count from the centre of the first pixel, GDAL's from its corner.
        keywords["gcps"] = [
            GroundControlPoint(row=y + 0.5, col=x + 0.5, x=e, y=n, z=z) for x, y, e, n, z in geolocation.gcps.tolist()
        ]
    if geolocation.rpcs is not None:
        keywords["rpcs"] = RPC(**geolocation.rpcs)
    return keywords
