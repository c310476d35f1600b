"""Keypoints of OpenCV to features and back."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.types import Features

cv2 = pytest.importorskip("cv2")


class TestKeypoints:
    def test_round_trip(self) -> None:
        rng = np.random.default_rng(1)
        given = Features(
            xy=rng.uniform(0, 500, (50, 2)).astype(np.float32),
            scale=rng.uniform(1, 40, 50).astype(np.float32),
            angle=rng.uniform(0, 2 * np.pi, 50),
            score=rng.normal(size=50).astype(np.float32),
            level=rng.integers(-1, 9, 50),
        )
        back = Features.from_keypoints(given.to_keypoints())
        for name in ("xy", "scale", "score", "level"):
            np.testing.assert_array_equal(getattr(back, name), getattr(given, name))
        np.testing.assert_allclose(back.angle, given.angle, atol=1e-6)

    def test_size_is_the_diameter_and_angles_turn_the_other_way(self) -> None:
        features = Features.from_keypoints([cv2.KeyPoint(3.0, 4.0, 31.0, 90.0, 0.5, 2, 7), cv2.KeyPoint(1.0, 2.0, 7.0)])
        np.testing.assert_allclose(features.scale, [15.5, 3.5])
        np.testing.assert_allclose(features.angle, [1.5 * np.pi, 0.0])
        assert [k.angle for k in features.to_keypoints()] == [90.0, 0.0]

    def test_the_low_byte_of_sifts_packed_octave_is_the_level(self) -> None:
        packed = 255 | (2 << 8) | (130 << 16)
        assert Features.from_keypoints([cv2.KeyPoint(1.0, 1.0, 2.0, 0.0, 1.0, packed)]).level.tolist() == [-1]

    def test_an_angle_just_below_a_full_turn_stays_in_range(self) -> None:
        features = Features.from_keypoints([cv2.KeyPoint(1.0, 1.0, 2.0, 1e-9), cv2.KeyPoint(1.0, 1.0, 2.0, 1e-30)])
        assert ((features.angle >= 0) & (features.angle < 2 * np.pi)).all()
        assert all(0 <= k.angle < 360 for k in features.to_keypoints())

    def test_nothing(self) -> None:
        assert len(Features.from_keypoints([])) == 0
        assert len(Features.from_keypoints((), None)) == 0
        assert Features.empty().to_keypoints() == []

    def test_descriptor_type_decides_the_norm(self) -> None:
        keypoints = [cv2.KeyPoint(1.0, 1.0, 2.0)]
        assert Features.from_keypoints(keypoints, np.zeros((1, 32), np.uint8)).norm == "hamming"
        assert Features.from_keypoints(keypoints, np.zeros((1, 64), np.float64)).norm == "l2"
        with pytest.raises(InputError, match="descriptors"):
            Features.from_keypoints(keypoints, np.zeros((2, 64), np.float32))
