"""Orientation correlation in PyTorch: the field as a module, and the global search on whatever device there is.

Both agree with `featreg.sar.orientation` to the rounding of float32 (the search: at the same rotations and shifts).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.interop.torch_arrays import as_device
from featreg.interop.torch_maps import ratio_gradients
from featreg.runtime.optional import import_torch
from featreg.sar.gradients.ratio import FLOOR, LEAST_EDGE
from featreg.sar.orientation.search import Prepared
from featreg.types import FloatArray

if TYPE_CHECKING:
    from torch import Tensor


def orientation_module(alpha: float = 3.0, floor: float = FLOOR) -> Any:
    """Return a `torch.nn.Module` that maps amplitudes (B, 1, H, W) to their orientation fields (B, 2, H, W).

    Parameters
    ----------
    alpha : of the ROEWA gradients, px
    floor : added to the means, relative to the mean amplitude of each image

    Raises
    ------
    ParameterError
        alpha is not a positive finite number.

    Notes
    -----
    As `featreg.sar.orientation.field.orientation_field` of images without nodata, from the gradients of
    `featreg.interop.torch_maps`. The median of the strength is that of all pixels.
    """
    if not (math.isfinite(alpha) and alpha > 0):
        raise ParameterError(f"alpha must be a positive number of pixels, got {alpha}")
    torch = import_torch()

    class OrientationField(torch.nn.Module):  # type: ignore[name-defined, misc]  # imported late
        def forward(self, amplitude: Tensor) -> Tensor:
            if amplitude.ndim != 4 or amplitude.shape[1] != 1:
                raise InputError(f"amplitudes must be (B, 1, H, W), got {tuple(amplitude.shape)}")
            return _field(torch, amplitude[:, 0], alpha, floor)

    return OrientationField()


def _field(torch: Any, amplitude: Tensor, alpha: float, floor: float) -> Tensor:
    height, width = amplitude.shape[-2:]
    gx, gy = ratio_gradients(torch, amplitude, alpha, floor)
    rim = math.ceil(alpha)
    inside = torch.zeros_like(gx)
    inside[..., rim : height - rim, rim : width - rim] = 1
    strength = gx**2 + gy**2
    middle = torch.stack([_middle(torch, one) for one in strength])[:, None, None]
    scale = inside * (strength.amax(dim=(-2, -1), keepdim=True) > LEAST_EDGE**2) / (strength + middle)
    field: Tensor = torch.stack([(gx**2 - gy**2) * scale, 2 * gx * gy * scale], dim=1)
    return field


def _middle(torch: Any, strength: Tensor) -> Tensor:
    """The median of the positive strengths, 1 without any; of an even number the mean of the two in the middle."""
    some = strength[strength > 0]
    if not len(some):
        return torch.ones_like(strength[0, 0])  # type: ignore[no-any-return]  # torch may be absent when types are checked
    middle: Tensor = torch.quantile(some[:: max(1, len(some) // 1_000_000)], 0.5)
    return middle


class TorchCorrelator:
    """A `featreg.sar.orientation.search.Correlator` that turns, transforms and correlates all rotations at once.

    Parameters
    ----------
    device : "cpu", "cuda", "auto", ...; see `featreg.interop.torch_arrays.as_device`
    """

    def __init__(self, device: str = "auto") -> None:
        self.torch = import_torch()
        self.device = as_device(device)

    def __call__(self, prepared: Prepared, rotations: int) -> FloatArray:
        torch, n = self.torch, len(prepared.canvas)
        degrees = [i * 90 / rotations + 90 * q + 180 * h for i in range(rotations) for q in (0, 1) for h in (0, 1)]
        first = torch.from_numpy(np.ascontiguousarray(prepared.canvas.transpose(2, 0, 1))).to(self.device)
        second = torch.from_numpy(np.ascontiguousarray(prepared.second.transpose(2, 0, 1))).to(self.device)
        there = self._turned(prepared, second, degrees)
        one, powers = torch.complex(first[0], first[1]), torch.nn.functional.avg_pool2d
        found = torch.fft.ifft2(torch.fft.fft2(one) * torch.fft.fft2(there).conj()).real
        square = [4 * powers(part[:, None], 2)[:, 0] for part in (one.abs()[None] ** 2, there.abs() ** 2)]
        energy = torch.fft.ifft2(torch.fft.fft2(square[0]) * torch.fft.fft2(square[1]).conj()).real
        weight = torch.where(energy < prepared.least, 0, 1 / torch.sqrt(torch.clamp(energy, min=1e-30) / 2))
        score = found * weight.repeat_interleave(2, 1).repeat_interleave(2, 2)
        best, at = score.reshape(len(degrees), -1).max(dim=1)
        columns = [best.double(), (at // n).double(), (at % n).double()]
        return np.asarray(torch.stack(columns, dim=1).cpu().numpy(), np.float64)

    def _turned(self, prepared: Prepared, second: Tensor, degrees: list[float]) -> Tensor:
        """(R, n, n) complex fields of the second image at all rotations."""
        torch, n = self.torch, len(prepared.canvas)
        height, width = prepared.second.shape[:2]
        y, x = torch.meshgrid(*[torch.arange(n, device=self.device, dtype=torch.float32)] * 2, indexing="ij")
        into = torch.from_numpy(np.array([prepared.into(turn) for turn in degrees], np.float32)).to(self.device)
        here = torch.stack([x, y, torch.ones_like(x)]).reshape(3, -1)
        at = (into @ here).reshape(len(degrees), 2, n, n).permute(0, 2, 3, 1)
        size = torch.tensor([width - 1, height - 1], device=self.device, dtype=torch.float32)
        sampled = torch.nn.functional.grid_sample(
            second.expand(len(degrees), -1, -1, -1), 2 * at / size - 1, mode="bilinear", align_corners=True
        )
        angle = torch.tensor([-2 * math.radians(turn) for turn in degrees], device=self.device)
        phase = torch.complex(torch.cos(angle), torch.sin(angle))[:, None, None]
        fields: Tensor = torch.complex(sampled[:, 0], sampled[:, 1]) * phase
        return fields
