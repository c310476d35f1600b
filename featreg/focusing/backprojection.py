"""Back-projection: the complex image on a ground grid from a phase history, exact in geometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.focusing.ground_grid import GroundGrid
from featreg.runtime.parameters import Count, checked
from featreg.runtime.threads import worker_count
from featreg.types import FloatArray, Image, read_only

if TYPE_CHECKING:
    from featreg.focusing.phase_history import PhaseHistory

#: m/s.
SPEED_OF_LIGHT = 299_792_458.0
#: Pulses whose range profiles stand in memory at a time.
PULSES = 128
#: Rows of one strip: its part of the image stays in the cache while the pulses pass.
ROWS = 24
#: Zero samples at both ends of a profile, which everything beyond the unambiguous range falls on.
GUARD = 2
#: Pedestal of the raised cosine by name; "none" weights all samples the same.
WINDOWS = {"hamming": 0.54, "hann": 0.5, "none": 1.0}
Window = Literal["hamming", "hann", "none"]

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]


@checked("back_project")
def back_project(
    history: PhaseHistory,
    grid: GroundGrid | None = None,
    *,
    range_window: Window = "hamming",
    azimuth_window: Window = "hamming",
    upsampling: Count = 16,
    backend: Literal["numba", "torch"] = "numba",
    device: str | None = None,
    workers: Count = 1,
) -> Image:
    """Form the complex image of a phase history on the ground.

    Parameters
    ----------
    history : samples and antenna positions; apply `PhaseHistory.corrected` before where its correction is wanted
    grid : default 501 x 501 pixels of 0.2 m about the scene centre
    range_window, azimuth_window : "hamming", "hann" or "none", over the frequencies and over the azimuth of the pulses
    upsampling : range profiles are this many times finer than the samples, rounded up to a fast length
    backend : "numba", or "torch" (extra ``featreg[torch]``), which agree to the rounding of float32
    device : of torch, such as "cuda"; default the processor
    workers : threads; the result does not depend on them

    Returns
    -------
    Image
        complex64 (H, W). A scatterer of amplitude a has the peak a, in the phase that it has in the samples.

    Raises
    ------
    ParameterError
        An unknown window or backend, a device that torch cannot use, an upsampling or number of workers below 1.
    PluginUnavailableError
        torch is asked for and not installed.

    Notes
    -----
    For every pulse the profile ``s(d) = sum_f S(f) exp(4j pi (f - f_m) d / c)``, f_m the middle frequency, is sampled
    by a zero-padded FFT, interpolated linearly at d = |p - r| - r0, and multiplied by ``exp(4j pi f_m d / c)``. With
    the middle frequency taken out, the profile turns by at most half a cycle per `upsampling` samples, so that the
    error of interpolation is below (pi / upsampling) ** 2 / 8, -46 dB at 16, at the edge of the band. Beyond the
    unambiguous range of c / (2 spacing) about the centre, samples count as 0: there the echoes would be aliases.

    References
    ----------
    L. A. Gorham, L. J. Moore, SAR image formation toolbox for MATLAB, Proc. SPIE 7699, 2010, doi:10.1117/12.855375
    """
    workers = worker_count(workers)
    if device is not None and backend != "torch":
        raise ParameterError(f"device '{device}' needs backend='torch'")
    plan = _Plan.of(history, grid or GroundGrid(), range_window, azimuth_window, upsampling)
    pixels = _by_torch(plan, device or "cpu") if backend == "torch" else _by_numba(plan, workers)
    if not np.isfinite(pixels.sum()):
        raise InputError(f"{history.name}: the image is not finite; the samples overflow float32")
    return Image(read_only(pixels), np.ones(pixels.shape, np.bool_), None, history.name, "complex64", "complex")


def carrier(history: PhaseHistory, grid: GroundGrid | None = None) -> C64:
    """The factor that takes the carrier of the central pulse out of a back-projected image.

    Multiply the image by it before autofocus in the image domain: without it, neighbouring pixels differ by the
    carrier's phase and the columns' FFT is no axis of pulses. On a grid turned to the central azimuth
    (``turn_deg``), the transform along the columns is then the one over the pulses.

    Returns
    -------
    (H, W) complex64
        ``exp(-4j pi f (|p - r| - r0) / c)``, f the middle frequency, p and r0 of the central pulse.
    """
    grid = grid or GroundGrid()
    p, frequency = history.central_pulse, history.reference_frequency
    ground = grid.row_starts[:, None] + np.arange(grid.shape[1])[:, None] * grid.step
    off = ground - history.positions[p, :2]
    distance = np.sqrt((off**2).sum(axis=-1) + (grid.height - history.positions[p, 2]) ** 2) - history.r0[p]
    cycles = distance * (2 * frequency / SPEED_OF_LIGHT)
    return np.asarray(np.exp(-2j * np.pi * (cycles - np.rint(cycles))), np.complex64)


@dataclass(frozen=True, eq=False)
class _Plan:
    """What both backends need: geometry, weights, and the length of the profiles."""

    history: PhaseHistory
    grid: GroundGrid
    range_weights: F32
    pulse_weights: F32
    length: int

    @classmethod
    def of(
        cls, history: PhaseHistory, grid: GroundGrid, range_window: str, azimuth_window: str, upsampling: int
    ) -> _Plan:
        from scipy.fft import next_fast_len

        count = len(history.frequencies)
        across = raised_cosine(np.arange(count) / (count - 1), range_window)
        azimuth = history.relative_azimuth_deg
        half = float(np.abs(azimuth).max())
        along = raised_cosine((azimuth / half + 1) / 2 if half > 0 else np.full(len(azimuth), 0.5), azimuth_window)
        return cls(
            history,
            grid,
            (across / across.sum()).astype(np.float32),
            (along / along.sum()).astype(np.float32),
            int(next_fast_len(count * upsampling)),
        )

    @property
    def per_metre(self) -> float:
        """Profile samples per metre of range."""
        return 2 * self.history.spacing * self.length / SPEED_OF_LIGHT

    @property
    def waves(self) -> float:
        """Carrier cycles per metre of range."""
        return 2 * self.history.reference_frequency / SPEED_OF_LIGHT

    @property
    def middle(self) -> float:
        """Profile sample of range r0."""
        return float(self.length // 2 + GUARD)

    def padded(self, rows: slice) -> C64:
        """(P, length) samples with weights, in the order of an FFT whose zero is the middle frequency."""
        weights = self.pulse_weights[rows, None] * self.range_weights
        samples = self.history.samples[rows] * weights
        middle = samples.shape[1] // 2
        spectrum = np.zeros((len(samples), self.length), np.complex64)
        spectrum[:, : samples.shape[1] - middle] = samples[:, middle:]
        spectrum[:, self.length - middle :] = samples[:, :middle]
        return spectrum

    def chunks(self) -> list[slice]:
        return [slice(i, min(i + PULSES, len(self.history))) for i in range(0, len(self.history), PULSES)]


def raised_cosine(place: FloatArray, window: str) -> FloatArray:
    """The weights of a window of that name at places from 0 to 1."""
    pedestal = WINDOWS[window]
    return np.asarray(pedestal - (1 - pedestal) * np.cos(2 * np.pi * place))


def _profiles(plan: _Plan, rows: slice, workers: int) -> tuple[F32, F32]:
    """Real and imaginary part of the (P, length + 1 + 2 GUARD) range profiles, range growing, ends closed by zeros."""
    from scipy.fft import ifft

    # "forward" puts the division by the length on the other direction.
    turned = ifft(plan.padded(rows), axis=1, norm="forward", workers=workers)
    half = plan.length // 2
    real, imag = (np.zeros((len(turned), plan.length + 1 + 2 * GUARD), np.float32) for _ in range(2))
    for part, values in ((real, turned.real), (imag, turned.imag)):
        part[:, GUARD : GUARD + half] = values[:, plan.length - half :]
        part[:, GUARD + half : GUARD + plan.length] = values[:, : plan.length - half]
        part[:, GUARD + plan.length] = part[:, GUARD]
    return real, imag


def _by_numba(plan: _Plan, workers: int) -> C64:
    from featreg.focusing.backprojection_kernels import back_project_rows

    height, width = plan.grid.shape
    real, imag = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    starts, step = plan.grid.row_starts, plan.grid.step
    strips = [slice(top, min(top + ROWS, height)) for top in range(0, height, ROWS)]
    # One strip is one task: a pixel's pulses are summed in the same order by any number of threads.
    with ThreadPoolExecutor(workers) as pool:
        for rows in plan.chunks():
            profile_real, profile_imag = _profiles(plan, rows, workers)

            def add(
                strip: slice, rows: slice = rows, profile_real: F32 = profile_real, profile_imag: F32 = profile_imag
            ) -> None:
                back_project_rows(
                    profile_real,
                    profile_imag,
                    plan.history.positions[rows],
                    plan.history.r0[rows],
                    starts[strip],
                    step,
                    plan.grid.height,
                    plan.per_metre,
                    plan.middle,
                    plan.waves,
                    real[strip],
                    imag[strip],
                )

            run: Callable[..., Any] = pool.map if workers > 1 else map
            list(run(add, strips))
    return np.asarray(real + np.complex64(1j) * imag, np.complex64)


def _by_torch(plan: _Plan, device: str) -> C64:
    """The same sums, one pulse at a time over the whole image."""
    try:
        torch = import_module("torch")
    except ImportError as error:
        raise PluginUnavailableError(
            f"backend='torch' needs PyTorch ({error}); install it with: pip install 'featreg[torch]'"
        ) from error

    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:  # a build without CUDA asserts
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise ParameterError(f"device '{device}' cannot be used here ({why}); 'cpu' always can") from error

    def put(values: NDArray[Any]) -> Any:
        return torch.from_numpy(np.array(values)).to(device)

    height, width = plan.grid.shape
    starts, steps = put(plan.grid.row_starts), put(np.arange(width)[:, None] * plan.grid.step)
    x, y = starts[:, :1] + steps[:, 0], starts[:, 1:] + steps[:, 1]
    last = plan.length + 2 * GUARD - 1e-3
    image = torch.zeros((height, width), dtype=torch.complex64, device=device)
    for rows in plan.chunks():
        turned = torch.fft.fftshift(torch.fft.ifft(put(plan.padded(rows)), dim=1, norm="forward"), dim=1)
        profiles = torch.zeros((len(turned), plan.length + 1 + 2 * GUARD), dtype=torch.complex64, device=device)
        profiles[:, GUARD : GUARD + plan.length] = turned
        profiles[:, GUARD + plan.length] = turned[:, 0]
        antennas, r0 = plan.history.positions[rows], plan.history.r0[rows]
        for profile, (ax, ay, az), near in zip(profiles, antennas.tolist(), r0.tolist(), strict=True):
            ranges = torch.sqrt((x - ax) ** 2 + (y - ay) ** 2 + (plan.grid.height - az) ** 2) - near
            index = torch.clamp(ranges * plan.per_metre + plan.middle, 0.0, last)
            left = index.to(torch.int64)
            fraction = (index - left).to(torch.float32)
            cycles = ranges * plan.waves
            phase = ((cycles - torch.round(cycles)) * (2 * math.pi)).to(torch.float32)
            value = profile[left] + fraction * (profile[left + 1] - profile[left])
            image += value * torch.polar(torch.ones_like(phase), phase)
    return np.asarray(image.cpu().numpy(), np.complex64)
