"""kornia's detectors, descriptors and matching that need no weights, its presets, and what is said without it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import FeatregError, ParameterError
from featreg.interop import kornia as featreg_kornia
from featreg.interop import weights as trained
from featreg.io import as_image
from featreg.presets import PRESETS
from featreg.simulate import SimulatedPair
from featreg.types import Features

torch = pytest.importorskip("torch")
pytest.importorskip("kornia", minversion="0.9")

Texture = Callable[..., NDArray[np.float32]]
HANDMADE = ("kornia-harris", "kornia-gftt", "kornia-hessian", "kornia-dog")


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
def test_noisy_copies_are_paired_and_strangers_are_not(random_features: Callable[..., Features], name: str) -> None:
    rng = np.random.default_rng(1)
    known = random_features(300, 32)
    assert known.descriptors is not None
    copies = replace(
        known,
        xy=known.xy + np.array([7.0, -3.0]),
        descriptors=(known.descriptors + 0.2 * rng.normal(size=(300, 32))).astype(np.float32),
    )
    strangers = random_features(300, 32, seed=9)
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


def test_fginn_lets_two_descriptors_of_one_place_be_alike(random_features: Callable[..., Features]) -> None:
    table = np.eye(4, dtype=np.float32)
    a = replace(random_features(4), xy=np.arange(8.0).reshape(4, 2) * 50, descriptors=table)
    twice = np.concatenate([table, table + np.float32(0.001)])
    b = Features(np.tile(a.xy, (2, 1)), np.ones(8), np.zeros(8), np.ones(8), np.zeros(8, np.int64), twice)
    assert len(registry.create("nearest", "kornia-fginn", threshold=0.5).match_features(a, b)[0]) == 4
    blurred = replace(a, descriptors=(table + 0.3).astype(np.float32))
    assert len(registry.create("nearest", "kornia-smnn", threshold=0.5).match_features(blurred, b)[0]) == 0


@pytest.mark.parametrize("name", ["kornia-smnn", "kornia-fginn", "kornia-adalam"])
def test_features_without_descriptors_are_refused(random_features: Callable[..., Features], name: str) -> None:
    with pytest.raises(ParameterError, match="needs descriptors"):
        registry.create("nearest", name).match_features(random_features(), random_features())


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
