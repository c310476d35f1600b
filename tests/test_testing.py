"""The conformance kit: each defect of a bad plugin is named. That ours pass it: tests/test_plugins.py."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import Features, Filter, FilterContext, Image, Matches, registry
from featreg.errors import PluginError, UnknownNameError
from featreg.testing import check_plugin


def test_parameters_reach_the_plugin_and_checks_can_be_left_out() -> None:
    passed = check_plugin("detector", "sar-ofast", symmetric=False, leave_out=["gain"], levels=2)
    assert passed == ("parameters", "docstring", "same bits again", "pickled", "points", "nodata", "nothing there")
    with pytest.raises(UnknownNameError, match="no check 'gian' of a detector, did you mean 'gain'"):
        check_plugin("detector", "sar-ofast", leave_out=["gian"])
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


@dataclass(frozen=True)
class Corners(featreg.Detector):
    """FAST corners whose support has data."""

    heeds: ClassVar[bool] = True

    def detect_features(self, image: Image) -> Features:
        grey = np.clip(image.amplitude * np.float32(60), 0, 255).astype(np.uint8)
        found = Features.from_keypoints(cv2.FastFeatureDetector.create(30).detect(cv2.GaussianBlur(grey, (5, 5), 0)))
        inside = np.ones(len(found), np.bool_)
        if self.heeds:
            from_nodata = cv2.distanceTransform(image.mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            inside = from_nodata[found.xy[:, 1].astype(int), found.xy[:, 0].astype(int)] > 8
        kept = found.take(np.flatnonzero(inside))
        return replace(kept, scale=np.full(len(kept), 8.0), angle=np.zeros(len(kept))).best(len(kept))


class UnmaskedCorners(Corners):
    """The same, whether there are data or not."""

    heeds = False


CORNERS = {True: Corners, False: UnmaskedCorners}
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


def test_a_detector_that_takes_what_is_under_the_mask_for_data_is_named(registered: set[tuple[str, str]]) -> None:
    """FAST corners are right in everything else, and those of which the mask is asked are right in all."""
    for name, heeds in (("masked-corners", True), ("unmasked-corners", False)):
        featreg.register(name)(CORNERS[heeds])
    assert "nodata" in check_plugin("detector", "masked-corners", leave_out=["gain"])
    with pytest.raises(PluginError) as caught:
        check_plugin("detector", "unmasked-corners", leave_out=["gain"])
    assert str(caught.value) == (
        "detector 'unmasked-corners' fails 1 checks: nodata: the support (scale) of points reaches over pixels "
        "without data"
    )


class DroppedCorners(Corners):
    """Of two ways to them one leaves the strongest out."""

    def detect_features(self, image: Image) -> Features:
        found = super().detect_features(image)
        return found.take(np.arange(1, len(found)))

    def detect_places(self, image: Image) -> Features:
        return super().detect_features(image)


class TurnedCorners(Corners):
    """Upright, but for those that are asked for their angles."""

    def detect_places(self, image: Image) -> Features:
        return self.detect_features(image)

    def oriented(self, image: Image, features: Features) -> Features:
        return replace(features, angle=np.ones(len(features)))


@pytest.mark.parametrize(
    ("made", "words"), [(DroppedCorners, "detect_places gives other points"), (TurnedCorners, "other angles")]
)
def test_a_detector_whose_places_are_not_its_features_is_named(
    registered: set[tuple[str, str]], made: type[Corners], words: str
) -> None:
    others = ["gain", "nodata", "mirror image", "shifted view", "same bits again", "pickled", "nothing there"]
    featreg.register("other-corners")(made)
    with pytest.raises(PluginError, match=words):
        check_plugin("detector", "other-corners", leave_out=others)


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
