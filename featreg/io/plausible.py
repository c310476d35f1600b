"""Whether a file can hold as many samples as its header states, asked before memory is taken for them."""

from __future__ import annotations

import os
from collections.abc import Iterable

import numpy as np

from featreg.errors import InputError

#: What a file may grow to in any case, and so many times its own size (deflate packs 1032 times at most).
ANY_BYTES, MOST_PACKED = 256 << 20, 1100


def sample_bytes(dtype: str) -> int:
    """Bytes that one sample takes in memory."""
    return 8 if dtype == "complex_int16" else np.dtype(dtype).itemsize


def check_size(
    called: str,
    shape: tuple[int, int],
    each: int,
    files: Iterable[str],
    what: str = "pixels",
    most: int = ANY_BYTES,
) -> None:
    """Raise where a file states far more than its bytes can hold.

    Parameters
    ----------
    called : what the file is called in messages
    shape : (H, W) that it states
    each : bytes that a pixel takes, of all bands together
    files : paths of those that hold the samples; what lies elsewhere is not judged
    what : what there are so many of
    most : bytes that need no file behind them

    Raises
    ------
    InputError
        More than `most`, and more than `MOST_PACKED` times what the files hold.
    """
    wanted = shape[0] * shape[1] * each
    if wanted <= most:
        return
    held = sum(os.path.getsize(file) for file in files if os.path.isfile(file))
    if held and wanted > MOST_PACKED * held:
        raise InputError(
            f"{called}: states {shape[1]} x {shape[0]} {what} ({wanted / 1e9:.2g} GB) in {held} bytes: its header is "
            "damaged, or it is a scene without content"
        )
