"""kornia's networks, with random weights."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.interop import kornia as featreg_kornia
from featreg.interop import weights as trained
from featreg.interop.torch_arrays import to_tensor
from featreg.io import as_image
from featreg.types import Features
from made.networks import saved, seeded

torch = pytest.importorskip("torch")
pytest.importorskip("kornia", minversion="0.9")
import kornia.feature as library  # noqa: E402

Texture = Callable[..., NDArray[np.float32]]
PATCH_NETWORKS = {"hardnet": "HardNet", "hardnet8": "HardNet8", "hynet": "HyNet", "sosnet": "SOSNet"}


def random_lightglue() -> Any:
    kind: Any = library.LightGlue
    return kind(None, **{**kind.features["disk"], "weights": None})


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=pytest.mark.slow if k == "hardnet8" else ()) for k in PATCH_NETWORKS]
)
def test_patch_networks_describe(kind: str, tmp_path: Path, sar_texture: Texture) -> None:
    network = seeded(lambda: getattr(library, PATCH_NETWORKS[kind])(pretrained=False))
    path = saved(network, tmp_path / "weights.pth", "" if kind == "sosnet" else "state_dict")
    image = as_image(sar_texture(100, 110))
    points = registry.create("detector", "kornia-dog", n_features=20).detect_features(image)
    descriptor = registry.create("descriptor", f"kornia-{kind}", weights=path, magnification=2.0)
    found = descriptor.describe_features(image, points)
    assert found.descriptors is not None
    assert found.descriptors.shape == (len(points), 128)
    with torch.no_grad():
        lafs = replace(points, scale=2 * points.scale).to_lafs().float()
        wanted = library.get_laf_descriptors(to_tensor(image), lafs, network.eval())[0]
    np.testing.assert_allclose(found.descriptors, wanted.numpy(), atol=1e-5)


def detectors_with_descriptors(folder: Path) -> dict[str, dict[str, Any]]:
    return {
        "kornia-disk": {"weights": saved(seeded(library.DISK), folder / "disk.pth", "extractor")},
        "kornia-aliked": {"weights": saved(seeded(library.ALIKED), folder / "aliked.pth"), "detection_threshold": 0.0},
        "kornia-xfeat": {"weights": saved(seeded(library.XFeat).net, folder / "xfeat.pt"), "detection_threshold": 0.0},
    }


@pytest.mark.parametrize(("name", "width"), [("kornia-disk", 128), ("kornia-aliked", 128), ("kornia-xfeat", 64)])
def test_detectors_that_describe(name: str, width: int, tmp_path: Path, sar_texture: Texture) -> None:
    image = as_image(sar_texture(100, 110))
    parameters = detectors_with_descriptors(tmp_path)[name]
    found = registry.create("detector", name, n_features=50, **parameters).detect_features(image)
    assert 0 < len(found) <= 50
    assert found.descriptors is not None
    assert found.descriptors.shape == (len(found), width)
    assert (np.diff(found.score) <= 0).all()
    assert ((found.xy >= 0) & (found.xy <= [109, 99])).all()
    bare = registry.create("detector", name, n_features=50, describe=False, **parameters).detect_features(image)
    assert bare.descriptors is None
    np.testing.assert_array_equal(bare.xy, found.xy)


def test_points_of_a_network_stay_off_nodata(tmp_path: Path, sar_texture: Texture) -> None:
    mask = np.ones((100, 110), np.bool_)
    mask[:, :40] = False
    parameters = detectors_with_descriptors(tmp_path)["kornia-disk"]
    found = registry.create("detector", "kornia-disk", **parameters).detect_features(
        as_image(sar_texture(100, 110), mask=mask)
    )
    assert len(found) > 0
    assert (found.xy[:, 0] >= 39 + 8).all()


def test_keynet_reports_the_centres_of_its_pixels(monkeypatch: pytest.MonkeyPatch, sar_texture: Texture) -> None:
    """Its pyramid around a response that mirrors with the image: a shift of the coarse levels would show twice."""
    from scipy.spatial import cKDTree

    table = sys.modules["featreg.detectors.kornia"].TABLE
    blobs = library.MultiResolutionDetector(library.BlobHessian())
    row = replace(table["kornia-keynet"], build=lambda creator, values: blobs, files=None)
    monkeypatch.setitem(table, "kornia-keynet", row)
    featreg_kornia._network.cache_clear()
    try:
        detector = registry.create("detector", "kornia-keynet")
        amplitude = sar_texture(160, 160)
        here, there = (detector.detect_features(as_image(a)) for a in (amplitude, amplitude[:, ::-1]))
    finally:
        featreg_kornia._network.cache_clear()
    assert len(np.unique(here.level)) > 1
    mirrored = there.xy * [-1, 1] + [159, 0]
    for coarse in (here.scale > 30, here.scale < 30):
        distance, partner = cKDTree(mirrored).query(here.xy[coarse])
        near = np.asarray(distance < 3)
        assert np.count_nonzero(near) > 5
        assert np.abs((mirrored[partner] - here.xy[coarse])[near].mean(axis=0)).max() < 0.25


def test_keynet_with_random_weights(tmp_path: Path, sar_texture: Texture) -> None:
    network = seeded(lambda: library.KeyNet(False))
    with torch.no_grad():
        for parameter in network.last_conv.parameters():
            parameter.abs_()
    wrapped = {f"model.{key}": value for key, value in network.state_dict().items()}
    torch.save(wrapped, tmp_path / "keynet.pth")
    detector = registry.create("detector", "kornia-keynet", weights=str(tmp_path / "keynet.pth"), n_features=30)
    found = detector.detect_features(as_image(sar_texture(120, 130)))
    assert 0 < len(found) <= 30
    assert (found.scale >= 22 * 0.7).all()


def test_lightglue_pairs_what_it_was_made_for(random_features: Callable[..., Features], tmp_path: Path) -> None:
    path = saved(seeded(random_lightglue), tmp_path / "lightglue.pth")
    nearest = registry.create("nearest", "kornia-lightglue", weights=path, filter_threshold=0.0)
    pairs, score = nearest.match_features(random_features(30, 128), random_features(25, 128, seed=1))
    assert pairs.shape == (len(score), 2)
    assert len(np.unique(pairs[:, 0])) == len(pairs)
    assert (pairs < [30, 25]).all()
    with pytest.raises(ParameterError, match="length 128, got 64"):
        nearest.match_features(random_features(30, 64), random_features(25, 64))


def test_lightglue_reads_the_names_of_the_authors_files(tmp_path: Path) -> None:
    network = seeded(random_lightglue)
    renamed = {}
    for key, value in network.state_dict().items():
        parts = key.split(".")
        if parts[0] == "transformers":
            parts[:3] = [parts[2], parts[1]]
        renamed[".".join(parts)] = value
    torch.save(renamed, tmp_path / "old.pth")
    again = random_lightglue()
    trained.load_weights(again, str(tmp_path / "old.pth"))
    for key, value in network.state_dict().items():
        assert torch.equal(again.state_dict()[key], value), key


def test_loftr_gives_tie_points_on_valid_pixels(tmp_path: Path, sar_texture: Texture) -> None:
    path = saved(seeded(lambda: library.LoFTR(None)), tmp_path / "loftr.ckpt", "state_dict")
    matcher = registry.create("matcher", "kornia-loftr", weights=path, threshold=0.0, max_side=96, n_features=20)
    mask = np.ones((96, 100), np.bool_)
    mask[:50] = False
    first, second = as_image(sar_texture(96, 100), mask=mask), as_image(sar_texture(128, 120))
    found = matcher.match(first, second)
    assert len(found) <= 20
    assert (found.reference_xy[:, 1] > 49).all()
    assert (np.diff(found.score) <= 0).all()


@pytest.mark.slow
def test_dedode_takes_two_files(tmp_path: Path, sar_texture: Texture) -> None:
    network = seeded(lambda: library.DeDoDe("L", "B", torch.float32))
    files = {
        "weights": saved(network.detector, tmp_path / "detector.pth"),
        "descriptor_weights": saved(network.descriptor, tmp_path / "descriptor.pth"),
    }
    image = as_image(sar_texture(70, 84))
    found = registry.create("detector", "kornia-dedode", n_features=30, **files).detect_features(image)
    assert 0 < len(found) <= 30
    assert found.descriptors is not None
    assert found.descriptors.shape[1] == 256
    with pytest.raises(ParameterError, match="two files"):
        registry.create("detector", "kornia-dedode", weights=files["weights"]).detect_features(image)


def test_building_a_network_leaves_the_callers_random_numbers_alone(tmp_path: Path, sar_texture: Texture) -> None:
    path = detectors_with_descriptors(tmp_path)["kornia-disk"]["weights"]
    before = torch.random.get_rng_state()
    registry.create("detector", "kornia-disk", weights=path).detect_features(as_image(sar_texture(60, 60)))
    assert torch.equal(torch.random.get_rng_state(), before)
