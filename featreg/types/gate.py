"""One condition of trust."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Gate:
    """One condition of trust: `value` must be at least `low` and at most `high` (either may be None)."""

    value: float | None
    passed: bool
    low: float | None = None
    high: float | None = None
    meaning: str = ""
