"""A module of ill-behaved plugins."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import pytest

from made.rogue_plugins import ROGUES


@pytest.fixture(scope="session")
def rogues(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A module of ill-behaved plugins, importable in workers too."""
    home = tmp_path_factory.mktemp("rogues")
    (home / "rogues.py").write_text(ROGUES)
    sys.path.insert(0, str(home))
    import rogues  # type: ignore[import-not-found]

    yield rogues
    sys.path.remove(str(home))
