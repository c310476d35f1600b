"""kornia's detectors, descriptors and matching, the conversions to its tensors, and how weights are found."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import FeatregError, InputError, ParameterError, PluginUnavailableError
from featreg.interop import kornia as featreg_kornia
from featreg.interop import weights as trained
from featreg.interop.torch_arrays import as_device, inference, to_image, to_tensor
from featreg.io import as_image
from featreg.presets import PRESETS
from featreg.simulate import SimulatedPair
from featreg.types import Features

torch = pytest.importorskip("torch")
pytest.importorskip("kornia", minversion="0.9")
import kornia.feature as library  # noqa: E402

Texture = Callable[..., NDArray[np.float32]]
HANDMADE = ("kornia-harris", "kornia-gftt", "kornia-hessian", "kornia-dog")
PATCH_NETWORKS = {"hardnet": "HardNet", "hardnet8": "HardNet8", "hynet": "HyNet", "sosnet": "SOSNet"}
ENTRIES = [
    e for kind in ("detector", "descriptor", "nearest", "matcher") for e in registry.entries(kind) if "kornia" in e.name
]
LEARNED = [e for e in ENTRIES if "weights" in e.parameters]


def features(n: int = 40, width: int = 0, seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(n, width)).astype(np.float32) if width else None
    return Features(
        rng.uniform(0, 100, (n, 2)), rng.uniform(3, 20, n), rng.uniform(0, 6.28, n), rng.uniform(size=n),
        np.zeros(n, np.int64), table,
    )  # fmt: skip


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


# Tensors and frames


def test_a_frame_is_what_kornia_makes_of_centre_scale_and_angle() -> None:
    given = features()
    made = library.laf_from_center_scale_ori(
        torch.from_numpy(np.array(given.xy))[None],
        torch.from_numpy(np.array(given.scale)).reshape(1, -1, 1, 1),
        torch.from_numpy(np.rad2deg(given.angle)).reshape(1, -1, 1),
    )
    np.testing.assert_allclose(given.to_lafs().numpy(), made.numpy(), atol=1e-9)


def test_features_survive_the_way_to_frames_and_back() -> None:
    given = features(width=8)
    again = Features.from_lafs(given.to_lafs(), given.score, given.descriptors)
    for name in ("xy", "scale", "angle", "score", "descriptors"):
        np.testing.assert_allclose(getattr(again, name), getattr(given, name), rtol=1e-12, atol=1e-9)


def test_padding_is_left_out_and_an_elongated_or_mirrored_frame_becomes_a_circle() -> None:
    lafs = torch.tensor([[[[8.0, 0, 5], [0, -2, 7]], [[0, 0, 0], [0, 0, 0]]]])
    found = Features.from_lafs(lafs, [3.0, 0.0], np.ones((2, 4), np.float32))
    assert found.xy.tolist() == [[5, 7]]
    assert found.scale.tolist() == pytest.approx([4])
    assert found.score.tolist() == [3]
    assert found.descriptors is not None
    assert found.descriptors.shape == (1, 4)


def test_no_features_are_no_frames() -> None:
    assert Features.empty().to_lafs().shape == (1, 0, 2, 3)
    assert len(Features.from_lafs(torch.zeros(1, 5, 2, 3))) == 0


def test_the_patch_of_a_frame_is_the_image_around_it(sar_texture: Texture) -> None:
    """A circle of radius 10.5 at pixel (30, 40) is the 21 x 21 square around it: no half pixel lies between us."""
    tensor = to_tensor(as_image(sar_texture(100, 110)))
    one = Features(np.array([[30.0, 40.0]]), np.full(1, 10.5), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
    patch = library.extract_patches_simple(tensor, one.to_lafs().float(), 21)[0, 0, 0]
    np.testing.assert_allclose(patch.numpy(), tensor[0, 0, 30:51, 20:41].numpy(), atol=1e-4)


def test_an_angle_turns_the_patch_counter_clockwise(sar_texture: Texture) -> None:
    tensor = to_tensor(as_image(sar_texture(100, 110)))
    one = Features(np.array([[30.0, 40.0]]), np.full(1, 10.5), np.full(1, np.pi / 2), np.ones(1), np.zeros(1, np.int64))
    patch = library.extract_patches_simple(tensor, one.to_lafs().float(), 21)[0, 0, 0]
    # Its x axis points up, so the row through its middle is the column of the image, from bottom to top.
    np.testing.assert_allclose(patch[10].numpy(), tensor[0, 0, 30:51, 30].flip(0).numpy(), atol=1e-4)


def test_an_image_survives_the_way_to_a_tensor_and_back(sar_texture: Texture) -> None:
    amplitude = sar_texture(40, 50)
    again = to_image(torch.from_numpy(amplitude)[None, None])
    np.testing.assert_array_equal(again.amplitude, amplitude)
    picture = to_tensor(as_image(amplitude))
    assert (tuple(picture.shape), picture.dtype) == ((1, 1, 40, 50), torch.float32)
    assert float(picture.min()) == 0.0
    assert float(picture.max()) == 1.0
    assert to_image(torch.ones(20, 30, dtype=torch.complex64) * torch.arange(30)).is_complex


@pytest.mark.parametrize("shape", [(2, 20, 20), (1, 3, 20, 20), (20,)])
def test_more_than_one_image_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="one image is"):
        to_image(torch.ones(shape))


@pytest.mark.parametrize("shape", [(2, 3), (2, 4, 2, 3), (4, 2, 2)])
def test_what_is_no_frame_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="LAFs have shape"):
        Features.from_lafs(torch.zeros(shape))


@pytest.mark.parametrize("name", ["tpu9", "", "cuda:99"])
def test_a_device_that_is_not_there_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match="device"):
        as_device(name)


def test_threads_and_gradients_are_as_before_afterwards() -> None:
    before = torch.get_num_threads()
    with inference(1):
        assert torch.get_num_threads() == 1
        assert not torch.is_grad_enabled()
        with inference(1):
            pass
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before
    assert torch.is_grad_enabled()


# Detectors and descriptors without weights


@pytest.mark.parametrize("name", HANDMADE)
@pytest.mark.parametrize("width", [181, 200])
def test_points_and_angles_mirror_with_the_image(name: str, width: int, sar_texture: Texture) -> None:
    from scipy.spatial import cKDTree

    amplitude = sar_texture(150, width)
    detector = registry.create("detector", name)
    here, there = (detector.detect_features(as_image(a)) for a in (amplitude, amplitude[:, ::-1]))
    distance, partner = cKDTree(there.xy * [-1, 1] + [width - 1, 0]).query(here.xy)
    assert np.mean(distance < 0.01) > 0.98
    difference = (np.pi - there.angle[partner] - here.angle + np.pi) % (2 * np.pi) - np.pi
    assert np.median(np.abs(difference)) < 0.01


@pytest.mark.parametrize(("name", "bias"), [("kornia-dog", 1.08), ("kornia-hessian", 1.26)])
def test_blobs_are_found_where_they_are_and_as_large(name: str, bias: float) -> None:
    """The response of kornia's scale space peaks a little above the blob's own scale."""
    y, x = np.mgrid[0:200, 0:240].astype(np.float64)
    blobs = [(60.3, 50.7, 4.0), (150.25, 60.5, 6.0), (100.0, 140.0, 8.0), (190.6, 150.2, 5.0)]
    image = 20 + sum(150 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 2 / s**2) for cx, cy, s in blobs)
    found = registry.create("detector", name, normalise="linear-stretch").detect_features(as_image(image))
    for cx, cy, s in blobs:
        distance = np.hypot(*(found.xy - [cx, cy]).T)
        nearest = np.argmin(distance)
        assert distance[nearest] < 0.1
        assert found.scale[nearest] / 6 == pytest.approx(bias * s, rel=0.05)


@pytest.mark.parametrize("name", HANDMADE)
def test_angles_turn_with_the_image(name: str, sar_texture: Texture) -> None:
    from scipy.spatial import cKDTree

    amplitude = sar_texture(161, 161)
    detector = registry.create("detector", name)
    here, there = (detector.detect_features(as_image(a)) for a in (amplitude, np.rot90(amplitude)))
    turned = np.column_stack([here.xy[:, 1], 160 - here.xy[:, 0]])
    distance, partner = cKDTree(there.xy).query(turned)
    assert np.mean(distance < 0.01) > 0.98
    difference = (there.angle[partner] - here.angle - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi
    assert np.median(np.abs(difference)) < 0.01


def test_the_best_are_the_best_of_all_candidates(sar_texture: Texture) -> None:
    image = as_image(sar_texture(150, 160))
    every = registry.create("detector", "kornia-gftt", n_features=100000).detect_features(image)
    few = registry.create("detector", "kornia-gftt", n_features=40).detect_features(image)
    np.testing.assert_array_equal(few.xy, every.xy[:40])


def test_upright_points_have_angle_zero(sar_texture: Texture) -> None:
    found = registry.create("detector", "kornia-dog", orientation="none").detect_features(as_image(sar_texture()))
    assert not found.angle.any()


@pytest.mark.parametrize("name", ["kornia-sift", "kornia-mkd"])
def test_descriptors_do_not_depend_on_how_many_are_made_at_once(name: str, sar_texture: Texture) -> None:
    image = as_image(sar_texture(150, 160))
    points = registry.create("detector", "kornia-gftt").detect_features(image)
    descriptor = registry.create("descriptor", name)
    whole, part = (descriptor.describe_features(image, p) for p in (points, points.take(np.arange(7))))
    assert whole.descriptors is not None
    assert part.descriptors is not None
    np.testing.assert_allclose(part.descriptors, whole.descriptors[:7], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(whole.descriptors, axis=1), 1, atol=1e-4)


@pytest.mark.parametrize(
    "name",
    [
        "kornia-dog-sift",
        pytest.param("kornia-hessian-mkd", marks=pytest.mark.slow),
        pytest.param("kornia-gftt-sift", marks=pytest.mark.slow),
    ],
)
def test_methods_without_weights_recover_a_known_warp(name: str, pair: SimulatedPair) -> None:
    reg = featreg.match(pair.reference, pair.secondary, method=name, refine=False, n_features=600)
    assert reg.status == "ok", reg.reason
    scores = featreg.evaluate(reg, pair.truth)
    assert scores.grid_rmse < 1.0
    assert scores.rmse < 1.0


# Matching without weights


@pytest.mark.parametrize("name", ["kornia-smnn", "kornia-fginn", "kornia-adalam"])
def test_noisy_copies_are_paired_and_strangers_are_not(name: str) -> None:
    rng = np.random.default_rng(1)
    known = features(300, 32)
    assert known.descriptors is not None
    copies = replace(
        known,
        xy=known.xy + np.array([7.0, -3.0]),
        descriptors=(known.descriptors + 0.2 * rng.normal(size=(300, 32))).astype(np.float32),
    )
    strangers = features(300, 32, seed=9)
    nearest = registry.create("nearest", name)
    pairs, score = nearest.match_features(known, copies)
    assert len(pairs) > 250
    assert np.mean(pairs[:, 0] == pairs[:, 1]) > 0.99
    assert np.isfinite(score).all()
    found, chance = nearest.match_features(known, strangers)
    if name == "kornia-adalam":  # it falls back to a ratio test, with scores below the confidence it asks for
        assert (chance < np.log10(200)).all()
        assert (score > np.log10(200)).all()
    else:
        assert len(found) < 60


def test_fginn_lets_two_descriptors_of_one_place_be_alike() -> None:
    table = np.eye(4, dtype=np.float32)
    a = replace(features(4), xy=np.arange(8.0).reshape(4, 2) * 50, descriptors=table)
    twice = np.concatenate([table, table + np.float32(0.001)])
    b = Features(np.tile(a.xy, (2, 1)), np.ones(8), np.zeros(8), np.ones(8), np.zeros(8, np.int64), twice)
    assert len(registry.create("nearest", "kornia-fginn", threshold=0.5).match_features(a, b)[0]) == 4
    blurred = replace(a, descriptors=(table + 0.3).astype(np.float32))
    assert len(registry.create("nearest", "kornia-smnn", threshold=0.5).match_features(blurred, b)[0]) == 0


@pytest.mark.parametrize("name", ["kornia-smnn", "kornia-fginn", "kornia-adalam"])
def test_features_without_descriptors_are_refused(name: str) -> None:
    with pytest.raises(ParameterError, match="needs descriptors"):
        registry.create("nearest", name).match_features(features(), features())


# Networks, with random weights


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


def test_lightglue_pairs_what_it_was_made_for(tmp_path: Path) -> None:
    path = saved(seeded(random_lightglue), tmp_path / "lightglue.pth")
    nearest = registry.create("nearest", "kornia-lightglue", weights=path, filter_threshold=0.0)
    pairs, score = nearest.match_features(features(30, 128), features(25, 128, seed=1))
    assert pairs.shape == (len(score), 2)
    assert len(np.unique(pairs[:, 0])) == len(pairs)
    assert (pairs < [30, 25]).all()
    with pytest.raises(ParameterError, match="length 128, got 64"):
        nearest.match_features(features(30, 64), features(25, 64))


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


# The registry and the presets


def test_every_preset_of_kornia_is_made_of_registered_parts() -> None:
    names = [name for name in PRESETS if name.startswith("kornia-")]
    assert len(names) >= 8
    for name in names:
        for role, part in PRESETS[name].parts:
            known = registry.entry(role, part.name)
            assert set(part.parameters) <= set(known.parameters)


def test_a_preset_without_weights_says_so(monkeypatch: pytest.MonkeyPatch, pair: SimulatedPair, tmp_path: Path) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(featreg_kornia, "reachable", lambda: False)
    monkeypatch.setattr(trained, "find_spec", lambda name: None)
    with pytest.raises(FeatregError, match="give weights=FILE"):
        featreg.match(pair.reference, pair.secondary, method="kornia-disk-lightglue")


BLOCKED = """
import sys
for name in ("torch", "kornia"):
    sys.modules[name] = None
