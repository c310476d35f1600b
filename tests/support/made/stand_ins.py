"""Matches of known errors, and methods that stand for real ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from featreg.geometry import Rigid
from featreg.interfaces import Matcher
from featreg.types import Image, Matches

TRUTH = Rigid(4.0, 3.0, -2.0)
#: method -> (matches at GMS, px of error of each)
ERRORS = {"sharp": [0.3] * 8 + [9.0] * 2, "blunt": [1.2] * 5 + [9.0] * 5}


@dataclass(frozen=True)
class Stand(Matcher):
    """A Matcher object; `weights` stands for a parameter that is an array."""

    weights: Any = 0
    count: int = 10

    def match(self, reference: Image, secondary: Image) -> Matches:
        return Matches.empty()


class Calls(list[tuple[str, int]]):
    """Every call of the stand-in for `featreg.match`."""


def noise_image(seed: int = 0) -> Any:
    return np.random.default_rng(seed).random((80, 100)).astype(np.float32)
