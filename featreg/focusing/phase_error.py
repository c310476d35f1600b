"""Phases over the pulses: the band that carries signal, constant and linear terms, and how far two phases differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from featreg.focusing.pulse_spectra import FLOOR, LEAST_GAP, PulseSpectra
from featreg.types import FloatArray, IntArray

#: Zero padding of the search for the linear term.
FINER = 16


@dataclass(frozen=True, eq=False)
class Band:
    """The pulses that carry signal, in their order in time, which is not that of the FFT.

    Parameters
    ----------
    order : (M,) int64 rows of the FFT, from one end of the band to the other, across the seam of the FFT
    weight : (M,) float64 mean power of these pulses, the sum is 1
    pulses : N, pulses of the FFT
    """

    order: IntArray
    weight: FloatArray
    pulses: int

    @classmethod
    def of(cls, power: FloatArray) -> Band:
        """The band of an (N,) mean power per pulse: all but the widest empty gap, counted around the circle."""
        used = np.flatnonzero(power > FLOOR * power.max())
        gaps = np.diff(np.r_[used, used[0] + len(power)])
        # Without a gap worth the name the band is full, and begins at the lowest frequency of an FFT.
        start = used[(int(gaps.argmax()) + 1) % len(used)] if gaps.max() > 1 else len(power) // 2 + len(power) % 2
        order = (start + np.arange(len(power))) % len(power)
        order = order[power[order] > FLOOR * power.max()]
        return cls(order.astype(np.int64), power[order] / power[order].sum(), len(power))

    @property
    def place(self) -> FloatArray:
        """(M,) from -1 to 1 along the band."""
        off = np.mod(self.order - self.order[0], self.pulses).astype(np.float64)
        return np.asarray(2 * off / max(off[-1], 1.0) - 1)

    @property
    def gap(self) -> int:
        """Pulses without signal between the end of the band and its first row, around the circle."""
        return self.pulses - 1 - int((self.order[-1] - self.order[0]) % self.pulses)

    def spread(self, values: FloatArray) -> FloatArray:
        """(N,) in the order of the FFT, 0 where no pulse carries signal."""
        whole = np.zeros(self.pulses)
        whole[self.order] = values
        return whole

    def at_a_sample(self, phase: FloatArray, cells: PulseSpectra) -> FloatArray:
        """(N,) the phase, with a linear term that brings the corrected cells' centre of mass in azimuth to a sample.

        Blurred versions of one scene, focused, differ by a shift; after this, by a shift of whole samples.
        """
        turn = np.exp(-1j * phase[self.order]).astype(np.complex64)

        def task(strip: slice) -> np.complex128:
            along = cells.spectra[strip][:, self.order] * turn
            return np.complex128(np.vdot(along[:, :-1], along[:, 1:]))

        centre = -float(np.angle(sum(cells.over(task)))) * cells.image_pulses / (2 * np.pi)
        off = (centre - round(centre)) * 2 * np.pi / cells.image_pulses
        return phase - self.spread(off * np.mod(self.order - self.order[0], self.pulses))

    def without_line(self, phase: FloatArray) -> FloatArray:
        """(M,) radians within +-pi, along the band: the phase less its best constant and linear term.

        The line is the peak of the weighted spectrum of exp(j phase), then least squares on what is left.
        """
        turn = np.exp(1j * phase[self.order])
        sums = np.fft.fft(turn * self.weight, FINER * self.pulses)
        peak = int(np.abs(sums).argmax())
        turn *= np.exp(-2j * np.pi * peak / (FINER * self.pulses) * np.arange(len(turn)))
        left = np.angle(turn * np.exp(-1j * np.angle(np.sum(turn * self.weight))))
        basis = np.column_stack([np.ones(len(left)), self.place]) * np.sqrt(self.weight)[:, None]
        fitted = np.linalg.lstsq(basis, left * np.sqrt(self.weight), rcond=None)[0]
        return np.asarray(left - fitted[0] - fitted[1] * self.place)

    def difference(self, first: FloatArray, second: FloatArray) -> float:
        """Weighted RMS difference of two (N,) phases in radians, constant and linear terms apart."""
        return float(np.sqrt(np.sum(self.weight * self.without_line(first - second) ** 2)))

    def detrended(self, phase: FloatArray) -> FloatArray:
        """(N,) the phase less its constant and the linear term that moves the image's centre of mass in azimuth.

        The slope is the weighted circular mean of the increments from pulse to pulse, so no unwrapping is needed: a
        fit to the unwrapped phase goes wrong where increments exceed pi.
        """
        along = phase[self.order]
        turn = np.exp(1j * np.diff(along)) * np.sqrt(self.weight[1:] * self.weight[:-1])
        steps = np.diff(np.mod(self.order - self.order[0], self.pulses))
        slope = float(np.angle(np.sum(turn[steps == 1]))) if (steps == 1).any() else 0.0
        level = along - slope * np.mod(self.order - self.order[0], self.pulses)
        mean = float(np.angle(np.sum(self.weight * np.exp(1j * level))))
        return self.spread(np.angle(np.exp(1j * (level - mean))))


def at_quick_length(cells: PulseSpectra) -> PulseSpectra:
    """The cells, with empty pulses put in where the band leaves a gap for them, so that transforms are quick."""
    band = Band.of(cells.power())
    return cells.lengthened(int(band.order[0])) if band.gap >= LEAST_GAP * band.pulses else cells
