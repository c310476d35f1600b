"""Which pairs of a stack are expected to be alike, and what is known of them beforehand."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import Stack
from featreg.errors import ParameterError
from featreg.geometry import Affine, Polynomial2
from featreg.simulate import sar_series
from featreg.stacks.expected import days_of_images, expected_coherence, in_order
from featreg.stacks.initial import initial_of, initials, with_one_more
from featreg.stacks.pairs import planned
from featreg.stacks.run import _dates_with

JOB: Any = {"model": "rigid", "workers": 1}


def shift(x: float, y: float = 0.0) -> Affine:
    return Affine(np.array([[1, 0, x], [0, 1, y]]))


def plan(days: list[str], pairs: Any = 1, **more: Any) -> list[tuple[int, int]]:
    known = days_of_images([""] * len(days), days)
    expected = expected_coherence(len(days), known, more.pop("coherence", None))
    return planned(len(days), 0, pairs, more.pop("shared", None), expected, in_order(len(days), known))


def test_regular_dates_are_taken_with_their_next() -> None:
    days = [str(day) for day in np.arange("2023-01-01", "2023-06-01", 12, dtype="datetime64[D]")]
    assert plan(days, 2) == planned(len(days), 0, 2)
    assert plan(days, None) == planned(len(days), 0, None)


def test_short_spans_go_first_and_a_year_before_half_a_year() -> None:
    # Summers and winters: after the next image, that of the same season.
    days = ["20200701", "20210101", "20210701", "20220101", "20220701"]
    expected = expected_coherence(5, days_of_images([""] * 5, days))
    assert expected is not None
    assert expected(0, 2) > expected(0, 1) > expected(0, 3)
    assert plan(days) == [(0, 2), (1, 3), (2, 4), (3, 4)]
    assert plan(["20200101", "20200113", "20210101", "20210113"]) == [(0, 1), (1, 2), (2, 3)]


def test_dates_in_any_order_make_the_chain_of_time() -> None:
    assert plan(["20230301", "20230101", "20230201"], "chain") == [(0, 2), (1, 2)]
    assert plan(["20230301", "20230101", "20230201"]) == [(0, 2), (1, 2)]


def test_of_the_likely_those_that_share_more_ground() -> None:
    days = ["20230101", "20230113", "20230125", "20230206"]
    shared = {(0, 1): 0.3, (0, 2): 0.9, (0, 3): 0.5}
    assert (0, 2) in plan(days, shared=lambda i, k: shared.get((i, k)))
    assert (0, 1) not in plan(days, shared=lambda i, k: shared.get((i, k)))


def test_what_the_user_expects_counts_in_place_of_dates() -> None:
    table = np.full((4, 4), np.nan)
    table[np.triu_indices(4, 1)] = [0.1, 0.2, 0.9, 0.0, 0.5, 0.4]
    for given in (table, lambda i, k: table[i, k]):
        assert plan(["20230101"] * 4, coherence=given) == [(0, 3), (1, 3), (2, 3)]
        assert plan(["20230101"] * 4, "all", coherence=given) == [(0, 1), (0, 2), (0, 3), (1, 3), (2, 3)]
    for wrong in (np.zeros((3, 3)), "high", lambda i, k: 1.5, lambda i, k: "high", np.full((4, 4), np.inf)):
        with pytest.raises(ParameterError, match="coherence"):
            plan(["20230101"] * 4, coherence=wrong)
    asked: list[tuple[int, int]] = []

    def half(i: int, k: int) -> float:
        asked.append((i, k))
        return 0.5

    plan(["20230301", "20230201", "20230101"], coherence=half)
    assert asked
    assert all(i < k for i, k in asked)


def test_days_come_from_names_or_are_given() -> None:
    import pandas as pd

    names = ["S1A_IW_GRDH_1SDV_20240107T053000_x.tif", "b-20240119.tif"]
    assert days_of_images(names, None) == [date(2024, 1, 7), date(2024, 1, 19)]
    assert days_of_images([*names, "c.tif"], None) is None
    assert days_of_images([*names, "frame_20230231.tif"], None) is None
    given: Any = [date(2024, 1, 7), "2024-01-19"]
    assert days_of_images(["a", "b"], given) == days_of_images(["a", "b"], np.array(given, "datetime64[D]"))
    assert days_of_images(["a", "b"], pd.Series(pd.to_datetime(given))) == [date(2024, 1, 7), date(2024, 1, 19)]
    none: Any = (["20240107"], "20240107", ["20240107", "20241301"], ["20240107", pd.NaT], 20240107)
    for wrong in none:
        with pytest.raises(ParameterError, match="dates must be"):
            days_of_images(["a", "b"], wrong)


def test_models_of_images_say_what_is_known_of_pairs() -> None:
    kept = initials([shift(0), shift(3, 1), None, np.array([[1.0, 0, -2], [0, 1, 5]])], 4)
    known = initial_of(kept, 1, 3)
    assert known is not None
    np.testing.assert_allclose(known([[10.0, 10.0]]), [[5.0, 14.0]])
    assert initial_of(kept, 0, 2) is None
    longer = with_one_more(kept, shift(7), 5)
    known = initial_of(longer, 1, 4)
    assert known is not None
    np.testing.assert_allclose(known([[0.0, 0.0]]), [[4.0, -1.0]])
    bent = Polynomial2(np.array([[0.0, 1, 0, 1e-4, 0, 0], [0.0, 0, 1, 0, 0, 0]]), (0.0, 0.0), 1.0)
    known = initial_of(initials([shift(2), bent], 2), 0, 1)
    assert known is not None
    np.testing.assert_allclose(known([[12.0, 3.0]]), bent([[10.0, 3.0]]))


def test_models_of_pairs_are_taken_either_way_round() -> None:
    kept = initials({(0, 1): shift(3), (2, 1): shift(-4)}, 3)
    for pair, wanted in (((0, 1), [3.0, 0.0]), ((1, 2), [4.0, 0.0])):
        known = initial_of(kept, *pair)
        assert known is not None
        np.testing.assert_allclose(known([[0.0, 0.0]]), [wanted])
    assert initial_of(kept, 0, 2) is None
    assert initial_of(with_one_more(kept, None, 4), 0, 1) is not None
    assert initial_of(with_one_more(kept, {(3, 0): shift(1)}, 4), 0, 3) is not None


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (shift(3), "same of every pair"),
        ([[1, 0, 4], [0, 1, 0], [0, 0, 1]], "same of every pair"),
        ([shift(0), shift(1)], "2 models for 3 images"),
        ("result.json", "cannot be str"),
        ({(0, 3): shift(1)}, "numbered 0 to 2"),
        ({1: shift(1)}, "no pair"),
        ({(0, 1.5): shift(1)}, "no pair"),
        ({(0, 1): shift(1), (1, 0): shift(1)}, "both ways round"),
        ([shift(0), None, [[1, 0], [0, 1]]], "initial of image 2"),
    ],
)
def test_initial_that_cannot_be_meant_is_refused(given: Any, words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        featreg.register_stack([np.eye(64)] * 3, initial=given)


def test_what_would_count_for_no_pair_or_for_all_is_refused() -> None:
    for given, words in (({"search_radius": 5.0}, "search_radius needs initial"), ({"prior": "r.json"}, "prior of a")):
        with pytest.raises(ParameterError, match=words):
            featreg.register_stack([np.eye(64)] * 3, **given)


def test_a_stack_with_models_known_beforehand(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Shifts beyond what a small radius finds by itself; the table of what was known goes through the file."""
    series = sar_series(4, (200, 200), looks=4, seed=2)
    known = [Affine(truth) for truth in series.truths]
    told: list[tuple[int, int]] = []
    job: Any = {**JOB, "search_radius": 6.0, "pairs": "chain"}
    stack = featreg.register_stack(
        series.images[:3], initial=known[:3], dates=["20230101", "20230113", "20230125"], **job,
        progress=lambda *n: told.append(n),
    )  # fmt: skip
    assert stack.status == ["ok"] * 3
    assert told == [(1, 2), (2, 2)]
    stack.to_json(tmp_path / "stack.json")
    again = Stack.from_json(tmp_path / "stack.json")
    again = type(again)(**{**vars(again), "images": list(series.images[:3])})
    with pytest.raises(ParameterError, match=r"or a \(4, 4\) table"):
        again.add(series.images[3], initial=known[3], date="20230206", coherence=np.ones((3, 3)))
    longer = again.add(series.images[3], initial=known[3], date="20230206", workers=1)
    assert longer.status == ["ok"] * 4
    assert longer.provenance["dates"] == ["2023-01-01", "2023-01-13", "2023-01-25", "2023-02-06"]
    # Days are known of all images or count for none, which is said.
    assert _dates_with(again, "b_20230206.tif", None) == [*longer.provenance["dates"][:3], date(2023, 2, 6)]
    assert _dates_with(again, series.images[3], None) is None
    assert "the day of the new image is not known" in caplog.text
    model = longer.models[3]
    assert model is not None
    assert np.abs(model([[100.0, 100.0]]) - known[3]([[100.0, 100.0]])).max() < 0.5


def test_progress_never_goes_back() -> None:
    """The image of another place is tried again with further ones: one count goes on over all batches."""
    series = sar_series(4, (160, 160), looks=4, unrelated=2, seed=4)
    told: list[tuple[int, int]] = []
    featreg.register_stack(series.images, pairs="chain", progress=lambda *n: told.append(n), **JOB)
    assert [done for done, _ in told] == list(range(1, len(told) + 1))
    assert len(told) > 3
    assert told[-1][0] == told[-1][1]
