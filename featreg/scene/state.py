"""Finished blocks on disk: one file each, so that a run that was killed goes on where it stopped.

A file is an NPZ without pickles, named after its block and the digest of everything its content depends on (inputs,
method, parameters, plan, prior, versions). It carries that digest and a checksum of its arrays. What does not fit (cut
short, damaged, of another run, not ours at all) is not used, and its block is computed again.
"""

from __future__ import annotations

import io
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.results.json_file import plain
from featreg.runtime.digests import digest_arrays, digest_json
from featreg.runtime.files import write_atomic
from featreg.runtime.numpy_files import load_arrays
from featreg.scene.blocks import Block
from featreg.scene.task import BlockResult, columns_of, from_columns

logger = logging.getLogger(__name__)


def digest_of(content: Mapping[str, Any]) -> str:
    """SHA-256 of values in a canonical form."""
    return digest_json(plain(content))


def check_folder(folder: str | Path) -> Path:
    """Make the folder of a run's blocks if it does not exist.

    Raises
    ------
    InputError
        It cannot be made or written to.
    """
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"resume folder '{folder}': cannot be made ({error.strerror}); give a folder") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"resume folder '{folder}': may not be written to, choose another")
    return Path(folder)


class ArrayFiles:
    """Named arrays of finished tasks of one run in a folder, one file a task.

    Parameters
    ----------
    folder : made if it does not exist
    digest : of everything that the content of the files depends on
    kind : what the tasks are, the first word of the files' names

    Raises
    ------
    InputError
        The folder cannot be made or written to.
    """

    def __init__(self, folder: str | Path, digest: str, kind: str) -> None:
        self.folder, self.digest, self.kind = check_folder(folder), digest, kind
        # What a killed run left half written.
        for stray in self.folder.glob(f".{kind}_{digest[:12]}_*.tmp"):
            stray.unlink(missing_ok=True)

    def path(self, name: str) -> Path:
        return self.folder / f"{self.kind}_{self.digest[:12]}_{name}.npz"

    def load(self, name: str) -> dict[str, Any] | None:
        """The arrays of a task, or None where there is no sound file of it."""
        path = self.path(name)
        try:
            columns = load_arrays(io.BytesIO(path.read_bytes()))
            if str(columns.pop("digest")) != self.digest or str(columns.pop("checksum")) != digest_arrays(columns):
                raise ValueError(f"its digest or its checksum is not that of this {self.kind}")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            self.refuse(name, error)
            return None
        return columns

    def refuse(self, name: str, error: Exception) -> None:
        """Say that a file is not used."""
        logger.warning(
            "%s file %s is not used, its %s is computed again (%s)", self.kind, self.path(name), self.kind, error
        )

    def save(self, name: str, columns: Mapping[str, Any]) -> None:
        """Write the arrays of a finished task; the file appears whole or not at all."""
        buffer = io.BytesIO()
        np.savez(buffer, digest=np.array(self.digest), checksum=np.array(digest_arrays(columns)), **columns)
        # A file that a power cut leaves short is found out by its checksum.
        write_atomic(self.path(name), buffer.getbuffer(), sync=False)


class BlockFiles:
    """The block files of one run in a folder; parameters and errors as `ArrayFiles`."""

    def __init__(self, folder: str | Path, digest: str) -> None:
        self._files = ArrayFiles(folder, digest, "block")
        self.folder, self.digest = self._files.folder, digest

    def path(self, block: Block) -> Path:
        return self._files.path(_name(block))

    def load(self, block: Block) -> BlockResult | None:
        """The finished block, or None where there is no sound file of it."""
        columns = self._files.load(_name(block))
        if columns is None:
            return None
        try:
            result = from_columns(columns)
            if result.index != block.index:
                raise ValueError("it holds another block")
        except (ValueError, KeyError, TypeError) as error:
            self._files.refuse(_name(block), error)
            return None
        return result

    def save(self, block: Block, result: BlockResult) -> None:
        """Write a finished block; the file appears whole or not at all."""
        self._files.save(_name(block), columns_of(result))


def _name(block: Block) -> str:
    return f"{block.row:04d}_{block.col:04d}"
