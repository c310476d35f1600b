"""Complex samples without their phase ramp while they are interpolated: as a product states it, else an estimate."""

from __future__ import annotations

import logging
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.opening import open_reader
from featreg.io.products.sentinel1_tops import tops_of
from featreg.io.raster_source import RasterSource
from featreg.io.source import Source
from featreg.io.window import Window
from featreg.products.lattice import Lattice
from featreg.products.phase_ramp import PhaseRamp, estimate_phase_ramp
from featreg.products.tops_phase import TopsPhase
from featreg.types import BoolArray

Ramp: TypeAlias = PhaseRamp | TopsPhase

logger = logging.getLogger(__name__)


def stated_ramp(source: Source) -> TopsPhase | None:
    """Return the phase that the product of a source states; None where it states none.

    Raises
    ------
    InputError
        Its annotation is broken.
    """
    if not isinstance(source, RasterSource) or source.head.choice.how != "one":
        return None
    reader = open_reader(source.path)
    try:
        terms = tops_of(reader, source.head.choice.bands[0])
    finally:
        reader.close()
    return None if terms is None else TopsPhase(terms)


def ramp_of(source: Source) -> Ramp:
    """Return the phase ramp of a scene: as its product states it, else as its samples show it.

    Raises
    ------
    InputError
        As `stated_ramp` and `featreg.products.phase_ramp.estimate_phase_ramp`.
    """
    stated = stated_ramp(source)
    if stated is not None:
        return stated

    def read(x: int, y: int, width: int, height: int) -> tuple[NDArray[Any], BoolArray]:
        image = source.read(Window(x, y, width, height))
        return image.pixels, image.mask

    try:
        return estimate_phase_ramp(read, source.shape)
    except InputError as error:
        raise InputError(f"{source.path}: {error}") from error


def warn_of_ramp(source: Source) -> None:
    """Say in the log that samples of TOPS, as the annotation states it, are about to be interpolated with their ramp.

    Raises
    ------
    InputError
        As `stated_ramp`.
    """
    if source.is_complex and stated_ramp(source) is not None:
        logger.warning(
            "%s: is a TOPS image, whose phase ramp no interpolator carries: its phase will be wrong without deramp "
            "(--deramp)",
            source.path,
        )


def without_ramp(pixels: NDArray[Any], ramp: Ramp, x: int, y: int) -> NDArray[Any]:
    """Return samples whose first lies at (x, y) of the scene, with the ramp taken out."""
    columns, rows = np.arange(x, x + pixels.shape[1]), np.arange(y, y + pixels.shape[0])
    return np.asarray(pixels * ramp.factor(columns, rows[:, None], -1))


def with_ramp(
    values: NDArray[Any], mask: BoolArray, ramp: Ramp, lattice: Lattice, reach: int
) -> tuple[NDArray[Any], BoolArray]:
    """Return interpolated samples with the ramp put back at the positions of a lattice, and which of them are data.

    `reach` is how far, in rows, a sample rests on those around it: one that rests on two bursts is made of two views
    with different phases, and is none.
    """
    x, y = lattice.positions()
    if isinstance(ramp, TopsPhase):
        mask = mask & ramp.whole(y, reach)
    return np.where(mask, values * np.where(mask, ramp.factor(x, y, 1), 0), np.complex64(0)), mask
