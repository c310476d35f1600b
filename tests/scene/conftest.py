"""The scene of `located_pair`, matched in blocks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import featreg
from featreg.results.registration import Registration
from made.scene_results import BLOCK


@pytest.fixture(scope="session")
def undisturbed(located_pair: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Registration]:
    """A folder with every block file, and the result."""
    folder = tmp_path_factory.mktemp("state")
    result = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, resume=folder)
    return folder, result


@pytest.fixture(scope="session")
def result(undisturbed: tuple[Path, Registration]) -> Registration:
    return undisturbed[1]
