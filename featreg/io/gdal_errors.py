"""GDAL's manners: its warnings kept quiet, and whatever it raises on broken files turned into one line."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from featreg.errors import FeatregError, InputError

# GDAL's fast path for whole 8-bit PNGs returns garbage, without an error, for a truncated file (3.10); a broken JPEG
# is only a warning to it unless told otherwise. Code inside virtual rasters never runs.
GDAL_OPTIONS = {
    "GDAL_PNG_WHOLE_IMAGE_OPTIM": "NO",
    "GDAL_ERROR_ON_LIBJPEG_WARNING": "YES",
    "GDAL_VRT_ENABLE_PYTHON": "NO",
}
#: GDAL's folders of addresses (/vsicurl, /vsis3 and their like) open only names that end so, which none does.
NO_NETWORK = {"CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".no-address-in-a-file"}


#: What libraries say where a codec is not built into them.
CODEC = re.compile(
    r"missing codec|codec.{0,40}not (available|supported)|required filter|filter.{0,20}not (available|reg)",
    re.IGNORECASE,
)


def reason(error: BaseException) -> str:
    """Return one line on an error; rasterio keeps the telling text in the cause."""
    text = " ".join(str(error.__cause__ or error).split()) or type(error).__name__
    return text if len(text) <= 200 else text[:197] + "..."


@contextmanager
def quiet() -> Iterator[None]:
    """Keep rasterio from warning that an image has no geolocation."""
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


@contextmanager
def decoding(path: str | Path, kind: str) -> Iterator[None]:
    """Turn whatever a decoder raises into one line: on broken bytes the libraries raise nearly anything."""
    try:
        yield
    except FeatregError:
        raise
    except Exception as error:
        raise InputError(_said(path, kind, error)) from error


def _said(path: str | Path, kind: str, error: Exception) -> str:
    why = reason(error)
    if CODEC.search(why):
        return (
            f"{path}: the {kind} file is compressed in a way that the library installed here cannot read ({why}); "
            "write it anew with another compression, such as DEFLATE"
        )
    if "does not exist in the file system" in why:
        return f"{path}: GDAL finds no such file; give the name of an existing one"
    return f"{path}: the {kind} file is broken or cut short ({why}); a complete file is needed"
