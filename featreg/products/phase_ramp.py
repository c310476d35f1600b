"""The smooth phase ramp of a complex image, as TOPS and squinted acquisitions have it, estimated from the samples.

A ramp moves the local spectrum away from 0, in TOPS by several times the sampling rate over a burst, and an
interpolator then meets frequencies it cannot carry. It is removed before interpolation and put back, at the new
positions, after.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError
from featreg.types import BoolArray, FloatArray, read_only

Read = Callable[[int, int, int, int], tuple[NDArray[Any], BoolArray]]

#: Side of the cells in which the local frequency is measured, px; a ramp may turn by less than half a turn in one.
CELL = 16
#: Exponents (of u, of v) of the terms of the phase; a constant does not matter.
TERMS = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
#: A cell's samples agree on a frequency from this concentration on; independent samples of a full cell give 0.06.
AGREED = 0.15
#: Cells along each axis whose frequencies are averaged before they are held against the ramp.
AVERAGED = 4
#: Least concentration of these averages around the ramp that counts as explained; a jump of 2 radians leaves 0.84.
EXPLAINED = 0.9


@dataclass(frozen=True, eq=False)
class PhaseRamp:
    """A polynomial phase of degree 3.

    Parameters
    ----------
    coefficients : (9,) float64 radians per term u, v, u^2, uv, v^2, u^3, u^2 v, u v^2, v^3
    centre, scale : px; u = (x - centre[0]) / scale, v = (y - centre[1]) / scale
    concentration : (along x, along y) how well the local frequencies agree with it, 0 to 1; NaN where an axis has a
        white spectrum, which shows no ramp
    before : the same for no ramp at all
    """

    coefficients: FloatArray
    centre: tuple[float, float]
    scale: float
    concentration: tuple[float, float]
    before: tuple[float, float]

    def phase(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Return the phase in radians at points x, y (broadcast against each other)."""
        u = (np.asarray(x, np.float64) - self.centre[0]) / self.scale
        v = (np.asarray(y, np.float64) - self.centre[1]) / self.scale
        a = self.coefficients
        along_v = v * (a[1] + v * (a[4] + v * a[8]))
        return np.asarray(along_v + u * (a[0] + v * (a[3] + v * a[7]) + u * (a[2] + v * a[6] + u * a[5])))

    def factor(self, x: ArrayLike, y: ArrayLike, sign: int) -> NDArray[np.complex64]:
        """Return exp(j sign phase): sign -1 removes the ramp, +1 puts it back."""
        return phasor(self.phase(x, y), sign)


def phasor(phase: FloatArray, sign: int) -> NDArray[np.complex64]:
    """Return exp(j sign phase) of radians."""
    # Reduced in float64 first: a float32 phase of thousands of radians is worth nothing.
    turns = (phase * (sign / (2 * np.pi))).astype(np.float64)
    angle = (2 * np.pi * (turns - np.rint(turns))).astype(np.float32)
    out = np.empty(angle.shape, np.complex64)
    out.real, out.imag = np.cos(angle), np.sin(angle)
    return out


def estimate_phase_ramp(read: Read, shape: tuple[int, int], *, strip: int = 1024) -> PhaseRamp:
    """Estimate the phase ramp of a complex image.

    Parameters
    ----------
    read : read(x, y, width, height) -> complex samples (h, w), 0 where they are not data, and their mask
    shape : (H, W)
    strip : rows and columns that are read at once

    Returns
    -------
    PhaseRamp

    Raises
    ------
    InputError
        The image is too small, or its local frequencies follow no single smooth ramp (several bursts in one image).

    Notes
    -----
    The phase of the correlation of neighbouring samples is the local frequency (pulse-pair Doppler estimation). Its
    mean over 16 x 16 px forms a field of unit phasors that turns linearly under a quadratic phase: the peak of its 2-D
    spectrum gives the ramp without unwrapping, wrapped least squares the rest, both axes together. The frequency at the
    image centre is taken between -1/2 and 1/2 cycle per sample: the samples cannot tell it from its aliases.

    References
    ----------
    S. N. Madsen, Estimating the Doppler centroid of SAR data, IEEE Trans. AES, 1989, doi:10.1109/7.18675
    """
    height, width = shape
    if min(shape) < 4 * CELL:
        raise InputError(f"a phase ramp needs at least {4 * CELL} x {4 * CELL} samples, got {width} x {height}")
    across, along, weight_x, weight_y = _cells(read, shape, strip)
    rows, cols = across.shape
    centre, scale = ((width - 1) / 2, (height - 1) / 2), float(max(shape)) / 2
    u = ((np.arange(cols) + 0.5) * CELL - 0.5 - centre[0]) / scale
    v = ((np.arange(rows) + 0.5) * CELL - 0.5 - centre[1]) / scale
    u, v = np.tile(u, rows), np.repeat(v, cols)
    parts: list[tuple[NDArray[Any], FloatArray, FloatArray, FloatArray] | None] = []
    for field, weight, derivative in ((across, weight_x, 0), (along, weight_y, 1)):
        agreement = float(weight.sum() / max(np.count_nonzero(weight), 1))
        if agreement >= AGREED:
            parts.append((field.ravel(), weight.ravel(), _gradient(u, v, derivative) / scale, _tone(field, weight)))
        else:
            parts.append(None)
    known = [part for part in parts if part is not None]
    coefficients = _fitted(known) if known else np.zeros(len(TERMS))
    after = [np.nan if p is None else _concentration(p[0], p[1], p[2] @ coefficients, (rows, cols)) for p in parts]
    before = [np.nan if p is None else _concentration(p[0], p[1], 0.0, (rows, cols)) for p in parts]
    for axis, value in zip(("along x", "along y"), after, strict=True):
        if value < EXPLAINED:
            raise InputError(
                f"no single phase ramp explains the local frequencies {axis} (agreement {value:.2f}, {EXPLAINED} is "
                "needed); give one burst of one look direction"
            )
    # Centre frequencies into (-pi, pi] per sample: the aliases look the same.
    for index in (0, 1):
        turn = 2 * np.pi * scale
        coefficients[index] -= turn * np.rint(coefficients[index] / turn)
    return PhaseRamp(read_only(coefficients), centre, scale, (after[0], after[1]), (before[0], before[1]))


