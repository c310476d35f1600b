"""OpenCV's detectors and descriptors: the same results as OpenCV, in our conventions."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg.interop.opencv as featreg_opencv
from featreg.sar.normalise import to_uint8
from featreg.types import Features, Image
from made.images import image_of
from made.opencv_features import bare, describe, detect, same_features, sar_like


def eight_bit(seed: int = 0) -> tuple[NDArray[np.uint8], Image]:
    grey = to_uint8(image_of(sar_like(300, 260, seed)))
    return np.array(grey), image_of(grey, dtype="uint8")


def nearest(xy: NDArray[np.float64], to: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    distance = np.hypot(*(xy[:, None] - to[None]).transpose(2, 0, 1))
    return distance.argmin(axis=1), distance.min(axis=1)


class TestLikeOpenCV:
    @pytest.mark.parametrize(
        ("name", "ours", "theirs"),
        [
            ("orb", {"n_features": 500, "half_pixel": False}, {}),
            ("sift", {}, {"enable_precise_upscale": True}),
            ("akaze", {}, {}),
            ("kaze", {}, {}),
            ("brisk", {}, {}),
        ],
    )
    def test_detect_and_compute(self, name: str, ours: dict[str, Any], theirs: dict[str, Any]) -> None:
        grey, picture = eight_bit()
        create = featreg_opencv.resolve(name.upper())
        assert not isinstance(create, str)
        expected = Features.from_keypoints(*create(**theirs).detectAndCompute(grey, None))
        order = np.lexsort((expected.angle, expected.scale, *expected.xy.T, -expected.score))
        found = detect(name, picture, **ours)
        assert len(found) > 100
        assert same_features(found, expected.take(order))
        undescribed = detect(name, picture, describe=False, **ours)
        assert undescribed.descriptors is None
        np.testing.assert_array_equal(undescribed.xy, found.xy)

    @pytest.mark.parametrize("name", ["akaze", "brisk", "orb", "sift"])
    def test_describing_their_own_keypoints_gives_the_same_descriptors(self, name: str) -> None:
        _, picture = eight_bit(1)
        expected = detect(name, picture)
        found = describe(name, picture, bare(expected))
        np.testing.assert_array_equal(found.descriptors, expected.descriptors)
        np.testing.assert_array_equal(found.xy, expected.xy)
        np.testing.assert_allclose(found.angle, expected.angle, atol=1e-6)
        assert found.index is None

    def test_kaze_reads_the_level_that_its_own_keypoints_name(self) -> None:
        grey, picture = eight_bit(1)
        create = featreg_opencv.resolve("KAZE")
        assert not isinstance(create, str)
        _, expected = create().compute(grey, create().detect(grey))
        found = describe("kaze", picture, Features.from_keypoints(create().detect(grey)))
        assert (found.descriptors == expected).all(axis=1).mean() > 0.95

    def test_the_constants_are_opencvs(self) -> None:
        def constant(name: str) -> int:
            value = getattr(cv2, name, None)
            return int(getattr(cv2.xfeatures2d, name) if value is None else value)

        from featreg.descriptors import opencv as descriptors
        from featreg.detectors import opencv as detectors

        words = {
            ("akaze", "descriptor_type", "mldb"): "AKAZE_DESCRIPTOR_MLDB",
            ("akaze", "descriptor_type", "kaze-upright"): "AKAZE_DESCRIPTOR_KAZE_UPRIGHT",
            ("akaze", "diffusivity", "pm-g2"): "KAZE_DIFF_PM_G2",
            ("akaze", "diffusivity", "charbonnier"): "KAZE_DIFF_CHARBONNIER",
            ("agast", "type", "oast-9-16"): "AGAST_FEATURE_DETECTOR_OAST_9_16",
            ("fast", "type", "9-16"): "FAST_FEATURE_DETECTOR_TYPE_9_16",
            ("orb", "score_type", "fast"): "ORB_FAST_SCORE",
        }
        for (name, key, word), constant_name in words.items():
            assert detectors.TABLE[name].parameters[key].constants[word] == constant(constant_name)
        for name, value in (("BEBLID_SIZE_512_BITS", 512), ("TEBLID_SIZE_256_BITS", 256)):
            assert descriptors.TABLE[name[:6].lower()].parameters["n_bits"].constants[value] == constant(name)
        assert descriptors.TABLE["daisy"].parameters["norm"].constants["sift"] == constant("DAISY_NRM_SIFT")

    @pytest.mark.parametrize("name", ["akaze", "fast", "gftt", "harris-laplace", "kaze", "orb", "sift"])
    def test_the_mirror_image_has_the_mirrored_points(self, name: str) -> None:
        pixels = sar_like(300, 300)
        points = detect(name, image_of(pixels)).xy
        mirrored = detect(name, image_of(pixels[::-1, ::-1])).xy
        row, distance = nearest(points, 299.0 - mirrored)
        shift = (299.0 - mirrored[row] - points)[distance < 3.0]
        assert len(shift) > 50
        np.testing.assert_allclose(np.median(shift, axis=0), 0.0, atol=0.02)
        np.testing.assert_allclose(shift.mean(axis=0), 0.0, atol=0.1)

    def test_the_half_pixel_of_orb_is_put_right_at_every_level(self) -> None:
        pixels = sar_like(487, 487, seed=3)

        def bias(level: int, half_pixel: bool) -> float:
            a, b = (detect("orb", image_of(p), half_pixel=half_pixel) for p in (pixels, pixels[::-1, ::-1]))
            a, b = a.take(a.level == level), b.take(b.level == level)
            row, distance = nearest(a.xy, 486.0 - b.xy)
            shift = (486.0 - b.xy[row] - a.xy)[distance < 1.2**level]
            assert len(shift) > 10
            return float(np.abs(shift.mean(axis=0)).max())

        assert bias(2, half_pixel=False) > 0.3
        assert max(bias(level, half_pixel=True) for level in range(1, 8)) < 0.1

    @pytest.mark.parametrize("name", ["akaze", "orb", "sift", "brisk"])
    def test_turning_the_image_turns_the_angles(self, name: str) -> None:
        pixels = sar_like(240, 240)
        before = detect(name, image_of(pixels))
        after = detect(name, image_of(np.rot90(pixels).copy()))
        turned = np.stack([before.xy[:, 1], 239.0 - before.xy[:, 0]], axis=1)
        row, distance = nearest(turned, after.xy)
        close = (distance < 0.5) & np.isclose(before.scale, after.scale[row], rtol=0.02)
        turn = np.angle(np.exp(1j * (after.angle[row] - before.angle))[close])
        assert close.sum() > 30
        assert np.median(turn) == pytest.approx(np.pi / 2, abs=0.05)
