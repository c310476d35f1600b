"""Every detector of OpenCV: budget, mask, blank and tiny images."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from featreg import registry
from featreg.types import Image
from made.images import image_of
from made.opencv_features import DESCRIBING, DETECTORS, USABLE_DETECTORS, detect, same_features, sar_like


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
        assert same_features(found, detect(name, image_of(sar_like()), **loose))
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
        assert same_features(again.detect_features(picture), plugin.detect_features(picture))


class TestInput:
    @pytest.mark.parametrize("name", ["orb", "sift", "akaze", "kaze"])
    def test_16_bit_and_float_and_complex_images_give_the_same_points(self, name: str) -> None:
        pixels = np.rint(sar_like() * 2000.0).clip(1, 65535)
        as_float = detect(name, image_of(pixels))
        as_uint16 = detect(name, image_of(pixels, dtype="uint16"))
        phase = np.exp(1j * np.arange(200.0))
        as_complex = detect(name, Image((pixels * phase).astype(np.complex64), np.ones((200, 200), bool)))
        assert len(as_float) > 20
        assert same_features(as_float, as_uint16)
        assert len(as_complex) == pytest.approx(len(as_float), rel=0.05)

    def test_the_gain_drops_out(self) -> None:
        assert same_features(detect("fast", image_of(sar_like())), detect("fast", image_of(sar_like() * 1024.0)))
