"""Trained weights: where they are found, in which files they may come, and what the networks do with them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import registry
from featreg.errors import InputError
from featreg.interop import kornia as featreg_kornia
from featreg.interop import weights as trained
from featreg.io import as_image
from featreg.simulate import SimulatedPair, sar_pair

torch = pytest.importorskip("torch")
pytest.importorskip("kornia", minversion="0.9")
SHIPPED = all(map(trained.packaged, trained.PACKAGED))
with_weights = pytest.mark.skipif(not SHIPPED, reason=f"trained weights are not here: {trained.LEARNED_CURE}")
# DISK normalises every layer by the mean and spread of what it sees.
IN_COMMON = {"kornia-disk": 0.6, "kornia-aliked": 0.8, "kornia-xfeat": 0.8}


@pytest.fixture(scope="module")
def small() -> SimulatedPair:
    return sar_pair((320, 352), rotation_deg=3, seed=3)


def test_a_package_that_is_not_there_has_no_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trained, "find_spec", lambda name: None)
    assert trained.packaged("xfeat.pt") is None
    assert trained.packaged("no such file") is None
    row: Any = registry.create("detector", "kornia-xfeat").row  # type: ignore[attr-defined]
    monkeypatch.setenv("TORCH_HOME", "/nowhere")
    assert trained.LEARNED_CURE in row.unavailable
    assert row.on_demand


def test_weights_of_a_package_come_before_a_download(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The file of an installed package is loaded as it stands, and nothing is asked of the network."""
    package, inside = trained.PACKAGED["xfeat.pt"]
    torch.manual_seed(0)
    import kornia.feature

    module: Any = kornia.feature.XFeat()
    path = tmp_path / package / inside
    path.parent.mkdir(parents=True)
    torch.save(module.net.state_dict(), path)

    class Spec:
        submodule_search_locations = (str(tmp_path / package),)

    monkeypatch.setattr(trained, "find_spec", lambda name: Spec)
    monkeypatch.setattr(featreg_kornia, "reachable", lambda: pytest.fail("the network was asked"))
    featreg_kornia._network.cache_clear()
    try:
        made: Any = registry.create("detector", "kornia-xfeat")
        network = made.network()
    finally:
        featreg_kornia._network.cache_clear()
    assert made.row.unavailable == ""
    for key, value in module.net.state_dict().items():
        assert torch.equal(network.net.state_dict()[key], value), key


def safetensors(tensors: dict[str, np.ndarray], path: Path) -> str:
    header, body = {}, b""
    for name, array in tensors.items():
        header[name] = {
            "dtype": "F32",
            "shape": list(array.shape),
            "data_offsets": [len(body), len(body) + array.nbytes],
        }
        body += array.tobytes()
    text = json.dumps({"__metadata__": {"format": "pt"}, **header}).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + body)
    return str(path)


def test_safetensors_are_read(tmp_path: Path) -> None:
    given: Any = torch.nn.Linear(3, 2)
    path = safetensors({k: v.numpy() for k, v in given.state_dict().items()}, tmp_path / "linear.safetensors")
    module: Any = torch.nn.Linear(3, 2)
    trained.load_weights(module, path)
    for key, value in given.state_dict().items():
        assert torch.equal(module.state_dict()[key], value)


@pytest.mark.parametrize(
    "content", [b"", b"\xff" * 40, (5).to_bytes(8, "little") + b"{[1]}", (2).to_bytes(8, "little") + b"[]"]
)
def test_a_broken_safetensors_file_is_named(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "bad.safetensors").write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.safetensors: is no safetensors file"):
        trained.load_weights(torch.nn.Linear(3, 2), str(tmp_path / "bad.safetensors"))


@pytest.mark.parametrize("length", [1, 100, 1024, 1025, 2100, 5000])
def test_parts_of_an_axis_cover_it_once_and_see_a_rim(length: int) -> None:
    import sys

    registry.available("detector")
    module: Any = sys.modules["featreg.detectors.kornia"]
    ranges = module.parts(length, 1024)
    own = np.concatenate([np.arange(length)[one] for one, _ in ranges])
    np.testing.assert_array_equal(own, np.arange(length))
    for one, seen in ranges:
        assert seen.start % 32 == 0
        assert seen.start == max(one.start - 96, 0)
        assert seen.stop == min(one.stop + 96, length) or len(ranges) == 1
        assert one.stop - one.start <= 1024


@with_weights
@pytest.mark.parametrize("name", IN_COMMON)
def test_an_image_seen_by_parts_has_the_points_of_the_whole(name: str, small: SimulatedPair) -> None:
    """Nearly: the networks look further than the rim."""
    image = as_image(small.reference[:256, :320])
    whole = registry.create("detector", name, n_features=300).detect_features(image)
    tiled = registry.create("detector", name, n_features=300, tile=160, batch=2).detect_features(image)
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(whole.xy).query(tiled.xy)
    near = np.asarray(distance < 0.5)
    assert near.mean() > IN_COMMON[name]
    assert whole.descriptors is not None
    assert tiled.descriptors is not None
    rows = np.asarray(nearest)[near]
    alike = (whole.descriptors[rows] * tiled.descriptors[near]).sum(axis=1)
    assert np.median(alike) > 0.95


@with_weights
@pytest.mark.parametrize(
    "method", ["kornia-disk-lightglue", "kornia-aliked-lightglue", "kornia-xfeat", "xfeat-lighterglue"]
)
def test_trained_methods_register_a_pair(method: str, small: SimulatedPair) -> None:
    """Random weights do not: this is what the weights are for."""
    reg = featreg.match(small.reference, small.secondary, method=method, n_features=400, refine=False)
    scores = featreg.evaluate(reg, small.truth)
    assert reg.status == "ok", reg.reason
    assert scores.ncm >= 40
    assert scores.grid_rmse < 1.0


@with_weights
def test_every_packaged_aliked_loads(small: SimulatedPair) -> None:
    crop = as_image(small.reference[:128, :128])
    for model in ("aliked-t16", "aliked-n16", "aliked-n16rot", "aliked-n32"):
        found = registry.create("detector", "kornia-aliked", model=model, n_features=50).detect_features(crop)
        assert found.descriptors is not None
        assert 0 < len(found) <= 50
        assert found.descriptors.shape[1] == (64 if model == "aliked-t16" else 128)


@with_weights
def test_a_second_run_with_trained_weights_gives_the_same_bits(small: SimulatedPair) -> None:
    crop = as_image(small.reference[:160, :160])
    one, two = (registry.create("detector", "kornia-xfeat", n_features=100).detect_features(crop) for _ in range(2))
    np.testing.assert_array_equal(one.xy, two.xy)
    np.testing.assert_array_equal(one.descriptors, two.descriptors)
