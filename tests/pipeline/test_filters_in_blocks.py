"""Filters in blocks: their order, the initial model that they are told, and cancelling after the last block."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import CancelledError
from featreg.interfaces import Filter, FilterContext
from featreg.simulate import SimulatedPair
from featreg.types import BoolArray, Matches

# How the work is run


def test_a_scene_is_cancelled_in_its_last_part_too(pair: SimulatedPair) -> None:
    event = threading.Event()

    class Stop(Seen):
        def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
            event.set()
            return super().keep(matches, context)

    with pytest.raises(CancelledError, match="resume="):
        in_blocks(pair, ["gms", Stop(), "fsc"], cancel=event)


# Filters in blocks


class Seen(Filter):
    """Keeps everything, and remembers what it was told."""

    def __init__(self) -> None:
        self.calls: list[tuple[int, Any, tuple[int, int]]] = []

    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        there = None if context.initial is None else context.initial(matches.reference_xy) - matches.secondary_xy
        self.calls.append((len(matches), there, context.reference_shape))
        return np.ones(len(matches), np.bool_)


class LocalSeen(Seen):
    """The same, in every block."""

    local = True


def in_blocks(pair: SimulatedPair, filters: list[Any], **more: Any) -> featreg.Registration:
    return featreg.match(
        pair.reference, pair.secondary, filters=filters, block=150, workers=1, n_features=400,
        locate=False, refine=False, initial=pair.truth, search_radius=20.0, **more,
    )  # fmt: skip


def test_filters_run_in_the_order_asked_for_in_blocks_too(pair: SimulatedPair) -> None:
    first, then = Seen(), LocalSeen()
    made = in_blocks(pair, [first, then])
    assert list(made.stages) == ["prior", "initial", "seen", "localseen"]
    # A filter that looks at neighbourhoods runs over all where one that looks at everything ran before it.
    assert len(first.calls) == len(then.calls) == 1
    assert then.calls[0][2] == pair.reference.shape
    swapped = in_blocks(pair, [LocalSeen(), Seen()])
    assert list(swapped.stages) == ["prior", "localseen", "initial", "seen"]


def test_a_filter_knows_the_initial_model_in_the_pixels_of_its_block(pair: SimulatedPair) -> None:
    keeper = LocalSeen()
    in_blocks(pair, [keeper, "fsc"])
    told = [(count, off, shape) for count, off, shape in keeper.calls if count]
    assert len(told) > 4
    for _, off, shape in told:
        assert shape != pair.reference.shape
        assert off is not None
        # What the prior kept lies near the truth, seen in the windows of the block as in the whole images.
        assert np.median(np.hypot(*off.T)) < 3
