"""`orientation-correlation` and `sar-dense`: any rotation and contrast, nothing on other places, honest covariances."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.geometry import Affine
from featreg.io import as_image
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Image
from made.models import grid_rmse

SHAPE = (300, 300)


def mapped(pair: SimulatedPair, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(xy @ pair.truth[:, :2].T + pair.truth[:, 2])


@pytest.mark.parametrize(("rotation", "scale"), [(0.0, 1.0), (151.0, 1.2), (-83.0, 0.7)])
def test_one_look_is_registered_at_any_rotation(rotation: float, scale: float) -> None:
    pair = sar_pair(SHAPE, looks=1, rotation_deg=rotation, scale=scale, shift=(11, -7), seed=2)
    reg = featreg.match(pair.reference, pair.secondary, method="sar-dense", model="similarity", seed=0, nodata=0)
    assert reg.status == "ok", reg.reason
    assert grid_rmse(reg, pair.truth, 300, 60) < 0.3


def test_reversed_contrast_is_no_obstacle() -> None:
    pair = sar_pair(SHAPE, looks=4, rotation_deg=64, scale=1.1, shift=(4, 9), seed=6)
    reversed_ = np.where(pair.secondary > 0, 1 / np.maximum(cv2.blur(pair.secondary, (5, 5)), 1e-6), 0)
    reg = featreg.match(pair.reference, reversed_, method="sar-dense", model="similarity", seed=0, nodata=0)
    assert reg.status == "ok", reg.reason
    assert grid_rmse(reg, pair.truth, 300, 60) < 0.6


def test_other_places_and_mirror_images_give_nothing() -> None:
    one = sar_pair(SHAPE, looks=4, rotation_deg=0, scale=1, shift=(0, 0), seed=8).reference
    other = sar_pair(SHAPE, looks=4, rotation_deg=0, scale=1, shift=(0, 0), seed=9).reference
    for secondary in (other, np.ascontiguousarray(one[:, ::-1])):
        reg = featreg.match(one, secondary, method="sar-dense", seed=0)
        assert reg.status == "unreliable"
        assert len(reg.matches) == 0


def test_no_tie_point_lies_on_nodata_and_wedges_do_not_matter() -> None:
    pair = sar_pair(SHAPE, looks=4, rotation_deg=33, scale=1, shift=(0, 0), seed=4)
    y, x = np.mgrid[0:300, 0:300]
    mask = (x + y > 150) & (pair.secondary > 0)
    reg = featreg.match(pair.reference, pair.secondary, method="sar-dense", model="rigid", seed=0, secondary_mask=mask)
    assert reg.status == "ok", reg.reason
    assert grid_rmse(reg, pair.truth, 300, 60) < 0.2
    there = np.rint(reg.matches.secondary_xy[reg.inliers]).astype(int)
    near = cv2.dilate(mask.astype(np.uint8), np.ones((35, 35), np.uint8)) > 0
    assert near[np.clip(there[:, 1], 0, 299), np.clip(there[:, 0], 0, 299)].all()


def test_ellipses_hold_the_share_of_errors_that_they_state() -> None:
    matcher = registry.create("matcher", "orientation-correlation")
    inside = []
    for looks, seed in ((1, 0), (1, 1), (4, 0), (4, 1), (16, 0)):
        pair = sar_pair(SHAPE, looks=looks, rotation_deg=12, scale=1, shift=(3.2, 5.6), change=0, seed=seed)
        found = matcher.match(as_image(pair.reference), as_image(pair.secondary, nodata=0))
        assert found.covariance is not None
        off = found.secondary_xy - mapped(pair, found.reference_xy)
        lengths = np.einsum("ni,nij,nj->n", off, np.linalg.inv(found.covariance), off)
        inside.append(lengths[:, None] <= -2 * np.log([0.5, 0.05, 0.01]))
    half, most, nearly_all = np.concatenate(inside).mean(axis=0)
    # Windows overlap by half, so that these 600 are worth some 200; errors of rival peaks lie inside the ellipse of
    # half of them more often than Gaussian ones.
    assert 0.45 < half < 0.68
    assert most == pytest.approx(0.95, abs=0.035)
    assert nearly_all > 0.965


def test_equal_input_gives_equal_bits_and_nothing_gives_nothing() -> None:
    pair = sar_pair((200, 200), looks=4, rotation_deg=100, scale=1, shift=(0, 0), seed=1)
    matcher = registry.create("matcher", "orientation-correlation")
    one, two = (matcher.match(as_image(pair.reference), as_image(pair.secondary)) for _ in range(2))
    assert len(one)
    assert np.array_equal(one.secondary_xy, two.secondary_xy)
    flat = Image(np.ones((64, 64), np.float32), np.ones((64, 64), np.bool_))
    assert len(matcher.match(flat, flat)) == 0
    tiny = Image(np.ones((5, 7), np.float32), np.ones((5, 7), np.bool_))
    assert len(matcher.match(tiny, as_image(pair.secondary))) == 0


def test_a_known_model_is_followed_without_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    import featreg.matchers.orientation_correlation as module

    pair = sar_pair(SHAPE, looks=1, rotation_deg=-75, scale=1.3, shift=(20, 5), seed=12)
    known = Affine(pair.truth + np.array([[0, 0, 6.0], [0, 0, -5.0]]))
    with monkeypatch.context() as patch:
        patch.setattr(module, "search", lambda *given: pytest.fail("searched"))
        reg = featreg.match(
            pair.reference, pair.secondary, method="sar-dense", model="affine", initial=known, search_radius=10,
            seed=0, nodata=0,
        )  # fmt: skip
    assert reg.status == "ok", reg.reason
    assert grid_rmse(reg, pair.truth, 300, 60) < 0.3


def test_a_radius_as_large_as_the_image_is_searched() -> None:
    pair = sar_pair((200, 200), looks=4, rotation_deg=130, scale=1, shift=(0, 0), seed=1)
    matcher = registry.create("matcher", "orientation-correlation")
    images = as_image(pair.reference), as_image(pair.secondary)
    same = Affine(np.array([[1.0, 0, 0], [0, 1, 0]]))
    near, searched = matcher.match_near(*images, same, 150.0), matcher.match(*images)
    assert len(near) > 12
    assert np.array_equal(near.secondary_xy, searched.secondary_xy)


def test_a_frame_and_a_label_on_two_places_are_no_alignment() -> None:
    label = np.zeros(SHAPE, np.uint8)
    cv2.rectangle(label, (6, 6), (293, 293), 255, 2)
    cv2.putText(label, "SAR 2026", (20, 280), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 255, 3)
    one, other = (
        np.where(label > 0, np.float32(30), sar_pair(SHAPE, looks=4, rotation_deg=0, seed=seed).reference)
        for seed in (8, 9)
    )
    assert featreg.match(one, other, method="sar-dense", seed=0).status == "unreliable"
