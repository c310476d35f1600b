"""Samples of products as amplitudes of sigma0, beta0 or gamma0, by what the products themselves state.

Each kind of product says in `featreg.io.products` what its metadata state; a reader that knows such metadata answers
`calibration`. Thermal noise is left in everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from featreg.errors import InputError, ParameterError, suggest
from featreg.io.reader import Raster, Reader
from featreg.io.window import Window
from featreg.types import FloatArray

Quantity = Literal["sigma0", "beta0", "gamma0"]
QUANTITIES: Sequence[str] = ("sigma0", "beta0", "gamma0")
#: (H, W) by which the samples of a window are multiplied.
Factor = Callable[[Window], FloatArray]

KNOWN = "Sentinel-1 in its SAFE folder or archive, Capella, and SICD with scale factors have one"


@dataclass(frozen=True, eq=False)
class Calibration:
    """What turns the samples of a band into amplitudes whose squares are a backscatter coefficient.

    Parameters
    ----------
    factors : of each quantity that the product states
    lacking : why there are no others, for messages
    """

    factors: Mapping[str, Factor]
    lacking: str = ""


@runtime_checkable
class CalibratedReader(Protocol):
    """A reader that may know how its samples are calibrated."""

    def calibration(self, band: int) -> Calibration | None:
        """What the metadata state of a band, counted from 0; None where they state nothing.

        Raises
        ------
        InputError
            What they rest on is missing or broken.
        """


def check_calibration(quantity: str | None, scale: str | None = None) -> None:
    """Raise a `ParameterError` where no such quantity is known, or a stated scale contradicts it; None is none."""
    if quantity is None:
        return
    if quantity not in QUANTITIES:
        raise ParameterError(f"unknown quantity '{quantity}' to calibrate to, {suggest(str(quantity), QUANTITIES)}")
    if scale in ("intensity", "db"):
        raise ParameterError(
            f"scale '{scale}' contradicts calibrate='{quantity}': what is calibrated are amplitudes; leave scale out"
        )


def calibration_of(reader: Reader, band: int) -> Calibration | None:
    """As `CalibratedReader.calibration`, of any reader."""
    return reader.calibration(band) if isinstance(reader, CalibratedReader) else None


def factor_of(reader: Reader, band: int, quantity: str, called: str) -> Factor:
    """Return the factor of one band's samples for one quantity.

    Raises
    ------
    InputError
        The file has no calibration, or none for this quantity.
    """
    found = calibration_of(reader, band)
    if found is None:
        raise InputError(f"{called}: nothing in this {reader.driver} says how to calibrate it to {quantity}; {KNOWN}")
    if quantity not in found.factors:
        known = ", ".join(found.factors) or "no quantity"
        raise InputError(f"{called}: states {known}, not {quantity}{found.lacking and f': {found.lacking}'}")
    return found.factors[quantity]


def calibrated(raster: Raster, factor: Factor, window: Window) -> Raster:
    """Return samples, read from a window, with the factor that `featreg.io.reader.physical` applies."""
    kind = "complex64" if raster.samples.dtype.kind == "c" else "float32"
    return replace(raster, factor=factor(window).astype(np.float32), said="amplitude", dtype=kind)


def constant(value: float) -> Factor:
    """A factor that is the same everywhere."""
    return lambda window: np.full(window.shape, value)
