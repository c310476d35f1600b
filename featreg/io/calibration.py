"""Sentinel-1: samples calibrated by the look-up tables of their product.

The driver of GDAL offers calibrated sub-datasets, but of the public samples of single-look products it returns the
digital numbers as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from featreg.errors import InputError
from featreg.io.images import as_image
from featreg.io.products.sentinel1 import MEASUREMENT, parsed
from featreg.io.raster_source import open_source
from featreg.io.window import Window
from featreg.runtime.parameters import check
from featreg.types import FloatArray, Image, read_only

Quantity = Literal["sigma0", "beta0", "gamma0"]
#: Element of the calibration vectors that holds each quantity's table.
TABLES = {"sigma0": "sigmaNought", "beta0": "betaNought", "gamma0": "gamma"}


@dataclass(frozen=True, eq=False)
class Calibration:
    """Look-up tables of a measurement: digital numbers over their values are amplitudes of sigma0, beta0 or gamma0.

    Parameters
    ----------
    lines : (V,) rows of the vectors, increasing
    pixels : V arrays of their columns, each increasing
    values : V arrays of the table's values there, > 0
    """

    lines: FloatArray
    pixels: list[FloatArray]
    values: list[FloatArray]

    @classmethod
    def of(cls, measurement: str | Path, quantity: Quantity = "sigma0") -> Calibration:
        """Read ``annotation/calibration/calibration-NAME.xml`` of a measurement in its SAFE folder.

        Raises
        ------
        InputError
            The file lies in no such folder, has no tables, or they are broken.
        ParameterError
            An unknown quantity.
        """
        check("quantity", quantity, Quantity)
        found = MEASUREMENT.fullmatch(str(measurement))
        if found is None:
            raise InputError(
                f"{measurement}: is no measurement in a SAFE folder (measurement/NAME.tiff), and of nothing else a "
                "calibration is known"
            )
        path = f"{found[1]}annotation/calibration/calibration-{found[2]}.xml"
        root = parsed(path)
        try:
            vectors = sorted(
                (_vector(vector, TABLES[quantity]) for vector in root.iterfind(".//calibrationVector")),
                key=lambda vector: vector[0],
            )
            if not vectors:
                raise ValueError("it holds no calibrationVector")
            lines, pixels, values = zip(*vectors, strict=True)
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{path}: is no whole calibration ({type(error).__name__}: {error})") from error
        return cls(np.array(lines, np.float64), list(pixels), list(values))

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


def calibrated(measurement: str | Path, window: Window | None = None, *, quantity: Quantity = "sigma0") -> Image:
    """Return a measurement of Sentinel-1, or a window of it, as amplitudes of a calibrated quantity.

    Parameters
    ----------
    measurement : ``measurement/NAME.tiff`` in a SAFE folder that has its calibration
    window : a part of it; None for the whole, which then carries its geolocation
    quantity : "sigma0", "beta0" or "gamma0"

    Returns
    -------
    Image of float32 amplitudes, whose square is the quantity; of an SLC complex64, of which the squared modulus is

    Raises
    ------
    InputError, ParameterError
        As `Calibration.of`, and what reading an image raises.

    Notes
    -----
    The digital number over the table's value, as the product's specification has it; thermal noise is left in.
    """
    table = Calibration.of(measurement, quantity)
    image = as_image(measurement) if window is None else open_source(measurement).read(window)
    values = table.at(window or Window(0, 0, image.shape[1], image.shape[0])).astype(np.float32)
    return replace(image, pixels=read_only(image.pixels / values))


def _vector(vector: ElementTree.Element, table: str) -> tuple[float, FloatArray, FloatArray]:
    line = float(str(vector.findtext("line")))
    pixels, values = (np.array(str(vector.findtext(name)).split(), np.float64) for name in ("pixel", table))
    good = len(pixels) == len(values) >= 1 and (np.diff(pixels) > 0).all() and np.isfinite(values).all()
    if not good or not (values > 0).all():
        raise ValueError(f"the vector of line {line:g} has no pixels that increase with values > 0")
    return line, pixels, values
