"""NPY and NPZ files of unknown origin: whatever numpy raises on damaged content is a `ValueError`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray


def load_array(source: str | Path, mmap_mode: Literal["r"] | None = None) -> NDArray[Any]:
    """Return the array of an NPY file, never unpickling anything.

    Raises
    ------
    OSError, ValueError
        The file cannot be read; its content is no whole NPY.
    """
    with _as_value_error():
        array = np.load(source, mmap_mode=mmap_mode, allow_pickle=False)
    if not isinstance(array, np.ndarray):
        array.close()
        raise ValueError("it is an archive of arrays (NPZ), one array (NPY) is needed")
    return array


def load_arrays(source: str | Path | IO[bytes]) -> dict[str, NDArray[Any]]:
    """Return every array of an NPZ file by its name, never unpickling anything; errors as in `load_array`."""
    with _as_value_error():
        held = np.load(source, allow_pickle=False)
        if isinstance(held, np.ndarray):
            raise ValueError("it is one array (NPY), an archive of arrays (NPZ) is needed")
        with held:
            return {name: held[name] for name in held.files}


@contextmanager
def _as_value_error() -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError):
        raise
    except Exception as error:  # TokenError, SyntaxError, BadZipFile, MemoryError, zlib.error, ... by the damage
        raise ValueError(f"damaged ({type(error).__name__}: {error})") from error
