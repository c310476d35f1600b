"""What the metadata of a product state, found from its raster file: sensor, calibration, phase."""

from __future__ import annotations

import logging
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from featreg.errors import InputError
from featreg.io.calibration import Calibration
from featreg.io.products.capella import capella_calibration, metadata_of, sensor_of_capella
from featreg.io.products.sentinel1 import LARGEST, annotation_name, sensor_of_annotation
from featreg.io.products.sentinel1_calibration import calibration_name, sentinel1_calibration
from featreg.io.products.sentinel1_tops import TopsTerms, tops_terms

#: A file in an archive, whose name stands in braces where this package gives it to GDAL.
ARCHIVED = re.compile(r"/vsizip/(?:\{(.+?)\}|(.+?\.zip))/(.+)", re.IGNORECASE)

logger = logging.getLogger(__name__)


def stated_sensor(name: str, tags: Mapping[str, str], shape: tuple[int, int]) -> dict[str, Any] | None:
    """Return the sensor of a raster file that a product's metadata locate, as plain values; None of any other file.

    Parameters
    ----------
    name : of the file as GDAL opened it, also inside an archive (``/vsizip/...``)
    tags : of the dataset
    shape : (H, W) of the raster

    Notes
    -----
    Sentinel-1: ``annotation/NAME.xml`` of a measurement in its SAFE folder or archive. Capella: the TIFF's description,
    or the JSON beside it. Metadata that cannot be used, or that describe an image of another size (a part that was cut
    out), are left out, and the log says so: what the raster itself states is used then.
    """
    try:
        found = _found(name, tags)
    except (OSError, zipfile.BadZipFile, LookupError, ValueError, ArithmeticError, RuntimeError) as error:
        logger.warning("%s: the metadata of its product cannot be used (%s)", name, " ".join(str(error).split()))
        return None
    if found is not None and tuple(found["shape"]) != tuple(shape):
        height, width = found["shape"]
        logger.warning(
            "%s: has %d x %d pixels, and the metadata of its product describe %d x %d: they are left out",
            name, shape[1], shape[0], width, height,
        )  # fmt: skip
        return None
    return found


def stated_calibration(name: str, tags: Mapping[str, str]) -> Calibration | None:
    """Return how the samples of a raster file are calibrated; None where no metadata of a product are known of it.

    `name` and `tags` are those of `stated_sensor`.

    Raises
    ------
    InputError
        They are of a product whose calibration is missing or broken.
    """
    tables = calibration_name(name)
    try:
        if tables is not None:
            content = _content(tables)
            if content is None:
                raise InputError(f"{name}: its calibration, '{tables}', is not there; the product must be complete")
            return sentinel1_calibration(tables, content)
        text = metadata_of(name, tags.get("TIFFTAG_IMAGEDESCRIPTION"))
    except (OSError, zipfile.BadZipFile, RuntimeError) as error:
        raise InputError(f"{name}: its calibration cannot be read ({error})") from error
    return None if text is None else capella_calibration(text, name)


def stated_tops(name: str, shape: tuple[int, int]) -> TopsTerms | None:
    """Return what a product states of the phase of a raster file of (H, W); None of what is no TOPS image.

    Raises
    ------
    InputError
        Its annotation is broken.
    """
    annotation = annotation_name(name)
    try:
        content = None if annotation is None else _content(annotation)
    except (OSError, zipfile.BadZipFile, RuntimeError) as error:
        raise InputError(f"{name}: its annotation cannot be read ({error})") from error
    return None if annotation is None or content is None else tops_terms(annotation, content, shape)


def _found(name: str, tags: Mapping[str, str]) -> dict[str, Any] | None:
    annotation = annotation_name(name)
    if annotation is not None:
        content = _content(annotation)
        return None if content is None else sensor_of_annotation(annotation, content)
    text = metadata_of(name, tags.get("TIFFTAG_IMAGEDESCRIPTION"))
    return None if text is None else sensor_of_capella(text, name)


def _content(name: str) -> bytes | None:
    """The bytes of a file, in an archive or not; None where there is none."""
    found = ARCHIVED.fullmatch(name)
    if found is not None:
        inside = found[3]
        with zipfile.ZipFile(found[1] or found[2]) as opened:
            if inside not in opened.namelist() or opened.getinfo(inside).file_size > LARGEST:
                return None
            return opened.read(inside)
    path = Path(name)
    return path.read_bytes() if path.is_file() and path.stat().st_size <= LARGEST else None
