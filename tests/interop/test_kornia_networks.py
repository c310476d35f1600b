"""kornia's networks, with random weights, and how files of weights are read."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.interop import kornia as featreg_kornia
from featreg.interop import weights as trained
from featreg.interop.torch_arrays import to_tensor
from featreg.io import as_image
from featreg.types import Features

torch = pytest.importorskip("torch")
pytest.importorskip("kornia", minversion="0.9")
import kornia.feature as library  # noqa: E402

Texture = Callable[..., NDArray[np.float32]]
PATCH_NETWORKS = {"hardnet": "HardNet", "hardnet8": "HardNet8", "hynet": "HyNet", "sosnet": "SOSNet"}
ENTRIES = [
    e for kind in ("detector", "descriptor", "nearest", "matcher") for e in registry.entries(kind) if "kornia" in e.name
]
LEARNED = [e for e in ENTRIES if "weights" in e.parameters]


def saved(module: Any, path: Path, wrap: str = "") -> str:
    """Random weights of a network in a file, as the authors of networks publish trained ones."""
    state = module.state_dict()
    torch.save({wrap: state} if wrap else state, path)
    return str(path)


def seeded(make: Callable[[], Any]) -> Any:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return make()


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


# Weights


def describe_with(path: str) -> None:
    image = as_image(np.random.default_rng(0).gamma(4, size=(64, 64)))
    points = Features(np.full((1, 2), 30.0), np.full(1, 8.0), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
    registry.create("descriptor", "kornia-hardnet", weights=path).describe_features(image, points)


def test_a_wrong_file_of_weights_is_named_with_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        describe_with(str(tmp_path / "none.pth"))
    (tmp_path / "text.pth").write_text("no weights")
    with pytest.raises(InputError, match="holds no tensors that torch can read"):
        describe_with(str(tmp_path / "text.pth"))
    torch.save([1, 2], tmp_path / "list.pth")
    with pytest.raises(InputError, match="a mapping of names to tensors is needed"):
        describe_with(str(tmp_path / "list.pth"))
    with pytest.raises(InputError, match="is not of HardNet: lacks"):
        describe_with(saved(library.HyNet(False), tmp_path / "hynet.pth"))


class Bomb:
    """Its pickle would run code."""

    def __reduce__(self) -> Any:
        return (print, ("code of the file ran",))


def test_code_in_a_file_of_weights_does_not_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch.save({"state_dict": Bomb()}, tmp_path / "bomb.pth")
    with pytest.raises(InputError, match="holds no tensors"):
        describe_with(str(tmp_path / "bomb.pth"))
    assert capsys.readouterr().out == ""


def test_a_file_that_changed_is_read_again(tmp_path: Path, sar_texture: Texture) -> None:
    image = as_image(sar_texture(64, 64))
    points = Features(np.full((1, 2), 30.0), np.full(1, 8.0), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
    tables = []
    for number in range(2):
        torch.manual_seed(number)
        path = saved(library.HardNet(False), tmp_path / "weights.pth")
        (tmp_path / "weights.pth").touch()
        found = registry.create("descriptor", "kornia-hardnet", weights=path).describe_features(image, points)
        assert found.descriptors is not None
        tables.append(found.descriptors)
        time.sleep(0.02)
    assert not np.array_equal(tables[0], tables[1])


@pytest.mark.parametrize("entry", LEARNED, ids=lambda e: e.name)
def test_without_weights_and_network_the_cure_is_named(
    entry: registry.Entry, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sar_texture: Texture
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(featreg_kornia, "reachable", lambda: False)
    monkeypatch.setattr(trained, "find_spec", lambda name: None)
    made = registry.create(entry.kind, entry.name)  # type: ignore[call-overload]
    assert made.row.on_demand
    assert "give weights=FILE" in made.row.unavailable
    with pytest.raises(PluginUnavailableError, match=f"{entry.name}: its trained weights are not on this machine"):
        made.network()


def test_weights_in_kornias_cache_make_a_plugin_available(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    row = registry.create("descriptor", "kornia-hardnet").row  # type: ignore[attr-defined]
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert row.unavailable
    folder = tmp_path / "hub" / "checkpoints"
    folder.mkdir(parents=True)
    torch.save({"state_dict": seeded(lambda: library.HardNet(False)).state_dict()}, folder / row.files({})[0])
    assert not row.unavailable
    featreg_kornia._network.cache_clear()
    try:
        assert type(registry.create("descriptor", "kornia-hardnet").network()).__name__ == "HardNet"  # type: ignore[attr-defined]
    finally:
        featreg_kornia._network.cache_clear()


def test_a_silent_network_is_given_up_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    def silent(*_: Any, **__: Any) -> Any:
        time.sleep(0.5)
        raise OSError

    monkeypatch.setattr(socket, "create_connection", silent)
    monkeypatch.setattr(featreg_kornia, "PATIENCE", 0.05)
    assert not featreg_kornia.reachable()


@pytest.mark.parametrize(
    ("kind", "name", "parameters"),
    [
        ("detector", "kornia-harris", {"n_features": 0}),
        ("detector", "kornia-dog", {"orientation": "up"}),
        ("detector", "kornia-dog", {"normalise": "loud"}),
        ("detector", "kornia-disk", {"checkpoint": "deep"}),
        ("detector", "kornia-disk", {"weights": 7}),
        ("descriptor", "kornia-sift", {"patch_size": 0}),
        ("descriptor", "kornia-mkd", {"kernel_type": "square"}),
        ("nearest", "kornia-smnn", {"threshold": -0.1}),
        ("nearest", "kornia-lightglue", {"features": "orb"}),
    ],
)
def test_impossible_parameters_are_refused(kind: Any, name: str, parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=next(iter(parameters))):
        registry.create(kind, name, **parameters)
