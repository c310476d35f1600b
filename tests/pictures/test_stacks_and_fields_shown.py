"""What interactive Python shows of a stack and of a displacement field: short texts, small cards, figures, frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import featreg
from featreg.displacement.cells import CellGrid, Reason
from featreg.geometry import Translation
from featreg.results.input_image import InputImage
from featreg.stacks.jumps import Jump


def stack() -> featreg.Stack:
    count = 70
    models: list[Any] = [Translation.from_estimate(np.zeros((2, 2)), np.full((2, 2), 0.1 * i)) for i in range(count)]
    models[3] = None
    status = ["left out" if model is None else "ok" for model in models]
    reasons = ["no trusted pair <leads> here" if model is None else "" for model in models]
    closure = [None if i == 3 else 0.05 for i in range(count)]
    errors = np.where(np.arange(count) == 3, np.nan, 0.02)
    names = [f"date_{i}.tif" for i in range(count)]
    return featreg.Stack(names, 0, (100, 120), models, status, reasons, errors, closure, [], [Jump(5, 1.0, -0.5)], [])


def field() -> featreg.Offsets:
    grid = CellGrid((128, 160), 16, 32)
    shape = grid.cells
    reason = np.zeros(shape, np.uint8)
    reason[0] = Reason.OUTSIDE
    dx = np.where(reason == 0, 1.5, np.nan)
    covariance = np.broadcast_to(0.01 * np.eye(2), (*shape, 2, 2)).copy()
    images = InputImage("a.tif", (128, 160)), InputImage("b.tif", (128, 160))
    return featreg.Offsets(grid, dx, -dx, covariance, np.ones(shape), np.full(shape, 20.0), reason, *images)


@pytest.mark.parametrize("make", [stack, field])
def test_texts_are_short_and_cards_whole_and_small(make: Any) -> None:
    thing = make()
    assert len(repr(thing)) < 500
    card = thing._repr_html_()
    assert len(card.encode()) < 500_000
    assert card.count("<div") == card.count("</div>")
    assert "<script" not in card
    assert "prefers-color-scheme" in card
    assert thing.summary() == str(thing)
    assert len(thing.to_dataframe()) == len(thing.names if make is stack else thing.dx.ravel())
    figure = thing.plot()
    assert type(figure).__name__ == "Figure"
    assert len(figure.axes) >= 3


def test_a_card_of_a_stack_says_what_was_left_out() -> None:
    card = stack()._repr_html_()
    assert "69 of 70 on the grid of date_0.tif" in card
    assert "no trusted pair &lt;leads&gt; here" in card
    assert "10 further images are not shown" in card
    assert repr(stack()) == "Stack(69 of 70 images on 120 x 100 px, 0 pairs)"


def test_a_card_of_a_field_says_why_cells_have_none() -> None:
    made = field()
    card = made._repr_html_()
    assert "median 2.12 px" in card
    assert "the window leaves one of the images" in card
    frame = made.to_dataframe()
    assert set(frame["reason"]) == {"good", "outside"}
    np.testing.assert_allclose(frame.loc[frame["reason"] == "good", "dy"], -1.5)
