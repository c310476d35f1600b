"""Trust in whole registrations: unrelated, identical, mirrored and right ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import FloatArray

Texture = Callable[..., NDArray[np.float32]]


def corner_error(model: Any, truth: FloatArray, size: int) -> float:
    corners = np.array([[0.0, 0], [size - 1, 0], [0, size - 1], [size - 1, size - 1]])
    return float(np.abs(model(corners) - corners @ truth[:, :2].T - truth[:, 2]).max())


@pytest.mark.parametrize("method", ["sar-orb", "orb"])
@pytest.mark.parametrize("seed", range(2))
def test_unrelated_images_are_unreliable_with_a_reason(method: str, seed: int) -> None:
    one, other = sar_pair((256, 256), seed=10 + seed), sar_pair((256, 256), seed=20 + seed)
    found = featreg.match(one.reference, other.secondary, method=method)
    assert found.status == "unreliable"
    assert found.reason


@pytest.mark.slow
def test_none_of_two_hundred_unrelated_crops_is_trusted() -> None:
    rng = np.random.default_rng(0)
    scenes = [sar_pair((500, 500), seed=100 + i).reference for i in range(6)]
    trusted = []
    for _ in range(200):
        i, j = rng.choice(6, 2, replace=False)
        size = int(rng.integers(100, 400))
        crops = []
        for k in (i, j):
            y, x = rng.integers(0, 500 - size, 2)
            crops.append(scenes[k][y : y + size, x : x + size])
        found = featreg.match(*crops)
        assert found.status == "ok" or found.reason
        trusted.append(found.status == "ok")
    assert sum(trusted) == 0


def test_an_image_and_itself_are_ok(sar_texture: Texture) -> None:
    amplitude = sar_texture(256, 256)
    found = featreg.match(amplitude, amplitude.copy())
    assert found.status == "ok"
    assert corner_error(found.model, np.eye(3)[:2], 256) < 0.02


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("method", ["sar-orb", "sift"])
def test_a_mirrored_secondary_is_unreliable(pair: SimulatedPair, method: str, axis: int) -> None:
    assert featreg.match(pair.reference, np.flip(pair.secondary, axis), method=method).status == "unreliable"


@pytest.mark.parametrize("seed", range(3))
def test_a_pair_of_one_scene_is_ok_and_right(seed: int) -> None:
    made = sar_pair((300, 300), seed=30 + seed, rotation_deg=[-12.0, 4.0, 18.0][seed], scale=[0.95, 1.0, 1.06][seed])
    found = featreg.match(made.reference, made.secondary)
    assert found.status == "ok", found.reason
    assert corner_error(found.model, made.truth, 300) < 0.5
