"""The scene of `located_pair`, matched in blocks."""

from __future__ import annotations

from typing import Any

import pytest

import featreg
from featreg.results.registration import Registration
from made.scene_results import BLOCK


@pytest.fixture(scope="session")
def result(located_pair: Any) -> Registration:
    return featreg.match(located_pair.reference, located_pair.secondary, **BLOCK)
