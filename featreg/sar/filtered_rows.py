"""Filters of whole maps, the rows of which threads share out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import in_parts

F32 = NDArray[np.float32]


def filtered_rows(function: Callable[[F32], NDArray[Any]], view: F32, reach: int) -> F32:
    """Return a filter's map of a map (H, W), of the same shape.

    Parameters
    ----------
    function : from some rows of the map to as many of the result; at their ends it may invent what lies beyond
    view : (H, W) float32
    reach : how many rows above and below one are looked at, px
    """
    height = view.shape[0]
    out = np.empty(view.shape, np.float32)

    def part(first: int, stop: int) -> None:
        nonlocal out
        if stop - first == height:
            out = np.asarray(function(view), np.float32)
            return
        above = max(first - reach, 0)
        out[first:stop] = function(view[above : min(stop + reach, height)])[first - above : stop - above]

    in_parts(part, *view.shape)
    return out
