"""The dense maps of a SAR image in PyTorch: ratio gradients, SAR-Harris response, local correlation.

One code for any device, batched and differentiable; the numbers are those of the compiled loops to the rounding of
float32. Images are whole: what has nodata is filled first (`featreg.sar.speckle.filled_amplitude`). The orientation
field stands in `featreg.interop.torch_orientation`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from featreg.errors import InputError, ParameterError
from featreg.runtime.optional import import_torch
from featreg.sar.gradients.ratio import FLOOR
from featreg.sar.keypoints.harris import REACH, reflected

if TYPE_CHECKING:
    from torch import Tensor


def roewa_module(alpha: float = 2.0, floor: float = FLOOR) -> Any:
    """Return a `torch.nn.Module` that maps amplitudes (B, 1, H, W) to their ratio gradients (B, 2, H, W): gx, gy.

    Parameters
    ----------
    alpha : exponential weight of the one-sided means, px
    floor : added to the means, relative to the mean amplitude of each image

    Raises
    ------
    ParameterError
        alpha is not a positive finite number.

    Notes
    -----
    `featreg.sar.gradients.ratio.roewa` without a mask, by products with matrices of the exponential weights instead of
    recursions, so that it runs and differentiates anywhere: fast on a graphics processor, slower than the compiled
    loops on a CPU.
    """
    _positive("alpha", alpha)
    torch = import_torch()

    class RatioGradients(torch.nn.Module):  # type: ignore[name-defined, misc]  # imported late
        def forward(self, amplitude: Tensor) -> Tensor:
            gradients: Tensor = torch.stack(ratio_gradients(torch, _planes(amplitude), alpha, floor), dim=1)
            return gradients

    return RatioGradients()


def harris_module(alpha: float = 2.0, integration: float = 0.8, d: float = 0.04, floor: float = FLOOR) -> Any:
    """Return a `torch.nn.Module` that maps amplitudes (B, 1, H, W) to their SAR-Harris responses (B, 1, H, W).

    Parameters
    ----------
    alpha, floor : of the ratio gradients, as in `roewa_module`
    integration : standard deviation, in units of alpha, of the Gaussian that smooths the matrix
    d : weight of the squared trace in the response det - d trace^2

    Raises
    ------
    ParameterError
        alpha or integration is not a positive finite number.

    Notes
    -----
    The response of one scale of the detector `sar-harris`, on the image itself.
    """
    _positive("alpha", alpha)
    _positive("integration", integration)
    torch = import_torch()

    class HarrisResponse(torch.nn.Module):  # type: ignore[name-defined, misc]  # imported late
        def forward(self, amplitude: Tensor) -> Tensor:
            gx, gy = ratio_gradients(torch, _planes(amplitude), alpha, floor)
            products = torch.stack([gx * gx, gx * gy, gy * gy], dim=1)
            xx, xy, yy = _smoothed(torch, products, integration * alpha).unbind(dim=1)
            response: Tensor = xx * yy - xy * xy - d * (xx + yy) ** 2
            return response[:, None]

    return HarrisResponse()


def local_correlations(first: Tensor, second: Tensor, xy: Tensor, half: int, search: int) -> Tensor:
    """Return the correlation coefficients of windows around points, for every small shift.

    Parameters
    ----------
    first, second : (H, W), aligned to within `search` pixels, on one device
    xy : (N, 2) whole points, at least half + search pixels inside
    half : half the window; it is 2 * half + 1 pixels wide
    search : largest shift along x and y

    Returns
    -------
    (N, 2 * search + 1, 2 * search + 1)
        As `featreg.sar.correlation.local_correlations`; 0 where a window is constant.

    Raises
    ------
    InputError
        Maps that are not planes of one size, or a window that leaves them.
    """
    torch = import_torch()
    if first.ndim != 2 or first.shape != second.shape:
        raise InputError(f"maps must be (H, W) of one size, got {tuple(first.shape)} and {tuple(second.shape)}")
    height, width = first.shape
    reach = half + search
    limit = torch.tensor([width, height], device=xy.device) - reach
    if not len(xy):
        return first.new_zeros((0, 2 * search + 1, 2 * search + 1))
    if not bool(((xy >= reach) & (xy < limit)).all()):
        raise InputError(f"points must lie {reach} pixels or more inside maps of {width} x {height}")
    small, large = (torch.arange(-n, n + 1, device=first.device) for n in (half, reach))
    x, y = xy.to(first.device).long().unbind(dim=1)
    here = first[(y[:, None] + small)[:, :, None], (x[:, None] + small)[:, None, :]]
    there = second[(y[:, None] + large)[:, :, None], (x[:, None] + large)[:, None, :]]
    level = (here**2).sum(dim=(1, 2))
    here = here - here.mean(dim=(1, 2), keepdim=True)
    # A level takes digits away from the power of what is left without it.
    there = there - there.mean(dim=(1, 2), keepdim=True)
    side = 2 * half + 1
    product = torch.nn.functional.conv2d(there[None], here[:, None], groups=len(xy))[0]
    total, power = (
        side**2 * torch.nn.functional.avg_pool2d(part[:, None], side, 1)[:, 0] for part in (there, there**2)
    )
    spread, own = power - total**2 / side**2, (here**2).sum(dim=(1, 2))
    # What is left of a constant window's power is rounding.
    flat = (spread <= 1e-6 * power) | (own <= 1e-12 * level)[:, None, None]
    energy = (own[:, None, None] * spread).clamp(min=1e-30)
    found: Tensor = torch.where(flat, 0.0, product / energy.sqrt())
    return found


def ratio_gradients(torch: Any, amplitude: Tensor, alpha: float, floor: float) -> tuple[Tensor, Tensor]:
    """log(right / left) and log(below / above) of (B, H, W) amplitudes; 0 at the ends of the axis."""
    height, width = amplitude.shape[-2:]
    mean = amplitude.mean(dim=(-2, -1), keepdim=True)
    values = amplitude + floor * mean
    across, down = (_weights(torch, n, alpha, values) for n in (width, height))
    tiny = torch.clamp(1e-9 * mean, min=1e-30)
    # One-sided along the gradient, two-sided across it; each side divided by the weights that exist.
    smooth_y, smooth_x = down.sum(dim=0) + torch.eye(height).to(values), across.sum(dim=0) + torch.eye(width).to(values)
    left, right = ((smooth_y @ values) @ (side / side.sum(1, keepdim=True).clamp(min=1e-30)).T for side in across)
    above, below = ((side / side.sum(1, keepdim=True).clamp(min=1e-30)) @ (values @ smooth_x) for side in down)
    inner_x, inner_y = (torch.zeros(n).to(values) for n in (width, height))
    inner_x[1:-1] = inner_y[1:-1] = 1
    gx, gy = torch.log((right + tiny) / (left + tiny)), torch.log((below + tiny) / (above + tiny))
    return gx * inner_x, gy * inner_y[:, None]


def _weights(torch: Any, n: int, alpha: float, like: Tensor) -> Tensor:
    """(2, n, n) exponential weights of the samples before, and of those after, each sample."""
    at = torch.arange(n, device=like.device, dtype=torch.float64)
    away = at[None, :] - at[:, None]
    weights = torch.exp(-away.abs() / alpha)
    sides: Tensor = torch.stack([weights * (away < 0), weights * (away > 0)]).to(like.dtype)
    return sides


def _smoothed(torch: Any, planes: Tensor, sigma: float) -> Tensor:
    """(B, C, H, W) smoothed by a Gaussian that reaches to 2.5 sigma; borders are reflected."""
    down, across = (_gaussian(torch, n, sigma, planes) for n in planes.shape[-2:])
    smooth: Tensor = down @ planes @ across.T
    return smooth


def _gaussian(torch: Any, n: int, sigma: float, like: Tensor) -> Tensor:
    """(n, n) weights of the samples for each sample."""
    reach = max(1, math.ceil(REACH * sigma))
    at = torch.arange(-reach, reach + 1, device=like.device, dtype=torch.float64)
    bell = torch.exp(-0.5 * (at / sigma) ** 2)
    place = torch.from_numpy(reflected(n, reach)).to(like.device)
    weights = torch.zeros((n, n), device=like.device, dtype=torch.float64)
    for k, weight in enumerate(bell / bell.sum()):
        weights[torch.arange(n, device=like.device), place[k : k + n]] += weight
    return weights.to(like.dtype)  # type: ignore[no-any-return]  # torch may be absent when types are checked


def _planes(amplitude: Tensor) -> Tensor:
    if amplitude.ndim != 4 or amplitude.shape[1] != 1:
        raise InputError(f"amplitudes must be (B, 1, H, W), got {tuple(amplitude.shape)}")
    if not amplitude.is_floating_point():
        raise InputError(f"amplitudes must be floating point, got {amplitude.dtype}")
    return amplitude[:, 0]


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ParameterError(f"{name} must be a positive number of pixels, got {value}")
