"""Back-projection by torch: the same image, and what is said where it cannot run."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from featreg.errors import ParameterError, PluginUnavailableError
from featreg.focusing.backprojection import back_project
from made.phase_histories import GRID, SMALL, echoes


def test_torch_gives_the_same_image() -> None:
    pytest.importorskip("torch")
    h = echoes([[0.5, 0.3, 0.0], [-1.0, 0.6, 0.0]], [1.0, 2j])
    for upsampling in (16, 7):
        numba, torch = (back_project(h, GRID, upsampling=upsampling, backend=b).pixels for b in ("numba", "torch"))
        np.testing.assert_allclose(torch, numba, atol=1e-5)


@pytest.mark.parametrize("device", ["cuda:9", "nonsense"])
def test_a_device_that_is_not_there_is_said(device: str) -> None:
    pytest.importorskip("torch")
    with pytest.raises(ParameterError, match=f"device '{device}' cannot be used here"):
        back_project(echoes([0.0, 0.0, 0.0], 1.0), SMALL, backend="torch", device=device)


def test_a_processor_of_graphics_gives_the_same_image() -> None:
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    h = echoes([[0.5, 0.3, 0.0], [-1.0, 0.6, 0.0]], [1.0, 2j])
    there = back_project(h, GRID, backend="torch", device="cuda").pixels
    np.testing.assert_allclose(there, back_project(h, GRID).pixels, atol=1e-5)


def test_torch_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(PluginUnavailableError, match=r"featreg\[torch\]"):
        back_project(echoes([0.0, 0.0, 0.0], 1.0), SMALL, backend="torch")
