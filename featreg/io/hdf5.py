"""HDF5 and netCDF files: their variables by h5py (the `hdf5` extra), those of the classic netCDF format by scipy."""

from __future__ import annotations

import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.cf_places import unwritten
from featreg.io.gdal_errors import decoding
from featreg.io.gridded import GriddedReader, missing
from featreg.io.products.nisar import sensor_of_nisar
from featreg.io.variable import Variable

SIGNATURE = b"\x89HDF\r\n\x1a\n"
#: Datasets in which COSMO-SkyMed keeps in-phase and quadrature along a third axis: first and second generation.
COSMO = ("SBI", "IMG")
#: Objects of a file that are looked at.
MOST_OBJECTS = 20_000


def is_hdf5(path: Path, head: bytes) -> bool:
    """Whether a file is HDF5 at its beginning, or behind a user block as in MATLAB 7.3."""
    return head.startswith(SIGNATURE) or (head.startswith(b"MATLAB 7.3") and is_behind_user_block(path))


def is_behind_user_block(path: Path) -> bool:
    """Whether the signature of HDF5 stands where a user block may end: at byte 512, 1024, 2048, ..."""
    with path.open("rb") as file:
        place, size = 512, path.stat().st_size
        while place < size:
            file.seek(place)
            if file.read(len(SIGNATURE)) == SIGNATURE:
                return True
            place *= 2
    return False


def is_classic_netcdf(head: bytes) -> bool:
    """Whether a file is netCDF of the classic format or with 64-bit offsets."""
    return head[:3] == b"CDF" and head[3:4] in (b"\x01", b"\x02")


def open_hdf5(path: Path) -> GriddedReader:
    """Open an HDF5 file, netCDF-4 and MATLAB 7.3 among them.

    Raises
    ------
    InputError
        h5py is not installed, or the file is broken.
    """
    try:
        h5py: Any = import_module("h5py")
    except ImportError as error:
        raise missing(path, "hdf5", "h5py", "an HDF5 file", error) from error
    with decoding(path, "HDF5"):
        file = h5py.File(path, "r", rdcc_nbytes=8 << 20)
        try:
            variables, matlab = _variables(h5py, file, path)
        except BaseException:
            file.close()
            raise
    return GriddedReader(
        str(path), "HDF5", variables, file.close, matlab, sensor=lambda name: sensor_of_nisar(file, name)
    )


def _variables(h5py: Any, file: Any, path: Path) -> tuple[dict[str, Variable], bool]:
    found: dict[str, Variable] = {}
    seen = 0
    matlab = False

    def visit(name: str, item: Any) -> None:
        nonlocal seen, matlab
        seen += 1
        if seen > MOST_OBJECTS:
            raise InputError(f"{path}: holds more than {MOST_OBJECTS} objects; copy the dataset to a file of its own")
        # What the file keeps in other files is not looked for there.
        if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual:
            return
        try:
            shape, dtype = tuple(item.shape or ()), item.dtype
            attributes = {key: _attribute(item, key) for key in item.attrs}
            fill = float(item.fillvalue) if dtype.kind in "if" else None
            scales = ["".join([s.name for s in d.values()][:1]) for d in item.dims] if shape else []
        except (OSError, RuntimeError, TypeError, ValueError, KeyError, OverflowError):
            return
        matlab = matlab or "MATLAB_class" in attributes
        read = item.__getitem__
        if len(shape) == 3 and shape[2] == 2 and dtype.kind in "if" and name.rpartition("/")[2] in COSMO:
            pair = np.dtype([("r", dtype.newbyteorder("=")), ("i", dtype.newbyteorder("="))])
            shape, read, dtype, scales = shape[:2], _paired(item, pair), pair, scales[:2]
        found[f"/{name}"] = Variable(f"/{name}", shape, dtype, attributes, read, scales, fill)

    # Links, soft ones and those to other files, are not followed.
    file.visititems(visit)
    return found, matlab


def _paired(item: Any, pair: np.dtype[Any]) -> Any:
    """A reader of (H, W) pairs of numbers, of a dataset whose last axis holds them."""

    def read(index: tuple[Any, ...]) -> NDArray[Any]:
        return np.ascontiguousarray(item[(*index, slice(None))], pair[0]).view(pair)[..., 0]

    return read


def _attribute(item: Any, key: str) -> Any:
    try:
        value = item.attrs[key]
    except (OSError, RuntimeError, TypeError, ValueError, KeyError):
        return None
    return value if not isinstance(value, np.ndarray) or value.size <= 64 else None


def open_classic_netcdf(path: Path) -> GriddedReader:
    """Open a netCDF file of the classic format.

    Raises
    ------
    InputError
        The file is broken.
    """
    from scipy.io import netcdf_file

    with decoding(path, "netCDF"), warnings.catch_warnings():
        warnings.simplefilter("ignore")

        class Mapped(netcdf_file):
            """A file whose map ends with the last array on it, so that there is nothing to close."""

            def __del__(self) -> None: ...

        file = Mapped(path, "r", mmap=True, maskandscale=False)
        variables = {}
        for name, held in file.variables.items():
            data = held.data
            axes = [f"/{d}" if d in file.variables else "" for d in held.dimensions]
            attributes = dict(vars(held).get("_attributes", {}))
            read = _copied(data)
            fill = unwritten(data.dtype)
            variables[f"/{name}"] = Variable(f"/{name}", data.shape, data.dtype, attributes, read, axes, fill)
    return GriddedReader(str(path), "netCDF", variables, lambda: None)


def _copied(data: Any) -> Any:
    return lambda index: np.array(data[index])
