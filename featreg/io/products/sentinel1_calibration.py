"""Sentinel-1: the calibration's look-up tables of a measurement.

The driver of GDAL offers calibrated sub-datasets, but of the public samples of single-look products it returns the
digital numbers as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from xml.etree import ElementTree

import numpy as np

from featreg.errors import InputError
from featreg.io.calibration import Calibration
from featreg.io.products.sentinel1 import MEASUREMENT, parsed
from featreg.io.window import Window
from featreg.types import FloatArray

#: Element of the calibration vectors that holds each quantity's table.
TABLES = {"sigma0": "sigmaNought", "beta0": "betaNought", "gamma0": "gamma"}


@dataclass(frozen=True, eq=False)
class LookUpTable:
    """Vectors of one quantity: digital numbers over their values are amplitudes of it.

    Parameters
    ----------
    lines : (V,) rows of the vectors, increasing
    pixels : V arrays of their columns, each increasing
    values : V arrays of the table's values there, > 0
    """

    lines: FloatArray
    pixels: list[FloatArray]
    values: list[FloatArray]

    def at(self, window: Window) -> FloatArray:
        """(H, W) values of the table over a window: linear along and between the vectors, beyond them as at the end."""
        columns = window.x + np.arange(window.width)
        rows = window.y + np.arange(window.height)
        place = np.clip(np.searchsorted(self.lines, rows, side="right") - 1, 0, max(len(self.lines) - 2, 0))
        used = np.unique(np.concatenate([place, np.minimum(place + 1, len(self.lines) - 1)]))
        across = {int(k): np.interp(columns, self.pixels[k], self.values[k]) for k in used}
        out = np.empty(window.shape)
        for i, (row, k) in enumerate(zip(rows.tolist(), place.tolist(), strict=True)):
            after = min(k + 1, len(self.lines) - 1)
            gap = self.lines[after] - self.lines[k]
            part = min(max((row - self.lines[k]) / gap, 0.0), 1.0) if gap > 0 else 0.0
            out[i] = across[k] * (1 - part) + across[after] * part
        return out

    def factor(self, window: Window) -> FloatArray:
        """(H, W) by which digital numbers are multiplied."""
        return 1.0 / self.at(window)


def calibration_name(measurement: str) -> str | None:
    """Return what the calibration of a measurement is called; None of a file that lies in no SAFE folder."""
    found = MEASUREMENT.fullmatch(measurement)
    return None if found is None else f"{found[1]}annotation/calibration/calibration-{found[2]}.xml"


def sentinel1_calibration(name: str, content: bytes) -> Calibration:
    """Return the calibration of a measurement, from ``annotation/calibration/calibration-NAME.xml``.

    Raises
    ------
    InputError
        It has no tables, or they are broken.

    Notes
    -----
    The digital number over the table's value is an amplitude of the quantity, as the product's specification has it.
    """
    root = parsed(name, content)
    factors = {}
    try:
        vectors = sorted(root.iterfind(".//calibrationVector"), key=lambda one: float(str(one.findtext("line"))))
        if not vectors:
            raise ValueError("it holds no calibrationVector")
        for quantity, table in TABLES.items():
            lines, pixels, values = zip(*(_vector(vector, table) for vector in vectors), strict=True)
            known = LookUpTable(np.array(lines, np.float64), list(pixels), list(values))
            factors[quantity] = partial(LookUpTable.factor, known)
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{name}: is no whole calibration ({type(error).__name__}: {error})") from error
    return Calibration(factors)


def _vector(vector: ElementTree.Element, table: str) -> tuple[float, FloatArray, FloatArray]:
    line = float(str(vector.findtext("line")))
    pixels, values = (np.array(str(vector.findtext(name)).split(), np.float64) for name in ("pixel", table))
    good = len(pixels) == len(values) >= 1 and (np.diff(pixels) > 0).all()
    if not good or not np.isfinite([line, *pixels, *values]).all() or not (values > 0).all():
        raise ValueError(f"the vector of line {line:g} has no pixels that increase with values > 0")
    return line, pixels, values
