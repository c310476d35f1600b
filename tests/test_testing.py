"""The conformance kit: plugins of ours pass it, and each defect of a bad one is named."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import Features, Filter, FilterContext, Image, Matches, registry
from featreg.errors import PluginError, UnknownNameError
from featreg.testing import check_plugin

OURS = [
    ("detector", "sar-ofast"),
    ("descriptor", "brief"),
    ("descriptor", "ratio-gloh"),
    ("nearest", "brute-force"),
    ("filter", "fsc"),
    ("filter", "gms"),
    ("matcher", "patch-grid"),
]


@pytest.mark.parametrize(("kind", "name"), OURS, ids=[f"{k}:{n}" for k, n in OURS])
def test_our_own_pass(kind: str, name: str) -> None:
    passed = check_plugin(kind, name)
    assert passed[:4] == ("parameters", "docstring", "same bits again", "pickled")
    assert len(passed) >= 6


def test_parameters_reach_the_plugin_and_symmetry_can_be_left_out() -> None:
    assert "mirror image" not in check_plugin("detector", "sar-ofast", symmetric=False, levels=2)
    with pytest.raises(UnknownNameError):
        check_plugin("filter", "no-such")
    for kind in ("model", "detectr"):
        with pytest.raises(UnknownNameError, match=f"no plugins of kind '{kind}' can be checked"):
            check_plugin(kind, "affine")


@pytest.fixture
def registered() -> Iterator[set[tuple[str, str]]]:
    """The names known before; what a test registers is gone afterwards."""
    before = set(registry._entries)
    yield before
    for key in set(registry._entries) - before:
        del registry._entries[key]


CALLS = itertools.count()


def test_every_defect_of_a_filter_is_named(registered: set[tuple[str, str]]) -> None:
    @featreg.register("bad-filter")
    class Bad(Filter):
        def __init__(self, limit=2.0) -> None:  # type: ignore[no-untyped-def]
            self.most = limit

        def keep(self, matches: Matches, context: FilterContext) -> NDArray[np.bool_]:
            self.last = matches
            return np.full(len(matches) + (len(matches) == 3), next(CALLS) % 2 == 0)

    with pytest.raises(PluginError) as caught:
        check_plugin("filter", "bad-filter")
    for words in (
        "filter 'bad-filter' fails",
        "parameter 'limit' is not kept under its own name",
        "does not say what limit mean",
        "a second run gives another result",
        "pickled: it raised",  # a class inside a function
        "3 matches give a mask of shape (4,)",
    ):
        assert words in str(caught.value)


def test_every_defect_of_a_detector_is_named(registered: set[tuple[str, str]]) -> None:
    @featreg.register("bad-detector")
    @dataclass(frozen=True)
    class Bad(featreg.Detector):
        """Bright pixels, half a pixel off to the right, worst first, whatever the mask says.

        Parameters
        ----------
        n_features : not heeded
        """

        n_features: int = 100

        def detect_features(self, image: Image) -> Features:
            rows, columns = np.unravel_index(np.argsort(image.pixels, axis=None)[-50:], image.shape)
            xy = np.column_stack([columns + 0.5, rows]).astype(np.float64)
            score = np.arange(len(xy), dtype=np.float64)
            return Features(xy, np.full(50, 20.0), np.zeros(50), score, np.zeros(50, np.int64))

    with pytest.raises(PluginError) as caught:
        check_plugin("detector", "bad-detector")
    for words in (
        "not in the order of their score",
        "n_features=5 gives 50 points",
        "is the centre of the first pixel (0, 0)?",
        "reaches over pixels without data",
        "a constant image has points",
    ):
        assert words in str(caught.value)


def test_a_search_that_takes_two_kinds_is_named(registered: set[tuple[str, str]]) -> None:
    @featreg.register("bad-nearest")
    class Bad(featreg.Nearest):
        """Pairs the first with the first."""

        def match_features(self, reference: Features, secondary: Features) -> tuple[Any, Any]:
            n = min(len(reference), len(secondary))
            return np.column_stack([np.arange(n), np.arange(n)]), np.ones(n)

    with pytest.raises(PluginError, match="do not find themselves") as caught:
        check_plugin("nearest", "bad-nearest")
    assert "descriptors of two kinds must be refused" in str(caught.value)


def test_a_filter_that_goes_by_the_score_is_named(registered: set[tuple[str, str]]) -> None:
    @featreg.register("bad-score")
    class Bad(Filter):
        """Those of the better scores."""

        def keep(self, matches: Matches, context: FilterContext) -> NDArray[np.bool_]:
            return np.asarray(matches.score > np.median(matches.score)) if len(matches) else np.zeros(0, np.bool_)

    with pytest.raises(PluginError, match="where all scores are equal") as caught:
        check_plugin("filter", "bad-score")
    assert "of what an affine map explains, 80 % are expected" in str(caught.value)
