"""What files GDAL may reach from the one that it was given: its overviews and masks, and what a header names."""

from __future__ import annotations

import os
import posixpath
import re
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from featreg.errors import InputError
from featreg.io.gdal_drivers import driver_by_content

if TYPE_CHECKING:
    from featreg.io.gdal_reader import GdalReader

#: The name of a member of an archive, as it is given to GDAL here.
ARCHIVE = re.compile(r"/vsizip/\{(.+?)\}/(.*)", re.DOTALL)
#: Bytes of a file by which its kind is told.
HEAD = 64
#: What follows the name of an image in those of its overviews, of its mask, and of theirs.
COMPANION = re.compile(r"(?:\.(?:ovr|msk))+")
#: What stands before the name of a file of overviews that lies beside its image.
BESIDE = ":::BASE:::"


def check_companions(dataset: Any, called: str) -> None:
    """Raise where overviews or a mask beside an image lie elsewhere, or are none.

    GDAL opens them with whatever driver likes them as soon as it is asked for the files of an image: a virtual raster
    among them leads to any file or address.
    """
    said = dataset.tags(ns="OVERVIEWS").get("OVERVIEW_FILE", "")
    beside = said.removeprefix(BESIDE)
    if said and (beside == said or Path(beside).name != beside):
        raise InputError(f"{called}: names overviews elsewhere ('{said[:80]}'), which is refused; remove that entry")
    image = str(dataset.name)
    paths = os.path if ARCHIVE.fullmatch(image) is None else posixpath
    folder, base = paths.split(image)
    for name in _listed(folder):
        kind = _companion(name.lower(), base.lower(), beside.lower())
        head = None if kind is None else _beginning(paths.join(folder, name))
        if head is None:
            continue
        driver = driver_by_content(head)
        if driver is None or driver.name == "VRT" or (kind == "overviews" and driver.name not in ("GTiff", "HFA")):
            shown = ARCHIVE.sub(r"\1:\2", paths.join(folder, name))
            raise InputError(f"{shown}: is not a file of {kind} as its name says, which is refused; remove it")


def _companion(name: str, image: str, beside: str) -> str | None:
    """What GDAL takes a file for by its name, in whatever letters: overviews or a mask of an image, or of either."""
    if beside and name == beside:
        return "overviews"
    for of in (image, beside) if beside else (image,):
        if name.startswith(of) and COMPANION.fullmatch(name, len(of)):
            return "overviews" if name.endswith(".ovr") else "a mask"
    return None


def _listed(folder: str) -> list[str]:
    """Names in a folder, or in one of an archive; none where it cannot be listed."""
    inside = ARCHIVE.fullmatch(folder + "/")
    try:
        if inside is None:
            return sorted(os.listdir(folder))
        with zipfile.ZipFile(inside[1]) as archive:
            return [name.removeprefix(inside[2]) for name in archive.namelist() if name.startswith(inside[2])]
    except OSError:
        return []


def _beginning(name: str) -> bytes | None:
    """The first bytes of a file, or of the member of an archive, that may not be there."""
    inside = ARCHIVE.fullmatch(name)
    try:
        if inside is None:
            with Path(name).open("rb") as file:
                return file.read(HEAD)
        with zipfile.ZipFile(inside[1]) as archive, archive.open(inside[2]) as member:
            return member.read(HEAD)
    except (OSError, KeyError):
        return None


def within_folder(path: Path, reader: GdalReader) -> GdalReader:
    """Return a reader whose files all lie in the folder of its header or below: a header can name any.

    Raises
    ------
    InputError
        One lies elsewhere; the reader is closed then.
    """
    home = path.parent.resolve()
    for file in reader.reached:
        inside = Path(file).resolve().is_relative_to(home) or Path(file).resolve() == path.resolve()
        if file.startswith("/vsi") or not inside:
            reader.close()
            raise InputError(
                f"{path}: its header reaches outside its folder ('{file[:80]}'), which is refused; put all files of "
                "the image into one folder"
            )
    return reader


def within_archive(archive: str, reader: GdalReader) -> GdalReader:
    """Return a reader whose files all lie in the archive of its header.

    Raises
    ------
    InputError
        One lies elsewhere; the reader is closed then.
    """
    for file in reader.reached:
        if not file.startswith("/vsizip/"):
            reader.close()
            raise InputError(f"{archive}: a header in it reaches outside the archive ('{file[:80]}'), which is refused")
    return reader
