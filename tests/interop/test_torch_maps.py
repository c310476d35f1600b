"""The dense maps in PyTorch against the compiled loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.sar import correlation
from featreg.sar.gradients.ratio import roewa
from featreg.sar.keypoints.harris import harris_response
from featreg.simulate import SimulatedPair

torch = pytest.importorskip("torch")


@pytest.fixture
def views(pair: SimulatedPair) -> NDArray[np.float32]:
    return np.stack([pair.reference[:90, :120], pair.reference[60:150, 90:210]])


@pytest.mark.parametrize("alpha", [0.7, 2.0, 6.0, 200.0])
def test_the_gradients_are_the_compiled_ones(views: NDArray[np.float32], alpha: float) -> None:
    from featreg.interop.torch_maps import roewa_module

    found = roewa_module(alpha, 0.05)(torch.from_numpy(views)[:, None]).numpy()
    assert found.shape == (2, 2, 90, 120)
    for view, gradients in zip(views, found, strict=True):
        np.testing.assert_allclose(gradients, roewa(np.ascontiguousarray(view), alpha, None, 0.05), atol=2e-4)


def test_the_response_is_the_detectors(views: NDArray[np.float32]) -> None:
    from featreg.interop.torch_maps import harris_module

    found = harris_module(2.0, 0.8, 0.04, 0.01)(torch.from_numpy(views)[:, None]).numpy()[:, 0]
    for view, response in zip(views, found, strict=True):
        wanted = harris_response(*roewa(np.ascontiguousarray(view), 2.0, None, 0.01), 1.6, 0.04)
        np.testing.assert_allclose(response, wanted, atol=1e-4 * float(np.abs(wanted).max()))


@pytest.mark.parametrize("few", [True, False])
def test_the_correlations_are_the_compiled_ones(pair: SimulatedPair, few: bool) -> None:
    from featreg.interop.torch_maps import local_correlations

    first = np.log(pair.reference[:160, :180] + np.float32(0.1))
    second = np.roll(first, (1, -2), (0, 1)) + np.random.default_rng(0).normal(5, 0.1, first.shape).astype(np.float32)
    first[20:70, 20:70] = 3
    xy = np.random.default_rng(1).integers(20, 140, (6 if few else 150, 2))
    xy[0] = 44, 44
    here, there = torch.from_numpy(first), torch.from_numpy(second)
    found = local_correlations(here, there, torch.from_numpy(xy), 12, 4)
    wanted = correlation.local_correlations(first, second, xy, 12, 4)
    np.testing.assert_allclose(found.numpy(), wanted, atol=2e-4)
    assert not found[0].any()
    assert local_correlations(here, there, torch.zeros(0, 2), 12, 4).shape == (0, 9, 9)


def test_they_differentiate(views: NDArray[np.float32]) -> None:
    from featreg.interop.torch_maps import harris_module

    batch = torch.from_numpy(views)[:, None].clone().requires_grad_()
    harris_module()(batch).sum().backward()
    assert torch.isfinite(batch.grad).all()
    assert float(batch.grad.abs().max()) > 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 2), (3, 3)])
def test_tiny_images_have_gradients(shape: tuple[int, int]) -> None:
    from featreg.interop.torch_maps import roewa_module

    view = np.random.default_rng(0).gamma(4, 0.25, shape).astype(np.float32)
    found = roewa_module(1.5)(torch.from_numpy(view)[None, None]).numpy()[0]
    np.testing.assert_allclose(found, roewa(view, 1.5), atol=2e-4)


def test_wrong_input_is_told() -> None:
    from featreg.interop.torch_maps import harris_module, local_correlations, roewa_module

    with pytest.raises(InputError, match="B, 1, H, W"):
        roewa_module()(torch.ones(40, 40))
    with pytest.raises(InputError, match="must be floating point"):
        harris_module()(torch.ones(1, 1, 40, 40, dtype=torch.int32))
    with pytest.raises(ParameterError, match="alpha"):
        roewa_module(alpha=0)
    with pytest.raises(ParameterError, match="integration"):
        harris_module(integration=float("nan"))
    plane: Any = torch.ones(40, 40)
    with pytest.raises(InputError, match="8 pixels or more inside"):
        local_correlations(plane, plane, torch.tensor([[7, 20]]), 6, 2)
    with pytest.raises(InputError, match="one size"):
        local_correlations(plane, plane[1:], torch.tensor([[20, 20]]), 6, 2)
