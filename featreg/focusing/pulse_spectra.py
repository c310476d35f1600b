"""Range cells as spectra over the pulses: what every autofocus method works on, and one step of the image criteria."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import available_processors, stated_threads
from featreg.types import FloatArray, IntArray

C64 = NDArray[np.complex64]
C128 = NDArray[np.complex128]

#: Samples of the range cells that are transformed at a time: small enough to stay in the cache.
STRIP = 1 << 16
#: Range cells of one group: neighbours share scatterers through the range response, so a group is never divided.
RUN = 8
#: Neighbouring groups are at least so many cells apart, unless a run of more than RUN cells had to be cut.
GAP = 2
#: Least share of the pulses that a gap must have for empty ones to be put in: a null within the band is none.
LEAST_GAP = 0.02
#: Power below which a pulse carries no signal, relative to the strongest.
FLOOR = 1e-4


@dataclass(frozen=True, eq=False)
class PulseSpectra:
    """Spectra over the pulses of K range cells.

    Parameters
    ----------
    spectra : (K, N) complex64, unitary FFT along azimuth; the energies of the rows sum to K
    index : (K,) int64, which range cells of the image they are, ascending
    energy : (K,) float64 energy of each row: all 1, unless the cells keep their proportions
    share : (K,) float64 energy of each cell in the image, as a share of all K
    groups : (start, stop) rows of neighbouring cells, which see the same scatterers, one after the other
    workers : threads; the result does not depend on them
    seam, added : the first of the empty pulses that were put in so that transforms are quick, and how many
    """

    spectra: C64
    index: IntArray
    energy: FloatArray
    share: FloatArray
    groups: tuple[tuple[int, int], ...]
    workers: int = 1
    seam: int = 0
    added: int = 0

    @property
    def pulses(self) -> int:
        return int(self.spectra.shape[1])

    @property
    def image_pulses(self) -> int:
        """Pulses of the image, without those that were put in."""
        return self.pulses - self.added

    @property
    def cells(self) -> int:
        return len(self.spectra)

    def power(self) -> FloatArray:
        """(N,) float64 mean power of every pulse."""

        def task(strip: slice) -> FloatArray:
            part = self.spectra[strip]
            return np.asarray(np.sum(part.real**2 + part.imag**2, axis=0, dtype=np.float64))

        return np.asarray(np.sum(self.over(task), axis=0) / self.cells)

    def lengthened(self, seam: int) -> PulseSpectra:
        """The same cells with empty pulses put in before row `seam`, to a length whose transforms are quick.

        A transform of 503 samples takes four times as long as one of 504. Where pulses without signal lie at the seam,
        a few more of them sample the same cells a little finer; within the band they would tear the cells apart.
        """
        from scipy.fft import next_fast_len

        added = int(next_fast_len(self.pulses)) - self.pulses
        if added == 0:
            return self
        spectra = np.zeros((self.cells, self.pulses + added), np.complex64)
        spectra[:, :seam] = self.spectra[:, :seam]
        spectra[:, seam + added :] = self.spectra[:, seam:]
        return replace(self, spectra=spectra, seam=seam, added=added)

    def in_image(self, values: FloatArray) -> FloatArray:
        """(image_pulses,) of values of every pulse: without those of pulses that were put in."""
        return np.delete(values, np.s_[self.seam : self.seam + self.added])

    def thinned(self, samples: int) -> PulseSpectra:
        """About so many samples, in whole groups spread over the range; at least two groups where there are two."""
        share = samples / (self.cells * self.pulses)
        count = max(2, round(share * len(self.groups)))
        if count >= len(self.groups):
            return self
        chosen = np.unique(np.linspace(0, len(self.groups) - 1, count).round().astype(int))
        return self._of([self.groups[i] for i in chosen])

    def halves(self) -> tuple[PulseSpectra, PulseSpectra]:
        """Every second group, and the others: two images of the same pulses without common scatterers."""
        return self._of(self.groups[::2]), self._of(self.groups[1::2])

    def _of(self, groups: Sequence[tuple[int, int]]) -> PulseSpectra:
        """A copy of some groups, side by side."""
        rows = np.concatenate([np.arange(*group) for group in groups])
        edges = np.cumsum([0, *(stop - start for start, stop in groups)]).tolist()
        share = self.share[rows]
        return replace(
            self,
            spectra=self.spectra[rows],
            index=self.index[rows],
            share=share / share.sum(),
            energy=self.energy[rows],
            groups=tuple(pairwise(edges)),
        )

    def over(self, task: Callable[[slice], Any]) -> list[Any]:
        """Results of a task over all strips, in order."""
        most = max(1, STRIP // self.pulses)
        # Starting threads costs more than it saves where there is little to do.
        workers = self.workers if self.spectra.size > 4 * STRIP else 1
        return run(lambda top: task(slice(top, top + most)), range(0, self.cells, most), workers)

    def step(self, phase: FloatArray, *, contrast: bool, offset: float = 0.0, clamped: bool = True) -> Step:
        """One step of an image criterion; see `Step`.

        Parameters
        ----------
        phase : (N,) radians, the correction at which the cells are looked at
        contrast : weights p, else max(ln p + offset, 0), p the power over the mean power
        clamped : whether weights below 0 are set to 0; without, the correlation is the gradient of the entropy
        """
        from scipy.fft import fft, ifft

        from featreg.focusing.sharpness_kernels import correlate, weigh

        turn = np.exp(-1j * phase).astype(np.complex64)
        least = np.float32(0 if clamped else -np.inf)

        def task(strip: slice) -> tuple[C128, FloatArray]:
            here = self.spectra[strip]
            image = np.ascontiguousarray(ifft(here * turn, axis=1, norm="ortho", overwrite_x=True))
            sums = np.empty(len(here))
            weigh(image.view(np.float32), np.float32(self.pulses), contrast, np.float32(offset), least, sums)
            total = np.zeros(self.pulses, np.complex128)
            correlate(here, fft(image, axis=1, norm="ortho", overwrite_x=True), total)
            return total, sums

        parts = self.over(task)
        correlation = np.sum([total for total, _ in parts], axis=0)
        return Step(correlation, *self._criteria(np.concatenate([sums for _, sums in parts])))

    def criteria(self, phase: FloatArray) -> tuple[float, float]:
        """Objective and entropy after the correction by a phase; see `Step`."""
        from scipy.fft import ifft

        from featreg.focusing.sharpness_kernels import entropy_sums

        turn = np.exp(-1j * phase).astype(np.complex64)

        def task(strip: slice) -> FloatArray:
            image = np.ascontiguousarray(ifft(self.spectra[strip] * turn, axis=1, norm="ortho", overwrite_x=True))
            sums = np.empty(len(image))
            entropy_sums(image.view(np.float32), np.float32(self.pulses), sums)
            return sums

        return self._criteria(np.concatenate(self.over(task)))

    def _criteria(self, sums: FloatArray) -> tuple[float, float]:
        objective = -float(sums.sum()) / (self.cells * self.pulses)
        # Finer samples would raise the entropy: it is that of as many as the image has.
        within = np.log(self.image_pulses * self.energy) - sums / (self.pulses * self.energy)
        return objective, float(np.sum(self.share * (within - np.log(self.share))))


@dataclass(frozen=True, eq=False)
class Step:
    """What one look at the cells yields.

    Parameters
    ----------
    correlation : (N,) complex128, sum over the cells of S conj(FFT(w g)); its angle is the next phase
    objective : the criterion that is minimised, -mean(p ln p), p the power over the mean power
    entropy : nats, of the cells with their energies in the image (Eq. 1 over these cells)
    """

    correlation: C128
    objective: float
    entropy: float


def grouped(cells: Sequence[int] | IntArray) -> tuple[tuple[int, int], ...]:
    """(start, stop) rows of groups of neighbouring cells; `cells` ascend."""
    groups: list[tuple[int, int]] = []
    start = 0
    values = list(map(int, cells))
    for i in range(1, len(values) + 1):
        if i == len(values) or values[i] - values[i - 1] > GAP:
            pieces = max(1, round((i - start) / RUN))
            edges = np.linspace(start, i, pieces + 1).round().astype(int).tolist()
            groups += list(pairwise(edges))
            start = i
    return tuple(groups)


def pulse_spectra(
    image: NDArray[Any], azimuth_axis: int, cells: IntArray, *, normalize: bool = True, workers: int = 1
) -> PulseSpectra:
    """Return the spectra of some range cells of an image, which is read but never copied whole.

    Parameters
    ----------
    image : (H, W) complex, finite
    azimuth_axis : 0 where the cells are columns, 1 where they are rows
    cells : (K,) ascending indices of range cells with energy
    normalize : bring every cell to the same energy; otherwise the strongest decide
    """
    from scipy.fft import fft

    lines = image.T if azimuth_axis == 0 else image
    spectra = np.empty((len(cells), lines.shape[1]), np.complex64)
    energy = np.empty(len(cells))
    most = max(1, STRIP // lines.shape[1])

    def task(top: int) -> None:
        rows = slice(top, top + most)
        part = np.ascontiguousarray(lines[cells[rows]])
        energy[rows] = energies(part)
        if normalize:
            part = part / np.sqrt(energy[rows])[:, None]
        spectra[rows] = fft(part, axis=1, norm="ortho")

    run(task, range(0, len(cells), most), workers)
    if not normalize:
        spectra *= np.float32(1 / np.sqrt(energy.mean()))
    kept = np.ones(len(cells)) if normalize else energy / energy.mean()
    return PulseSpectra(spectra, cells, kept, energy / energy.sum(), grouped(cells), workers)


def energies(lines: NDArray[Any]) -> FloatArray:
    """(K,) float64 sums of the squared moduli along the second axis."""
    return np.asarray(np.sum(lines.real.astype(np.float64) ** 2 + lines.imag.astype(np.float64) ** 2, axis=1))


def run(task: Callable[[int], Any], items: Iterable[int], workers: int) -> list[Any]:
    """Results of a task over items, in order, by so many threads."""
    if workers == 1:
        return [task(item) for item in items]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(task, items))


def default_workers() -> int:
    """Threads that a call may take: the cores of this process, less where OpenCV or OMP_NUM_THREADS has a limit."""
    import cv2

    cores = available_processors()
    return max(1, min(cores, cv2.getNumThreads(), stated_threads() or cores))
