"""OpenCV 5's networks by a stand-in, as they need weights; its index of approximate neighbours and ASIFT for real."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import featreg
from featreg import registry
from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.interop import opencv
from featreg.io import as_image
from featreg.simulate import SimulatedPair
from featreg.types import Features

NETWORKS = [("detector", "opencv-aliked"), ("detector", "opencv-disk"), ("nearest", "opencv-lightglue")]
IMAGE = np.random.default_rng(0).gamma(4, size=(64, 80)).astype(np.float32)
networks = pytest.mark.skipif(not hasattr(cv2, "ALIKED_create"), reason="this OpenCV has no networks for points")
five = pytest.mark.skipif(not hasattr(cv2, "ANNIndex_create"), reason="needs OpenCV 5")


def points(table: Any) -> Features:
    n = len(table)
    xy = np.random.default_rng(1).uniform(0, 90, (n, 2))
    norm = "hamming" if table.dtype == np.uint8 else "l2"
    return Features(xy, np.full(n, 8.0), np.zeros(n), np.ones(n), np.zeros(n, np.int64), table, norm)


def use(kind: str, made: Any) -> Any:
    some = points(np.eye(4, 128, dtype=np.float32))
    return made.detect_features(as_image(IMAGE)) if kind == "detector" else made.match_features(some, some)


@pytest.mark.parametrize(("kind", "name"), NETWORKS)
def test_without_a_file_the_cure_is_named(kind: Any, name: str, tmp_path: Path) -> None:
    entry = registry.entry(kind, name)
    if hasattr(cv2, "ALIKED_create"):
        assert entry.on_demand
        assert "give weights=FILE.onnx" in entry.unavailable
        with pytest.raises(InputError, match=r"none\.onnx: no such file"):
            use(kind, registry.create(kind, name, weights=str(tmp_path / "none.onnx")))
        (tmp_path / "text.onnx").write_text("no network")
        with pytest.raises(InputError, match="OpenCV's"):
            use(kind, registry.create(kind, name, weights=str(tmp_path / "text.onnx")))
        with pytest.raises(PluginUnavailableError, match=name):
            use(kind, registry.create(kind, name))
    else:
        assert not entry.on_demand
        assert f"OpenCV {cv2.__version__} has no" in entry.unavailable


def test_an_older_opencv_says_that_it_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ALIKED", "DISK", "LightGlueMatcher", "ANNIndex"):
        monkeypatch.delattr(cv2, f"{name}_create", raising=False)
        assert opencv.unavailable(name) == f"OpenCV {cv2.__version__} has no {name}"


class Network:
    """Stands for a network of OpenCV: what it is given, and an answer in OpenCV's form."""

    def __init__(self) -> None:
        self.pair: tuple[Any, ...] = ()

    def detectAndCompute(self, picture: Any, mask: Any) -> Any:  # noqa: N802
        assert picture.shape == (*IMAGE.shape, 3)
        assert picture.dtype == np.uint8
        keypoints = [cv2.KeyPoint(x, 30.0, 1.0, -1, x) for x in (20.0, 50.0, 2.0)]
        return keypoints, np.eye(3, 128, dtype=np.float32)

    def setPairInfo(self, *pair: Any) -> None:  # noqa: N802
        self.pair = pair

    def match(self, a: Any, b: Any) -> Any:
        assert self.pair[0].shape == (len(a), 2)
        assert self.pair[0].dtype == np.float32
        return [cv2.DMatch(1, 2, 0.25)]


@networks
@pytest.mark.parametrize("name", ["opencv-aliked", "opencv-disk"])
def test_what_a_network_finds_becomes_features(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    detector: Any = registry.create("detector", name, weights=str(tmp_path / "net.onnx"), n_features=2)
    monkeypatch.setattr(type(detector.row), "network", lambda *_: Network())
    found = detector.detect_features(as_image(IMAGE))
    assert found.xy.tolist() == [[50, 30], [20, 30]]
    np.testing.assert_array_equal(found.descriptors, np.eye(3, 128, dtype=np.float32)[[1, 0]])
    assert found.scale.tolist() == [8, 8]


@networks
def test_lightglue_is_told_where_the_points_lie(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    nearest: Any = registry.create("nearest", "opencv-lightglue", weights=str(tmp_path / "net.onnx"))
    monkeypatch.setattr(type(nearest.row), "network", lambda *_: Network())
    some = points(np.eye(4, 128, dtype=np.float32))
    pairs, score = nearest.match_features(some, some)
    assert pairs.tolist() == [[1, 2]]
    assert score.tolist() == [-0.25]


@five
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_approximate_neighbours_are_nearly_all_true(dtype: Any) -> None:
    rng = np.random.default_rng(0)
    b = rng.integers(0, 256, (2000, 64)).astype(dtype)
    noise = rng.integers(0, 2, b.shape).astype(dtype)
    order = rng.permutation(2000)
    a = (b ^ noise if dtype is np.uint8 else b + noise)[order]
    exact, _ = registry.create("nearest", "brute-force").match_features(points(a), points(b))
    found, score = registry.create("nearest", "opencv-ann").match_features(points(a), points(b))
    same = {tuple(p) for p in exact} & {tuple(p) for p in found}
    assert len(same) > 0.95 * len(exact)
    assert ((score > 0) & (score <= 1)).all()
    with pytest.raises(ParameterError, match="one kind"):
        registry.create("nearest", "opencv-ann").match_features(points(a), points(b[:, :32]))


def test_asift_sees_tilted_views(pair: SimulatedPair) -> None:
    """Many more points than the one view has, at the same places."""
    image = as_image(pair.reference[:150, :150])
    one = registry.create("detector", "sift", n_features=10000).detect_features(image)
    many = registry.create("detector", "asift", n_features=10000, max_tilt=2).detect_features(image)
    assert len(many) > 3 * len(one)
    assert many.descriptors is not None
    assert many.descriptors.shape[1] == 128
    reg = featreg.match(
        pair.reference[:200, :200], pair.secondary[:200, :200], method="sift", detector="asift", refine=False,
        n_features=3000, max_tilt=2,
    )  # fmt: skip
    assert reg.status == "ok", reg.reason
