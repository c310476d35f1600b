"""LNIFT: blind to gain and reversed contrast, turned with the image, keypoints where there is data."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

import featreg
from featreg import registry
from featreg.io import as_image
from featreg.sar.gradients.local_normalisation import locally_normalised
from featreg.simulate import sar_pair
from featreg.types import Features, Image


def test_normalisation_forgets_gain_offset_and_nothing_else() -> None:
    pixels = sar_pair((120, 140), looks=4, seed=2).reference
    view = locally_normalised(as_image(pixels), 31)
    assert np.allclose(view, locally_normalised(as_image(3 * pixels + 5), 31), atol=2e-2)
    inner = pixels[45:76, 55:86]
    plain = (pixels[60, 70] - inner.mean()) / inner.std()
    assert view[60, 70] == pytest.approx(np.clip(plain, -3, 3), abs=1e-3)


def test_a_constant_image_is_zero_and_has_no_keypoint() -> None:
    image = Image(np.full((90, 90), 7, np.float32), np.ones((90, 90), np.bool_))
    assert not locally_normalised(image, 31).any()
    assert len(registry.create("detector", "normalised-fast").detect_features(image)) == 0


def test_no_keypoint_lies_near_nodata() -> None:
    pixels = sar_pair((160, 160), looks=4, seed=3).reference
    mask = np.ones(pixels.shape, np.bool_)
    mask[:, :60] = False
    found = registry.create("detector", "normalised-fast").detect_features(as_image(pixels, mask=mask))
    assert len(found) > 20
    assert found.xy[:, 0].min() >= 80


def test_the_descriptor_turns_with_the_image_and_forgets_reversed_contrast() -> None:
    pixels = cv2.GaussianBlur(sar_pair((201, 201), looks=16, seed=4).reference, (0, 0), 1.5)
    turn = 35.0
    into = cv2.getRotationMatrix2D((100.0, 100.0), turn, 1.0)
    turned = cv2.warpAffine(pixels, into, (201, 201), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    hog = registry.create("descriptor", "normalised-hog", patch=64.0)

    def of(image: Any, xy: Any, angle: float) -> Any:
        count = len(xy)
        points = Features(
            xy=np.asarray(xy, np.float64),
            scale=np.full(count, 20.0),
            angle=np.full(count, angle),
            score=np.ones(count),
            level=np.zeros(count, np.int64),
        )
        return hog.describe_features(as_image(np.asarray(image, np.float32)), points).descriptors

    xy = np.array([[100.0, 100.0], [110.0, 92.0], [88.0, 105.0]])
    there = xy @ into[:, :2].T + into[:, 2]
    plain = of(pixels, xy, 0.0)
    same = (plain * of(turned, there, np.radians(turn))).sum(axis=1)
    other = (plain * of(turned, there, 0.0)).sum(axis=1)
    assert (same > 0.97).all()
    assert (same > other + 0.02).all()
    assert np.allclose(plain, of(pixels.max() + 1 - pixels, xy, 0.0), atol=1e-2)


def test_descriptors_beside_emptiness_are_numbers() -> None:
    pixels = sar_pair((200, 200), looks=1, seed=5).reference * np.where(np.arange(200) < 100, 1e4, 1).astype(np.float32)
    mask = np.ones(pixels.shape, np.bool_)
    mask[90:, 120:] = False
    image = as_image(pixels, mask=mask)
    found = registry.create("detector", "normalised-fast", threshold=2).detect_features(image)
    described = registry.create("descriptor", "normalised-hog").describe_features(image, found).descriptors
    assert described is not None
    assert len(described)
    assert np.isfinite(described).all()


def test_a_turned_pair_is_registered() -> None:
    pair = sar_pair((240, 240), looks=4, rotation_deg=40, shift=(7, -3), seed=1)
    reg = featreg.match(
        pair.reference, pair.secondary, method="lnift", model="similarity", seed=0, nodata=0, n_features=1500
    )
    assert reg.status == "ok", reg.reason
    centre = np.array([[120.0, 120.0]])
    assert np.abs(reg.model(centre) - (centre @ pair.truth[:, :2].T + pair.truth[:, 2])).max() < 0.5