import numpy as np
import featreg
from featreg import registry
from featreg.types import Features

kinds = ("detector", "descriptor", "nearest", "matcher")
entries = [e for k in kinds for e in registry.entries(k) if "kornia" in e.name]
assert len(entries) > 15
assert all(e.unavailable == "torch is not installed; pip install 'featreg[torch]'" for e in entries), entries
assert not registry.broken()
assert not [n for n in featreg.available("detector") if "kornia" in n]
for call in (
    lambda: featreg.create("detector", "kornia-dog"),
    lambda: featreg.create("detector", "kornia-disk", weights="some.pth"),
    lambda: Features.empty().to_lafs(),
    lambda: featreg.match(np.ones((40, 40)) + np.eye(40), np.ones((40, 40)) + np.eye(40), method="kornia-dog-sift"),
):
    try:
        call()
    except featreg.errors.PluginUnavailableError as error:
        assert "pip install 'featreg[torch]'" in str(error)
    else:
        raise SystemExit("no error")
"""


def test_without_torch_the_plugins_are_listed_with_the_cure() -> None:
    done = subprocess.run([sys.executable, "-c", BLOCKED], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_looking_the_plugins_up_does_not_import_torch() -> None:
    code = "import sys, featreg; featreg.available('detector'); sys.exit(bool({'torch', 'kornia'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], timeout=120).returncode == 0


def test_an_old_kornia_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(featreg_kornia, "version", lambda name: "0.8.2")
    assert featreg_kornia.library_missing().startswith("kornia 0.8.2 is installed, 0.9 or newer is needed")
