"""What a user calls an image: a file, a folder, a dataset inside a file, or a name in GDAL's manner."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from featreg.errors import InputError
from featreg.io.gdal_drivers import split_prefix

#: Prefixes of GDAL for datasets inside a file, which are read here by the dataset's own path.
GRIDDED = ("HDF5", "NETCDF")
VIRTUAL = "/vsi"


@dataclass(frozen=True)
class SourceName:
    """A name taken apart.

    Parameters
    ----------
    text : as it was given
    path : the file or folder on this disk that decides what is read; None for what GDAL finds elsewhere
    dataset : inside the file, if one was named
    gdal : (driver, file) of a name that GDAL takes apart itself
    """

    text: str
    path: Path | None
    dataset: str | None = None
    gdal: tuple[str, str] | None = None

    def absolute(self) -> str:
        """The same from any folder."""
        if self.path is None:
            return self.text
        full = os.path.abspath(self.path)
        if self.gdal is not None:
            return self.text.replace(self.gdal[1], full)
        return full if self.dataset is None else f"{full}:{self.dataset}"


def parse_source(source: str | Path) -> SourceName:
    """Take the name of an image apart; whether what it names exists is for whoever opens it.

    ``file.h5:/group/name`` and ``archive.zip:inside.tif`` name what lies inside a file, as do GDAL's
    ``HDF5:"file.h5"://group/name``, ``NETCDF:file.nc:name`` and ``GTIFF_DIR:2:file.tif``; ``/vsi...`` names are GDAL's.
    """
    text = str(source)
    if text.startswith(VIRTUAL) and not _exists(text):
        return SourceName(_rooted(text), None)
    if _exists(text):
        return SourceName(text, Path(text))
    found = re.fullmatch(r'([A-Z0-9]+):(?:"([^"]+)"|(.+?)):(.*)', text)
    if found is not None and found[1] in GRIDDED:
        file, dataset = (found[2], found[4]) if found[2] else _halves(text.partition(":")[2])
        return SourceName(text, Path(file), "/" + dataset.lstrip(":/"))
    prefix = split_prefix(text)
    if prefix is not None:
        return SourceName(text, Path(prefix[1]), gdal=prefix)
    for at in (m.start() for m in re.finditer(":", text)):
        if at > 0 and os.path.isfile(text[:at]):
            return SourceName(text, Path(text[:at]), text[at + 1 :] or None)
    return SourceName(text, Path(text))


def _halves(text: str) -> tuple[str, str]:
    """File and dataset of a name with a colon between, of which the file exists if any does."""
    for found in re.finditer(":", text):
        if os.path.isfile(text[: found.start()]):
            return text[: found.start()], text[found.end() :]
    file, _, dataset = text.partition(":")
    return file, dataset


def _exists(text: str) -> bool:
    try:
        return os.path.lexists(text)
    except (OSError, ValueError):
        return False


def _rooted(text: str) -> str:
    """A name below /vsi whose absolute path lost its second slash on the way, as pathlib takes it away."""
    found = re.fullmatch(r"(/vsi(?:zip|tar|gzip|7z|rar))/([^/{].*)", text)
    if found is None or _exists(found[2].partition("/")[0]):
        return text
    return f"{found[1]}//{found[2]}" if _exists("/" + found[2].partition("/")[0]) else text


def check_file(path: Path) -> bytes:
    """Return the first bytes of a file, or say why it cannot be read at all; none of a folder.

    Raises
    ------
    InputError
        It does not exist, is empty, or may not be read.
    """
    try:
        if path.is_dir():
            return b""
        if not path.exists():
            raise InputError(f"{path}: no such file; give the path of an existing image file")
        if not path.is_file():
            raise InputError(f"{path}: is not a regular file, an image file is needed")
        with path.open("rb") as file:
            head = file.read(1024)
    except InputError:
        raise
    except PermissionError as error:
        raise InputError(f"{path}: permission denied; make the file readable for this user") from error
    except (OSError, ValueError) as error:  # a name that is too long or holds a null byte
        why = " ".join(str(error).split())
        raise InputError(f"{str(path)[:200]!r}: cannot be opened ({why[:200]}); give an image file") from error
    if not head:
        raise InputError(f"{path}: is empty (0 bytes), an image file is needed")
    return head


def check_utf8(path: str | Path) -> None:
    """Raise where GDAL cannot be given the name of a file."""
    try:
        str(Path(path).absolute()).encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{str(path)!a}: its name or folder is no UTF-8 text, which GDAL needs; rename it") from error
