"""OpenCV's detectors and descriptors: the same results as OpenCV, in our conventions."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg.interop.opencv as featreg_opencv
from featreg import registry
from featreg.sar.normalise import to_uint8
from featreg.types import Features, Image
from made.images import image_of

cv2 = pytest.importorskip("cv2")

DETECTORS = {e.name: e for e in registry.entries("detector") if e.module == "featreg.detectors.opencv"}
DESCRIPTORS = {e.name: e for e in registry.entries("descriptor") if e.module == "featreg.descriptors.opencv"}
USABLE_DETECTORS = sorted(n for n, e in DETECTORS.items() if not e.unavailable)
USABLE_DESCRIPTORS = sorted(n for n, e in DESCRIPTORS.items() if not e.unavailable)
DESCRIBING = sorted(n for n in USABLE_DETECTORS if "describe" in DETECTORS[n].parameters)


def sar_like(height: int = 200, width: int = 200, seed: int = 0) -> NDArray[np.float32]:
    """Fields, dark discs and bright points under four-look speckle; linear amplitude."""
    rng = np.random.default_rng(seed)
    scene = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 5.0)
    scene = np.exp(scene / max(scene.std(), 0.1))
    for _ in range(height * width // 4000):
        centre = (int(rng.integers(width)), int(rng.integers(height)))
        cv2.circle(scene, centre, int(rng.integers(4, 9)), float(rng.choice([0.05, 8.0])), -1)
    return np.asarray(scene * np.sqrt(rng.gamma(4.0, 0.25, (height, width))), dtype=np.float32)


def eight_bit(seed: int = 0) -> tuple[NDArray[np.uint8], Image]:
    grey = to_uint8(image_of(sar_like(300, 260, seed)))
    return np.array(grey), image_of(grey, dtype="uint8")


def detect(name: str, picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", name, **parameters).detect_features(picture)


def describe(name: str, picture: Image, features: Features, **parameters: Any) -> Features:
    return registry.create("descriptor", name, **parameters).describe_features(picture, features)


def bare(features: Features) -> Features:
    return replace(features, descriptors=None, norm="l2")


def same(a: Features, b: Features) -> bool:
    fields = ("xy", "scale", "angle", "score", "level", "descriptors")
    return len(a) == len(b) and all(np.array_equal(getattr(a, f), getattr(b, f)) for f in fields)


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
        assert same(found, expected.take(order))
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


class TestEveryDetector:
    @pytest.mark.parametrize("name", USABLE_DETECTORS)
    def test_it_detects(self, name: str) -> None:
        loose = {"blob": {"filter_by_convexity": False, "filter_by_inertia": False}}.get(name, {})
        picture = image_of(sar_like())
        found = detect(name, picture, **loose)
        assert len(found) > 0
        assert (np.diff(found.score) <= 0).all()
        assert (found.xy >= 0).all()
        assert (found.xy <= 199).all()
        assert (found.scale > 0).all()
        assert (found.descriptors is not None) == (name in DESCRIBING)
        assert same(found, detect(name, image_of(sar_like()), **loose))
        assert len(detect(name, picture, n_features=3, **loose)) <= 3
        best = detect(name, picture, n_features=1, **loose)
        assert name == "orb" or best.score[0] == found.score[0]

    @pytest.mark.parametrize("name", USABLE_DETECTORS)
    def test_no_support_touches_an_invalid_pixel(self, name: str) -> None:
        mask = np.ones((200, 200), bool)
        mask[:, :60] = False
        mask[80:120, 120:140] = False
        found = detect(name, image_of(sar_like(), mask))
        assert len(found) > 0 or name == "blob"
        rows, columns = np.nonzero(~mask)
        for xy, scale in zip(found.xy, found.scale, strict=True):
            assert np.hypot(columns - xy[0], rows - xy[1]).min() > scale - 1.0
        budget = detect(name, image_of(sar_like(), mask), n_features=20)
        assert len(budget) == min(20, len(found)) or name in ("orb", "harris-laplace", "gftt")

    @pytest.mark.parametrize("name", USABLE_DETECTORS)
    @pytest.mark.parametrize("value", [0.0, 3.5])
    def test_a_constant_image_has_no_features(self, name: str, value: float) -> None:
        assert len(detect(name, image_of(np.full((100, 120), value)))) == 0

    @pytest.mark.parametrize("name", USABLE_DETECTORS)
    def test_invalid_and_tiny_images_have_no_features(self, name: str) -> None:
        assert len(detect(name, image_of(sar_like(), np.zeros((200, 200), bool)))) == 0
        for shape in ((1, 1), (3, 3), (2, 300), (15, 15)):
            assert len(detect(name, image_of(sar_like(*shape)))) == 0
        for shape in ((16, 16), (20, 300), (33, 33), (300, 40)):
            detect(name, image_of(sar_like(*shape)))

    @pytest.mark.parametrize("name", USABLE_DETECTORS)
    def test_it_can_be_pickled_and_holds_its_parameters(self, name: str) -> None:
        plugin = registry.create("detector", name, n_features=77)
        again = pickle.loads(pickle.dumps(plugin))
        assert again == plugin
        assert hash(again) == hash(plugin)
        for key, value in DETECTORS[name].parameters.items():
            assert getattr(again, key) == (77 if key == "n_features" else value)
        picture = image_of(sar_like(120, 120))
        assert same(again.detect_features(picture), plugin.detect_features(picture))


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
        assert same(found, describe(name, image_of(sar_like()), given))

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


class TestInput:
    @pytest.mark.parametrize("name", ["orb", "sift", "akaze", "kaze"])
    def test_16_bit_and_float_and_complex_images_give_the_same_points(self, name: str) -> None:
        pixels = np.rint(sar_like() * 2000.0).clip(1, 65535)
        as_float = detect(name, image_of(pixels))
        as_uint16 = detect(name, image_of(pixels, dtype="uint16"))
        phase = np.exp(1j * np.arange(200.0))
        as_complex = detect(name, Image((pixels * phase).astype(np.complex64), np.ones((200, 200), bool)))
        assert len(as_float) > 20
        assert same(as_float, as_uint16)
        assert len(as_complex) == pytest.approx(len(as_float), rel=0.05)

    def test_the_gain_drops_out(self) -> None:
        assert same(detect("fast", image_of(sar_like())), detect("fast", image_of(sar_like() * 1024.0)))
