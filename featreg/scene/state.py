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


class BlockFiles:
    """The block files of one run in a folder.

    Parameters
    ----------
    folder : made if it does not exist
    digest : of everything that the content of a block depends on

    Raises
    ------
    InputError
        The folder cannot be made or written to.
    """

    def __init__(self, folder: str | Path, digest: str) -> None:
        self.folder, self.digest = check_folder(folder), digest
        # What a killed run left half written.
        for stray in self.folder.glob(f".block_{digest[:12]}_*.tmp"):
            stray.unlink(missing_ok=True)

    def path(self, block: Block) -> Path:
        return self.folder / f"block_{self.digest[:12]}_{block.row:04d}_{block.col:04d}.npz"

    def load(self, block: Block) -> BlockResult | None:
        """The finished block, or None where there is no sound file of it."""
        path = self.path(block)
        try:
            content = path.read_bytes()
            columns = load_arrays(io.BytesIO(content))
            if str(columns.pop("digest")) != self.digest or str(columns.pop("checksum")) != digest_arrays(columns):
                raise ValueError("its digest or its checksum is not that of this block")
            result = from_columns(columns)
            if result.index != block.index:
                raise ValueError("it holds another block")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            logger.warning("block file %s is not used, its block is computed again (%s)", path, error)
            return None
        return result

    def save(self, block: Block, result: BlockResult) -> None:
        """Write a finished block; the file appears whole or not at all."""
        columns = columns_of(result)
        buffer = io.BytesIO()
        np.savez(buffer, digest=np.array(self.digest), checksum=np.array(digest_arrays(columns)), **columns)  # type: ignore[arg-type]
        # A file that a power cut leaves short is found out by its checksum.
        write_atomic(self.path(block), buffer.getbuffer(), sync=False)
