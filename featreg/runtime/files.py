"""Files that appear whole or not at all: written under a temporary name, then renamed.

A link keeps pointing where it did and its target is replaced; what is replaced keeps its permissions; what exists and
is no regular file (a pipe, a terminal, /dev/stdout) is written into.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from featreg.errors import InputError

#: How the names of files end whose kind nobody doubts.
TOLD = (
    ".json", ".geojson", ".csv", ".md", ".tex", ".parquet", ".tif", ".tiff", ".vrt", ".nc", ".zarr", ".h5", ".npy",
    ".mat", ".png", ".jpg", ".pdf", ".svg", ".html", ".yaml", ".yml", ".toml",
)  # fmt: skip


def check_ending(path: str | Path, *endings: str) -> None:
    """Raise where a name says another kind of file than what is written; names that say nothing are the caller's.

    Raises
    ------
    InputError
        The name ends as that of another kind of file than `endings` do.
    """
    ending = Path(path).suffix.lower()
    if ending in TOLD and ending not in endings:
        raise InputError(f"'{path}' would be no {ending} file; give a name that ends in {' or '.join(endings)}")


def write_atomic(path: str | Path, content: bytes | memoryview, *, sync: bool = True) -> None:
    """Write a file; no reader ever meets half of it.

    Parameters
    ----------
    path : an existing file is replaced
    content : of the file
    sync : wait until the disk has it, so that a power cut leaves the old file or the new one; without, perhaps a short
        one

    Raises
    ------
    InputError
        The file cannot be written.
    """
    try:
        if is_stream(path):
            with _stream(path) as file:
                file.write(content)
            return
        target, temporary = _names(path)
        try:
            with open(temporary, "wb") as file:
                file.write(content)
                if sync:
                    file.flush()
                    os.fsync(file.fileno())
            _rename(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from error


@contextlib.contextmanager
def temporary_path(path: str | Path) -> Iterator[Path]:
    """Give a path of the same name to write to, and move what was written there to `path` at the end.

    It lies in a folder of its own, since some writers put files of their own beside the one they write. What `OSError`
    is raised passes through.
    """
    name = Path(path).name
    if is_stream(path):
        with tempfile.TemporaryDirectory(prefix="featreg-") as made:
            temporary = Path(made, name)
            yield temporary
            with open(temporary, "rb") as content, _stream(path) as file:
                shutil.copyfileobj(content, file)
        return
    target, folder = _names(path)
    try:
        folder.mkdir()
        yield folder / name
        _rename(folder / name, target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def is_stream(path: str | Path) -> bool:
    """Whether a path is to be written into rather than replaced: it exists and is neither a file nor a folder.

    An open file of a process (/dev/stdout, /dev/fd/3) is one too, even where it leads to a file: a rename would leave
    the process with the old one.
    """
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    if not stat.S_ISREG(mode):
        return not stat.S_ISDIR(mode)
    step = os.fspath(path)
    while os.path.islink(step):
        folder = os.path.realpath(os.path.dirname(step))
        if folder.startswith("/proc/"):
            return True
        step = os.path.join(folder, os.readlink(step))
    return False


def folder_of(path: str | Path) -> Path:
    """The folder in which a file is made when `path` is written: that of the target, where it is a link."""
    return Path(os.path.realpath(path) if os.path.islink(path) else path).parent


def _names(path: str | Path) -> tuple[Path, Path]:
    """The target of a path, and a temporary name beside it."""
    target = Path(os.path.realpath(path))
    return target, target.with_name(f".{target.name}.{uuid.uuid4().hex}.tmp")


def _rename(temporary: Path, target: Path) -> None:
    try:
        before = os.stat(target)
    except FileNotFoundError:
        pass
    else:
        # Only the superuser may give a file away.
        with contextlib.suppress(OSError, AttributeError):
            os.chown(temporary, before.st_uid, before.st_gid)
        os.chmod(temporary, stat.S_IMODE(before.st_mode))
    os.replace(temporary, target)


def _stream(path: str | Path) -> BinaryIO:
    # Not cut short: behind /dev/stdout there may be a file to which others write too.
    return open(os.open(path, os.O_WRONLY | os.O_APPEND), "wb")
