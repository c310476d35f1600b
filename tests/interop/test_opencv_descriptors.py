"""Every descriptor of OpenCV: the points that it keeps, their order, blank and tiny images."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from featreg import registry
from featreg.types import Features
from made.images import image_of
from made.opencv_features import USABLE_DESCRIPTORS, bare, describe, detect, same_features, sar_like


class TestEveryDescriptor:
    @pytest.mark.parametrize("name", USABLE_DESCRIPTORS)
    @pytest.mark.parametrize("detector", ["fast", "sift"])
    def test_it_describes_the_features_of_any_detector(self, name: str, detector: str) -> None:
        picture = image_of(sar_like())
        given = bare(detect(detector, picture, n_features=300))
        found = describe(name, picture, given)
        assert found.descriptors is not None
        assert len(found) > 20
        assert found.norm == ("hamming" if found.descriptors.dtype == np.uint8 else "l2")
        assert np.isfinite(found.descriptors.astype(np.float64)).all()
        assert len(np.unique(found.descriptors, axis=0)) > 0.5 * len(np.unique(found.xy, axis=0))
        rows = np.arange(len(given)) if found.index is None else found.index
        assert (np.diff(rows) > 0).all()
        np.testing.assert_array_equal(found.xy, given.xy[rows])
        np.testing.assert_array_equal(found.scale, given.scale[rows])
        assert same_features(found, describe(name, image_of(sar_like()), given))

    @pytest.mark.parametrize("name", USABLE_DESCRIPTORS)
    def test_each_row_belongs_to_its_feature(self, name: str) -> None:
        picture = image_of(sar_like())
        given = bare(detect("sift", picture, n_features=60))
        found = describe(name, picture, given)
        order = np.arange(len(given))[::-1]
        back = describe(name, picture, given.take(order))
        rows = np.arange(len(given)) if found.index is None else found.index
        back_rows = order if back.index is None else order[back.index]
        np.testing.assert_array_equal(back_rows[::-1], rows)
        assert found.descriptors is not None
        assert back.descriptors is not None
        np.testing.assert_array_equal(back.descriptors[::-1], found.descriptors)

    @pytest.mark.parametrize("name", USABLE_DESCRIPTORS)
    def test_extreme_scales_and_positions_do_no_harm(self, name: str) -> None:
        picture = image_of(sar_like(64, 90))
        corners = np.array([[0, 0], [89, 0], [0, 63], [89, 63], [45, 32], [-1, 5], [9e4, 9e4]], dtype=np.float64)
        for scale in (0.0, 0.3, 4.0, 30.0, 500.0):
            given = Features(corners, np.full(7, scale), np.zeros(7), np.ones(7), np.zeros(7, np.int64))
            found = describe(name, picture, given)
            assert found.index is not None
            assert set(found.index) <= set(range(5))

    @pytest.mark.parametrize("name", USABLE_DESCRIPTORS)
    def test_nothing_in_gives_nothing_out(self, name: str) -> None:
        assert len(describe(name, image_of(sar_like()), Features.empty())) == 0
        one = Features(np.ones((1, 2)), np.ones(1), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
        tiny = describe(name, image_of(sar_like(5, 5)), one)
        assert len(tiny) == 0
        assert tiny.index is not None

    @pytest.mark.parametrize("name", USABLE_DESCRIPTORS)
    def test_it_can_be_pickled(self, name: str) -> None:
        plugin = registry.create("descriptor", name)
        assert pickle.loads(pickle.dumps(plugin)) == plugin

    @pytest.mark.parametrize("name", USABLE_DESCRIPTORS)
    def test_a_feature_is_described_alike_in_any_company(self, name: str) -> None:
        picture = image_of(sar_like())
        given = bare(detect("sift", picture, n_features=80))
        rows = np.flatnonzero(given.scale > np.median(given.scale))
        among_all, among_large = describe(name, picture, given), describe(name, picture, given.take(rows))
        kept = np.arange(len(given)) if among_all.index is None else among_all.index
        kept_large = rows if among_large.index is None else rows[among_large.index]
        assert among_all.descriptors is not None
        assert among_large.descriptors is not None
        np.testing.assert_array_equal(among_all.descriptors[np.isin(kept, rows)], among_large.descriptors)
        np.testing.assert_array_equal(kept[np.isin(kept, rows)], kept_large)

    def test_a_measured_orientation_replaces_the_given_one(self) -> None:
        picture = image_of(sar_like())
        given = detect("fast", picture, n_features=200)
        assert not given.angle.any()
        assert describe("brisk", picture, given).angle.std() > 0.5
        assert not describe("beblid", picture, given).angle.any()
