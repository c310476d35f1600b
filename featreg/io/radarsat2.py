"""RADARSAT-2 as GDAL calibrates it: ``RADARSAT_2_CALIB:SIGMA0:PATH/product.xml``, with its tables checked before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from featreg.errors import InputError, suggest
from featreg.io.gdal_confined import within_folder
from featreg.io.gdal_reader import GdalReader
from featreg.io.reader import Band
from featreg.io.xml_text import root_of

#: What GDAL calls a quantity -> what the product calls its table; None of digital numbers as they are.
TABLES = {"SIGMA0": "sigma nought", "BETA0": "beta nought", "GAMMA": "gamma", "UNCALIB": None}
#: Bytes of a table at most.
LARGEST = 16 << 20


class CalibratedRadarsat2Reader(GdalReader):
    """The bands of a product as one quantity: power of detected ones, complex samples of others.

    Parameters
    ----------
    name : in GDAL's manner
    header : the product's header, ``product.xml``
    called : what it is called in messages

    Raises
    ------
    InputError
        The quantity is unknown, a file lies outside the product's folder, or the quantity's table is missing, broken or
        shorter than a line. GDAL looks at none of the tables: without one it ends the process, and it divides by what
        lies behind a short one in memory.
    """

    def __init__(self, name: str, header: Path, called: str) -> None:
        self.quantity = name.split(":")[1]
        if self.quantity not in TABLES:
            raise InputError(f"{called}: unknown quantity '{self.quantity}', {suggest(self.quantity, list(TABLES))}")
        super().__init__(name, ["RS2"], called)
        within_folder(header, self)
        table = TABLES[self.quantity]
        if table is not None:
            try:
                check_tables(header, table, self.dataset.width, called)
            except InputError:
                self.close()
                raise

    @cached_property
    def bands(self) -> Sequence[Band]:
        found = super().bands
        if TABLES[self.quantity] is None:
            return found
        return [band if band.is_complex else replace(band, said="intensity") for band in found]


def check_tables(header: Path, called_so: str, width: int, called: str) -> None:
    """Raise an `InputError` where a product lacks a sound table of a quantity for lines of so many samples."""
    try:
        parts = next((part for part in root_of(header.read_bytes()) if _local(part) == "imageattributes"), None)
        tables: list[str] = []
        for part in () if parts is None else parts:
            # GDAL knows those that stand before the first image.
            if _local(part) == "fullresolutionimagedata" and not tables:
                break
            if _local(part) == "lookuptable" and _correction(part) == called_so:
                tables.append((part.text or "").strip())
        if not tables:
            raise ValueError("the header names none")
        for table in tables:
            path = header.parent / table
            if not path.resolve().is_relative_to(header.parent.resolve()):
                raise ValueError(f"'{table[:80]}' lies outside the product's folder")
            if path.stat().st_size > LARGEST:
                raise ValueError(f"'{table[:80]}' is too large")
            root = root_of(path.read_bytes())
            gains = np.array(str(root.findtext("{*}gains")).split(), np.float64)
            if len(gains) < width or not (np.isfinite(gains) & (gains > 0)).all():
                raise ValueError(f"'{table[:80]}' does not hold {width} gains above 0")
    except (OSError, ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{called}: has no whole table to calibrate by '{called_so}' ({error})") from error


def _local(part: ElementTree.Element) -> str:
    return str(part.tag).rpartition("}")[2].lower()


def _correction(part: ElementTree.Element) -> str:
    return next(
        (value for name, value in part.attrib.items() if name.lower() == "incidenceanglecorrection"), ""
    ).lower()
