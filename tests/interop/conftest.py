"""Features of chance, for the conversions and the matchers of other libraries."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from featreg.types import Features


def _features(n: int = 40, width: int = 0, seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(n, width)).astype(np.float32) if width else None
    return Features(
        rng.uniform(0, 100, (n, 2)), rng.uniform(3, 20, n), rng.uniform(0, 6.28, n), rng.uniform(size=n),
        np.zeros(n, np.int64), table,
    )  # fmt: skip


@pytest.fixture(scope="session")
def random_features() -> Callable[..., Features]:
    """Factory of seeded features: ``random_features(n, width, seed)``, with descriptors where ``width`` is given."""
    return _features
