"""Whether a focus can be trusted: its gates, and one line on those that failed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from featreg.focusing import autofocus
from featreg.types import Gate

#: Range cells below which nothing can be held out.
LEAST_CELLS = 4
#: Pulses with signal from which a phase beyond its constant and linear part can be told.
LEAST_PULSES = 8

#: Fall of the image's entropy, nats, from which held-out cells must become sharper too.
CLAIM = 0.1


def gates_of(cells: int, pulses: int, check: autofocus.Check, entropy: tuple[float, float]) -> dict[str, Gate]:
    """Return the gates of a focus that looked at so many cells and pulses; `entropy` is before and after, nats."""
    # Without two places in range nothing can be held out, however many cells there are: their number tells nothing.
    apart = bool(np.isfinite(check.halves))
    deviation, half, unsettled, gain = (
        value if apart and cells >= LEAST_CELLS else None
        for value in (check.deviation, check.halves / 2, check.unsettled, check.gain)
    )
    limit = autofocus.LIMIT
    rise = entropy[1] - entropy[0]
    # Where the image was sharp before, a half's phase has nothing to sharpen, and its noise blurs the other half.
    claimed = rise < -CLAIM
    return {
        "pulses": Gate(pulses, LEAST_PULSES, None, "pulses that carry signal"),
        "cells": Gate(cells if apart or cells < LEAST_CELLS else None, LEAST_CELLS, None,
                      "range cells, of two places in range at least"),
        "deviation": Gate(deviation, None, limit, "expected error of the phase, radians RMS"),
        "held out": Gate(half, None, limit,
                         "half the difference of the phases of two halves of the range cells, radians RMS"),
        "settled": Gate(unsettled, None, limit,
                        "how far the phase moves when minimum entropy goes on from it, radians RMS"),
        "sharpness": Gate(gain, 0.0 if claimed else None, None,
                          "entropy by which one half's phase sharpens the other half, nats"),
        "entropy": Gate(rise, None, 0.01, "rise of the image's entropy, nats"),
    }  # fmt: skip


def reason_of(failed: Mapping[str, Gate]) -> str:
    """Return one line on the gates that failed."""
    texts = {
        "pulses": "too few pulses carry signal for a phase to be seen",
        "cells": "too few range cells with independent scatterers to check the phase",
        "held out": "the halves of the range cells find different phases (homogeneous speckle, or a collapsed image)",
        "settled": "the phase does not stay where it is when the entropy is minimised further",
        "sharpness": "the phase of one half of the range cells does not sharpen the other half",
        "entropy": "the entropy of the image rose",
        "deviation": "the expected error of the phase is too large",
    }
    names = [name for name in texts if name in failed]
    if names[0] in ("pulses", "cells"):
        few = failed[names[0]]
        found = "they lie in one place in range" if few.value is None else f"{few.value:.0f}, {few.low:.0f} are needed"
        return f"{texts[names[0]]}: {found}"
    if len(names) > 1 and "deviation" in names:
        names.remove("deviation")
    values = {name: failed[name].value for name in names}
    return "; ".join(texts[name] + ("" if value is None else f": {value:.2f}") for name, value in values.items())
