"""Orientation correlation in PyTorch against the compiled one."""

from __future__ import annotations

import numpy as np
import pytest

from featreg import registry
from featreg.errors import InputError, ParameterError
from featreg.sar.orientation.field import field_of
from featreg.sar.orientation.search import Grid, search
from featreg.simulate import SimulatedPair
from featreg.types import Image

torch = pytest.importorskip("torch")


def images(pair: SimulatedPair) -> tuple[Image, Image]:
    valid = np.ones(pair.reference.shape, np.bool_)
    return Image(pair.reference, valid), Image(pair.secondary, pair.secondary > 0)


def test_the_module_gives_the_compiled_field(pair: SimulatedPair) -> None:
    from featreg.interop.torch_orientation import orientation_module

    # So small that the compiled field takes the median of all pixels too.
    views = [np.ascontiguousarray(pair.reference[:63, :71]), np.ascontiguousarray(pair.reference[60:123, 90:161])]
    batch = torch.from_numpy(np.stack(views))[:, None].requires_grad_()
    fields = orientation_module(alpha=2.0)(batch)
    assert fields.shape == (2, 2, 63, 71)
    for view, field in zip(views, fields.detach().numpy(), strict=True):
        np.testing.assert_allclose(field.transpose(1, 2, 0), field_of(view, 2.0), atol=2e-4)
    fields.square().sum().backward()
    assert torch.isfinite(batch.grad).all()
    assert float(batch.grad.abs().max()) > 0


def test_nothing_gives_nothing_and_wrong_input_is_told() -> None:
    from featreg.interop.torch_orientation import orientation_module

    assert not orientation_module()(torch.ones(1, 1, 40, 40)).any()
    with pytest.raises(InputError, match="B, 1, H, W"):
        orientation_module()(torch.ones(40, 40))
    with pytest.raises(ParameterError, match="alpha"):
        orientation_module(alpha=-1.0)


def test_the_search_finds_the_same_alignments(turned_pair: SimulatedPair) -> None:
    from featreg.interop.torch_orientation import TorchCorrelator

    grid = Grid(32, 15.0, (1.0, 1.2))
    ours = search(*images(turned_pair), grid, most=4)
    theirs = search(*images(turned_pair), grid, most=4, correlator=TorchCorrelator("cpu"))
    assert len(ours) == len(theirs) == 4
    # OpenCV interpolates by steps of 1/32 px.
    assert ours[0].score == pytest.approx(theirs[0].score, rel=0.02)
    np.testing.assert_allclose(ours[0].affine, theirs[0].affine, atol=1e-9)


def test_a_device_needs_torch(turned_pair: SimulatedPair) -> None:
    matcher = registry.create("matcher", "orientation-correlation", device="cpu")
    with pytest.raises(ParameterError, match="backend='torch'"):
        matcher.match(*images(turned_pair))
