"""One condition of trust, and what all of them say together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from featreg.errors import InputError


@dataclass(frozen=True)
class Gate:
    """One condition of trust: a known `value`, at least `low` and at most `high`.

    Parameters
    ----------
    value : what was found; None, as whatever is not finite becomes, where it cannot be told
    low, high : the limits, None for none
    meaning : of the value, with its unit
    unknown : why the value cannot be told, where it cannot
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    meaning: str = ""
    unknown: str = ""

    def __post_init__(self) -> None:
        if self.value is not None:
            object.__setattr__(self, "value", float(self.value) if math.isfinite(self.value) else None)

    @property
    def passed(self) -> bool:
        """Whether the value is known and within the limits."""
        if self.value is None:
            return False
        return bool((self.low is None or self.value >= self.low) and (self.high is None or self.value <= self.high))

    @property
    def failure(self) -> str:
        """Why it failed, in words; empty where it passed."""
        if self.passed:
            return ""
        if self.value is None:
            found = f"cannot be told: {self.unknown}" if self.unknown else "cannot be told"
        elif self.low is not None and self.value < self.low:
            found = f"{self.value:.3g} is below {self.low:.3g}"
        else:
            found = f"{self.value:.3g} is above {self.high:.3g}"
        return f"{found} ({self.meaning})"

    def to_dict(self) -> dict[str, Any]:
        """Return what a file holds of it: value, passed, low, high, meaning, and unknown where there is a reason."""
        limits = {"low": self.low, "high": self.high}
        why = {"unknown": self.unknown} if self.unknown else {}
        return {"value": self.value, "passed": self.passed, **limits, "meaning": self.meaning, **why}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the gate that `to_dict` wrote.

        Raises
        ------
        InputError
            `passed` contradicts the value and its limits.
        """
        given = dict(values)
        said = given.pop("passed")
        made = cls(**given)
        if made.passed is not said:
            limits = f"{made.value} (at least {made.low}, at most {made.high})"
            raise InputError(f"a gate says passed = {said}, its value {limits} says {made.passed}")
        return made


def in_words(failed: Mapping[str, Gate]) -> str:
    """Return the name of every gate and why it failed."""
    return "; ".join(f"{name} {gate.failure}" for name, gate in failed.items())


def verdict(gates: Mapping[str, Gate], reason: Callable[[Mapping[str, Gate]], str] = in_words) -> tuple[str, str]:
    """Return "ok" and no reason where every gate passed, else "unreliable" and the reason.

    Parameters
    ----------
    gates : name -> gate
    reason : puts the gates that failed, at least one, into words
    """
    failed = {name: gate for name, gate in gates.items() if not gate.passed}
    return ("unreliable", reason(failed)) if failed else ("ok", "")
