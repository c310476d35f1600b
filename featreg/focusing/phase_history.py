"""Phase history of a synthetic aperture: what a radar measured, pulse by pulse, before any image is formed.

Signal model: a scatterer of complex amplitude a at r adds ``a * exp(-4j pi f (|p - r| - r0) / c)`` to the sample of
frequency f taken from antenna position p; lengths in metres in a right-handed frame about the scene centre, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.types import FloatArray, column, kept, read_only

#: How far frequencies may be from evenly spaced, as a share of their spacing; float32 files round by 0.0004.
UNEVEN = 0.01


@dataclass(frozen=True, eq=False)
class PhaseHistory:
    """Samples of P pulses at F frequencies, and where the antenna was.

    Parameters
    ----------
    samples : (P, F) complex64, motion-compensated to the scene centre (see the signal model above)
    frequencies : (F,) float64 Hz, ascending and evenly spaced
    positions : (P, 3) float64 m, antenna position; the scene centre is the origin
    r0 : (P,) float64 m, range to the scene centre for which the samples are compensated
    azimuth_deg : (P,) float64, of the antenna, counter-clockwise from +x, kept in [0, 360)
    autofocus_range, autofocus_phase : (P,) float64 m and radians, a known correction that is not applied yet (see
        `corrected`), or None
    polarisation : "HH", "HV", "VH", "VV", or "" where unknown
    name : where it came from

    Raises
    ------
    InputError
        Wrong shapes, values that are not finite, frequencies that are not ascending and evenly spaced.
    """

    samples: NDArray[np.complex64]
    frequencies: FloatArray
    positions: FloatArray
    r0: FloatArray
    azimuth_deg: FloatArray
    autofocus_range: FloatArray | None = None
    autofocus_phase: FloatArray | None = None
    polarisation: str = ""
    name: str = "phase history"

    def __post_init__(self) -> None:
        put = object.__setattr__
        samples = np.ascontiguousarray(self.samples)
        if samples.ndim != 2 or samples.dtype.kind != "c" or 0 in samples.shape:
            raise InputError(
                f"{self.name}: samples must be complex (pulses, frequencies), got {samples.dtype} {samples.shape}"
            )
        samples = samples.astype(np.complex64, copy=False)
        if not np.isfinite(samples.sum(dtype=np.complex128)):
            raise InputError(f"{self.name}: samples must be finite, got NaN or infinite ones")
        own = not np.may_share_memory(samples, self.samples)
        put(self, "samples", read_only(samples) if own else kept(samples))
        pulses, count = samples.shape
        put(self, "frequencies", self._column("frequencies", count))
        if count < 2 or self.frequencies[0] <= 0 or not self._even():
            raise InputError(f"{self.name}: frequencies must be at least 2 positive, ascending and evenly spaced Hz")
        positions = np.array(self.positions, np.float64)
        if positions.shape != (pulses, 3) or not np.isfinite(positions).all():
            raise InputError(f"{self.name}: positions must be finite ({pulses}, 3) m, got shape {positions.shape}")
        put(self, "positions", read_only(positions))
        for key in ("r0", "azimuth_deg", "autofocus_range", "autofocus_phase"):
            if getattr(self, key) is not None:
                put(self, key, self._column(key, pulses))
        azimuth = np.mod(self.azimuth_deg, 360.0)
        azimuth[azimuth == 360.0] = 0.0  # what the remainder of a tiny negative angle is rounded to
        put(self, "azimuth_deg", read_only(azimuth))

    def _column(self, key: str, rows: int) -> FloatArray:
        try:
            values = column(getattr(self, key), rows, f"{self.name}: {key}")
        except TypeError as error:
            raise InputError(f"{self.name}: {key} must be {rows} real numbers") from error
        if not np.isfinite(values).all():
            raise InputError(f"{self.name}: {key} must be finite, got NaN or infinite values")
        return values

    def _even(self) -> bool:
        return bool((np.abs(np.diff(self.frequencies) - self.spacing) < UNEVEN * self.spacing).all())

    def __len__(self) -> int:
        """Number of pulses."""
        return len(self.samples)

    @property
    def spacing(self) -> float:
        """Mean spacing of the frequencies, Hz."""
        return float((self.frequencies[-1] - self.frequencies[0]) / (len(self.frequencies) - 1))

    @property
    def reference_frequency(self) -> float:
        """The middle frequency of the evenly spaced band, Hz: sample F // 2."""
        return float(self.frequencies[0] + self.spacing * (len(self.frequencies) // 2))

    @property
    def relative_azimuth_deg(self) -> FloatArray:
        """(P,) degrees from the middle of the aperture, in (-180, 180]; no jump where the circle closes."""
        mean = np.rad2deg(np.angle(np.exp(1j * np.deg2rad(self.azimuth_deg)).sum()))
        off = 180.0 - np.mod(180.0 - (self.azimuth_deg - mean), 360.0)
        return np.asarray(off - (off.min() + off.max()) / 2)

    @property
    def central_pulse(self) -> int:
        """Row of the pulse nearest to the middle of the aperture."""
        return int(np.abs(self.relative_azimuth_deg).argmin())

    def take(self, rows: NDArray[Any]) -> Self:
        """The pulses of the given rows (indices or a bool mask), in that order."""

        def of(values: FloatArray | None) -> FloatArray | None:
            return None if values is None else values[rows]

        return replace(
            self,
            samples=self.samples[rows],
            positions=self.positions[rows],
            r0=self.r0[rows],
            azimuth_deg=self.azimuth_deg[rows],
            autofocus_range=of(self.autofocus_range),
            autofocus_phase=of(self.autofocus_phase),
        )

    def select(self, start_deg: float, stop_deg: float) -> Self:
        """The pulses with azimuth in [start, stop), counter-clockwise from start and in that order.

        ``select(358, 2)`` and ``select(-2, 2)`` are the same four degrees.

        Raises
        ------
        InputError
            There is no pulse in that range.
        """
        offset, width = azimuth_offsets(self.azimuth_deg, start_deg, stop_deg)
        rows = np.argsort(offset, kind="stable")
        rows = rows[offset[rows] < width]
        if not len(rows):
            first, last = self.azimuth_deg.min(), self.azimuth_deg.max()
            raise InputError(
                f"{self.name}: no pulse between azimuth {start_deg:g} and {stop_deg:g} degrees; "
                f"it holds {len(self)} from {first:.3f} to {last:.3f}"
            )
        return self.take(rows)

    def corrected(self) -> Self:
        """With the known autofocus correction applied: `autofocus_range` added to r0, the phase to the samples.

        The correction is one of the file's author: it moves the image by the mean range correction, and is not
        better than none on every image. Where there is none, the same object is returned.
        """
        if self.autofocus_range is None and self.autofocus_phase is None:
            return self
        samples, r0 = self.samples, self.r0
        if self.autofocus_phase is not None:
            samples = samples * np.exp(1j * self.autofocus_phase).astype(np.complex64)[:, None]
        if self.autofocus_range is not None:
            r0 = r0 + self.autofocus_range
        return replace(self, samples=samples, r0=r0, autofocus_range=None, autofocus_phase=None)

    @classmethod
    def concatenate(cls, parts: Sequence[PhaseHistory]) -> PhaseHistory:
        """The pulses of all parts, one after the other.

        Raises
        ------
        InputError
            No parts, or parts of different frequencies or polarisations. A correction survives if all parts have it.
        """
        if not parts:
            raise InputError("nothing to concatenate, at least one phase history is needed")
        first = parts[0]
        for other in parts[1:]:
            same = len(other.frequencies) == len(first.frequencies)
            if not same or np.abs(other.frequencies - first.frequencies).max() > UNEVEN * first.spacing:
                raise InputError(f"{other.name}: has other frequencies than {first.name}; use them one by one")
            if other.polarisation != first.polarisation:
                raise InputError(
                    f"{other.name} is '{other.polarisation}' and {first.name} '{first.polarisation}'; "
                    "state one polarisation"
                )

        def joined(key: str) -> Any:
            found = [getattr(part, key) for part in parts]
            return None if any(values is None for values in found) else np.concatenate(found)

        keys = ("samples", "positions", "r0", "azimuth_deg", "autofocus_range", "autofocus_phase")
        return replace(first, **{key: joined(key) for key in keys})


def azimuth_offsets(azimuth_deg: FloatArray, start_deg: float, stop_deg: float) -> tuple[FloatArray, float]:
    """Degrees counter-clockwise from start of every pulse, and the width of the range (0, 360]."""
    if not np.isfinite([start_deg, stop_deg]).all():
        raise ParameterError(f"azimuth must be two numbers in degrees, got {start_deg} and {stop_deg}")
    width = 360.0 if stop_deg - start_deg >= 360 else (stop_deg - start_deg) % 360.0
    return np.mod(azimuth_deg - start_deg, 360.0), width
