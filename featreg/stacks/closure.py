"""Loop closure: what three pairs round a loop leave, a measure of quality that needs no truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from featreg.stacks.pairs import StackPair


class Loop(NamedTuple):
    """Three images a < b < c and how far, px RMS over the image, the way a-b-c misses the way a-c."""

    a: int
    b: int
    c: int
    misclosure: float


def loops(pairs: Sequence[StackPair]) -> list[Loop]:
    """Return all loops of three trusted pairs, measured by the pairs' own models, before any adjustment."""
    known = {(pair.first, pair.second): pair for pair in pairs if pair.model is not None}
    later: dict[int, list[int]] = {}
    for first, second in sorted(known):
        later.setdefault(first, []).append(second)
    found = []
    for a, seconds in later.items():
        for b in seconds:
            for c in later.get(b, ()):
                if (a, c) in known:
                    one, two, direct = known[a, b].model, known[b, c].model, known[a, c].model
                    if one is not None and two is not None and direct is not None:
                        nodes = known[a, c].nodes
                        missed = two(one(nodes)) - direct(nodes)
                        found.append(Loop(a, b, c, float(np.sqrt((missed**2).sum(axis=1).mean()))))
    return found


def closure_of(found: Sequence[Loop], image: int) -> float | None:
    """Return the RMS of the misclosures of the loops through an image; None where there is none."""
    own = [loop.misclosure for loop in found if image in (loop.a, loop.b, loop.c)]
    return float(np.sqrt(np.mean(np.square(own)))) if own else None