def _cells(read: Read, shape: tuple[int, int], strip: int) -> tuple[NDArray[Any], NDArray[Any], FloatArray, FloatArray]:
    """Unit phasors of the correlation of neighbours along x and along y in each cell, and their concentrations."""
    rows, cols = shape[0] // CELL, shape[1] // CELL
    sums = np.zeros((2, rows, cols), np.complex128)
    sizes = np.zeros((2, rows, cols))
    step = max(CELL, strip // CELL * CELL)
    for top in range(0, rows * CELL, step):
        for left in range(0, cols * CELL, step):
            h, w = min(step, rows * CELL - top), min(step, cols * CELL - left)
            more_h, more_w = min(h + 1, shape[0] - top), min(w + 1, shape[1] - left)
            samples = np.zeros((h + 1, w + 1), np.complex64)
            samples[:more_h, :more_w] = read(left, top, more_w, more_h)[0]
            here, r, c = samples[:h, :w], top // CELL, left // CELL
            for k, other in enumerate((samples[:h, 1:], samples[1:, :w])):
                product = other * here.conj()
                cell = product.reshape(h // CELL, CELL, w // CELL, CELL)
                sums[k, r : r + h // CELL, c : c + w // CELL] = cell.sum(axis=(1, 3), dtype=np.complex128)
                sizes[k, r : r + h // CELL, c : c + w // CELL] = np.abs(cell).sum(axis=(1, 3), dtype=np.float64)
    weights = np.divide(np.abs(sums), sizes, out=np.zeros_like(sizes), where=sizes > 0)
    fields = np.divide(sums, np.abs(sums), out=np.zeros_like(sums), where=np.abs(sums) > 0)
    return fields[0], fields[1], weights[0], weights[1]


def _tone(field: NDArray[Any], weight: FloatArray) -> FloatArray:
    """Unwrapped phase (R * C,) of the plane wave that a field of phasors is nearest to."""
    rows, cols = field.shape
    size = tuple(1 << (2 * n - 1).bit_length() for n in field.shape)
    spectrum = np.fft.fft2(field * weight, s=size)
    ky, kx = np.unravel_index(int(np.abs(spectrum).argmax()), size)
    turns_y, turns_x = (k / n - (k / n > 0.5) for k, n in zip((ky, kx), size, strict=True))
    # The constant is unwrapped where it matters: at the middle cell.
    mid_y, mid_x = (rows - 1) / 2, (cols - 1) / 2
    middle = np.angle(spectrum[ky, kx] * np.exp(2j * np.pi * (turns_y * mid_y + turns_x * mid_x)))
    y, x = np.mgrid[:rows, :cols]
    return np.asarray(middle + 2 * np.pi * (turns_y * (y - mid_y) + turns_x * (x - mid_x))).ravel()


def _gradient(u: NDArray[Any], v: NDArray[Any], axis: int) -> FloatArray:
    """(N, 9) derivative of the terms by u (axis 0) or by v (axis 1)."""
    columns = []
    for p, q in TERMS:
        n = (p, q)[axis]
        columns.append(n * u ** max(p - (axis == 0), 0) * v ** max(q - (axis == 1), 0) if n else np.zeros_like(u))
    return np.column_stack(columns)


def _fitted(parts: list[Any]) -> FloatArray:
    """Wrapped least squares from the plane waves on; cells far off (layover, moving targets) lose their weight."""
    design = np.concatenate([p[2] for p in parts])
    weight = np.concatenate([p[1] for p in parts])
    coefficients = _solved(design, np.concatenate([p[3] for p in parts]), weight)
    for reach in (2.0, 2.0, 1.5, 1.5, 1.0, 1.0, 1.0):
        left = np.concatenate([np.angle(p[0] * np.exp(-1j * (p[2] @ coefficients))) for p in parts])
        coefficients = coefficients + _solved(design, left, weight * (np.abs(left) < reach))
    return coefficients


def _solved(design: FloatArray, values: FloatArray, weight: FloatArray) -> FloatArray:
    root = np.sqrt(weight)[:, None]
    return np.asarray(np.linalg.lstsq(root * design, root[:, 0] * values, rcond=1e-9)[0])


def _concentration(field: NDArray[Any], weight: FloatArray, phase: FloatArray | float, cells: tuple[int, int]) -> float:
    """Length of the mean phasor of the averaged cells, 1 where all agree with the phase."""
    left = (field * weight * np.exp(-1j * np.asarray(phase))).reshape(cells)
    rows, cols = (max(1, n // AVERAGED) for n in cells)
    cut = left[: rows * (cells[0] // rows), : cols * (cells[1] // cols)]
    means = cut.reshape(rows, cells[0] // rows, cols, cells[1] // cols).sum(axis=(1, 3))
    size = np.abs(means)
    return float(np.abs(means.sum()) / size.sum()) if size.sum() > 0 else 0.0
