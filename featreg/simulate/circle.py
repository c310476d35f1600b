"""Circular-SAR phase history of a made-up parking lot, one azimuth sector at a time.

Vehicles are groups of scatterers that are each seen over a few degrees of aspect only, as in wide-angle SAR of real
ones; calibration targets are seen from everywhere; the ground is a random field of many weak scatterers, whose
speckle is independent in apertures that do not overlap.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.focusing.backprojection import SPEED_OF_LIGHT
from featreg.focusing.phase_history import PhaseHistory
from featreg.runtime.parameters import Count, Positive, checked
from featreg.runtime.threads import worker_count
from featreg.types import FloatArray, kept, points, read_only

#: Scatterers of one vehicle, over all aspects; one in twenty or so is seen at a time.
PARTS = 480
#: Share of them on the ground, where they are not displaced towards the radar.
FOOT = 2 / 3
#: Parking slot, distance of rows and jitter, m.
SLOT, ROW, JITTER = 2.9, 11.0, 0.25
#: Range profiles are this many times finer than the samples while scatterers are put into them.
FINER = 16
#: Pulses simulated at a time.
PULSES = 64
#: Rim left free of vehicles and targets, m.
RIM = 8.0


@dataclass(frozen=True, eq=False)
class ParkingLot:
    """Point scatterers, in metres about the scene centre, z up.

    Parameters
    ----------
    positions : (N, 3) float64 m
    amplitude : (N,) complex64, square root of the radar cross-section in m^2 where the ground has 1 m^2 per m^2
    aspect_deg : (N,) float64, azimuth of the antenna at which a scatterer is brightest
    persistence_deg : (N,) float64, width of that lobe at half power, degrees; inf = seen from everywhere
    vehicles : (V, 5) float64, centre x, y, length, width in m, and heading in degrees
    targets : (T, 2) float64 m, where the calibration targets stand
    radius : m, of the disc around the origin that holds all scatterers

    Raises
    ------
    ParameterError
        Columns of different lengths or a persistence that is not positive.
    """

    positions: FloatArray
    amplitude: NDArray[np.complex64]
    aspect_deg: FloatArray
    persistence_deg: FloatArray
    vehicles: FloatArray
    targets: FloatArray

    def __post_init__(self) -> None:
        n = len(self.positions)
        columns = (self.amplitude, self.aspect_deg, self.persistence_deg)
        if self.positions.shape != (n, 3) or any(values.shape != (n,) for values in columns):
            raise ParameterError(f"a lot of {n} scatterers needs (N, 3) positions and (N,) columns")
        if n and not (self.persistence_deg > 0).all():
            raise ParameterError("persistence must be > 0 degrees, or inf")
        for field in fields(self):
            object.__setattr__(self, field.name, kept(getattr(self, field.name)))

    @property
    def radius(self) -> float:
        """Largest horizontal distance of a scatterer from the scene centre, m."""
        return float(np.hypot(self.positions[:, 0], self.positions[:, 1]).max(initial=0.0))


@checked("CircularPath")
@dataclass(frozen=True)
class CircularPath:
    """A radar that flies a circle around the scene; the defaults are those of the Gotcha data set, pass 1.

    Parameters
    ----------
    radius, height : of the circle, m
    pulses_per_degree : pulse k stands at azimuth k / pulses_per_degree, whatever sector is asked for
    lowest_frequency, bandwidth : Hz
    frequencies : samples of a pulse, evenly spaced over the bandwidth
    """

    radius: Positive = 7089.0
    height: float = 7276.0
    pulses_per_degree: Count = 117
    lowest_frequency: Positive = 9.288e9
    bandwidth: Positive = 622.4e6
    frequencies: Annotated[int, Ge(2)] = 424

    @property
    def unambiguous_radius(self) -> float:
        """Ground distance from the centre beyond which echoes fold into the scene, m."""
        step = self.bandwidth / (self.frequencies - 1)
        return SPEED_OF_LIGHT / (4 * step) * math.hypot(self.radius, self.height) / self.radius


def parking_lot(
    *,
    vehicles: int = 36,
    targets: int = 8,
    width: float = 100.0,
    persistence_deg: tuple[float, float] = (5.0, 20.0),
    contrast_db: float = 10.0,
    target_db: float = 20.0,
    clutter_density: float = 40.0,
    seed: int = 0,
) -> ParkingLot:
    """Make a parking lot of vehicles in jittered rows, with some slots empty.

    Parameters
    ----------
    vehicles, targets : numbers of vehicles and of calibration targets
    width : side of the square ground, m
    persistence_deg : range from which the width of a scatterer's lobe at half power is drawn, degrees
    contrast_db : radar cross-section of a vehicle, averaged over aspect, per area of its outline, over that of the
        ground per area: the ratio of the mean image intensities, but for what the response spreads over the outline
    target_db : radar cross-section of a calibration target over that of 1 m^2 of ground
    clutter_density : scatterers of the ground per m^2; 0 leaves the ground out. With fewer than about eight per
        resolution cell, the speckle of neighbouring apertures is correlated (0.05 at 40, 0.1 at 20 with 4 degrees)
    seed : of everything random

    Raises
    ------
    ParameterError
        An impossible number or range, or more vehicles than there are slots.
    """
    low, high = persistence_deg
    if not 0 < low <= high or width <= 2 * RIM + ROW or min(vehicles, targets, clutter_density) < 0:
        raise ParameterError(
            f"a lot needs 0 < persistence, a width over {2 * RIM + ROW:g} m and no negative numbers, got "
            f"persistence_deg={persistence_deg}, width={width}, vehicles={vehicles}, targets={targets}"
        )
    rng = np.random.default_rng(seed)
    parked = _parked(vehicles, width, rng)
    groups = [_vehicle(row, low, high, 10 ** (contrast_db / 10), rng) for row in parked]
    posts = _targets(targets, parked, width, rng)
    groups.append(_everywhere(posts, np.full(targets, 10 ** (target_db / 20)), rng))
    count = round(clutter_density * width**2)
    ground = np.column_stack([rng.uniform(-width / 2, width / 2, (count, 2)), np.zeros(count)])
    # Equal strengths come to fully developed speckle with the fewest scatterers per resolution cell.
    strength = np.full(count, math.sqrt(1 / clutter_density) if count else 0.0)
    groups.append(_everywhere(ground, strength, rng))
    columns = [np.concatenate(parts) for parts in zip(*groups, strict=True)]
    amplitude = columns[1].astype(np.complex64)
    return ParkingLot(columns[0], amplitude, columns[2], columns[3], parked, points(posts[:, :2], "targets"))


Group = tuple[FloatArray, NDArray[np.complex128], FloatArray, FloatArray]


def _parked(count: int, width: float, rng: np.random.Generator) -> FloatArray:
    """(count, 5) vehicles in random slots of rows that are turned against the axes."""
    reach = width / 2 - RIM
    turn = np.deg2rad(rng.uniform(0, 180))
    along, across = np.arange(-2 * reach, 2 * reach, SLOT), np.arange(-2 * reach, 2 * reach, ROW)
    slots = np.stack(np.meshgrid(along, across), axis=-1).reshape(-1, 2)
    slots = slots + rng.uniform(-JITTER, JITTER, slots.shape)
    slots = slots @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    slots = slots[np.abs(slots).max(axis=1) < reach]
    if count > len(slots):
        raise ParameterError(f"{count} vehicles do not fit, there are {len(slots)} slots on {width:g} m; widen the lot")
    chosen = slots[rng.choice(len(slots), count, replace=False)]
    heading = np.rad2deg(turn) + 90 + rng.normal(0, 2, count) + 180 * rng.integers(0, 2, count)
    return np.column_stack([chosen, rng.uniform(4.0, 5.2, count), rng.uniform(1.7, 2.0, count), heading])


def _vehicle(row: FloatArray, low: float, high: float, contrast: float, rng: np.random.Generator) -> Group:
    """Scatterers on the four sides of a vehicle, most on its foot, where the sides and the ground make dihedrals."""
    x, y, length, width, heading = row
    side = rng.choice(4, PARTS, p=np.array([length, width, length, width]) / (2 * (length + width)))
    place = rng.uniform(-0.5, 0.5, PARTS)
    # Side 0 looks to the left of the heading, 1 ahead, 2 to the right, 3 back.
    ahead = np.select([side == 1, side == 3], [length / 2, -length / 2], place * length)
    left = np.select([side == 0, side == 2], [width / 2, -width / 2], place * width)
    normal = heading + np.array([90.0, 0.0, -90.0, 180.0])[side]
    turn = np.deg2rad(heading)
    height = np.where(rng.random(PARTS) < FOOT, 0.0, rng.uniform(0.3, 1.4, PARTS))
    positions = np.column_stack(
        [x + ahead * np.cos(turn) - left * np.sin(turn), y + ahead * np.sin(turn) + left * np.cos(turn), height]
    )
    persistence = rng.uniform(low, high, PARTS)
    power = rng.exponential(1.0, PARTS)
    # The lobe's mean over all aspects is its width times sqrt(pi / (4 ln 2)), over the circle.
    mean = (power * persistence).sum() * math.sqrt(math.pi / (4 * math.log(2))) / 360
    power *= contrast * length * width / mean
    phase = np.exp(2j * np.pi * rng.random(PARTS))
    return positions, np.sqrt(power) * phase, normal + rng.uniform(-75, 75, PARTS), persistence


def _targets(count: int, parked: FloatArray, width: float, rng: np.random.Generator) -> FloatArray:
    """(count, 3) places on the ground, as far from the vehicles as a few draws give."""
    reach = width / 2 - RIM
    places = np.zeros((count, 3))
    for i in range(count):
        draws = rng.uniform(-reach, reach, (24, 2))
        others = np.concatenate([parked[:, :2], places[:i, :2], np.full((1, 2), 2 * width)])
        gaps = np.hypot(*(draws[:, None] - others).transpose(2, 0, 1)).min(axis=1)
        places[i, :2] = draws[gaps.argmax()]
    return places


def _everywhere(positions: FloatArray, strength: FloatArray, rng: np.random.Generator) -> Group:
    n = len(positions)
    return positions, strength * np.exp(2j * np.pi * rng.random(n)), np.zeros(n), np.full(n, np.inf)


def circular_phase_history(
    lot: ParkingLot, start_deg: float, stop_deg: float, path: CircularPath | None = None, *, workers: int = 1
) -> PhaseHistory:
    """Simulate the pulses with azimuth in [start, stop).

    Parameters
    ----------
    lot : scatterers
    start_deg, stop_deg : sector, counter-clockwise, stop > start; sectors that overlap have their pulses in common
    path : of the radar; default that of the Gotcha data
    workers : threads; the result does not depend on them

    Returns
    -------
    PhaseHistory
        After the signal model of `featreg.focusing.phase_history`, without noise of the receiver and without spreading
        loss.

    Raises
    ------
    ParameterError
        An empty sector, or a lot beyond the unambiguous range.

    Notes
    -----
    Scatterers go into range profiles 16 times finer than the samples by linear weights, whose transform is divided
    out after the FFT: the error is 4e-4 of the amplitude in the middle of the band and 2e-3 at its edges.
    """
    path = path or CircularPath()
    if not 0 < stop_deg - start_deg <= 360:
        raise ParameterError(f"the sector must go from start to a larger stop, got {start_deg} to {stop_deg} degrees")
    if lot.radius >= path.unambiguous_radius:
        raise ParameterError(
            f"the lot reaches {lot.radius:.0f} m, the path is unambiguous to {path.unambiguous_radius:.0f} m; "
            "take more frequencies or a smaller lot"
        )
    first, last = (math.ceil(round(angle * path.pulses_per_degree, 6)) for angle in (start_deg, stop_deg))
    azimuth = np.arange(first, last) / path.pulses_per_degree
    if not len(azimuth):
        raise ParameterError(f"no pulse between {start_deg} and {stop_deg} degrees; take a wider sector")
    turn = np.deg2rad(azimuth)
    positions = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))]) * path.radius
    positions[:, 2] = path.height
    r0 = np.linalg.norm(positions, axis=1)
    frequencies = np.linspace(path.lowest_frequency, path.lowest_frequency + path.bandwidth, path.frequencies)
    seen = _seen(lot, float(azimuth[0]), float(azimuth[-1]))
    chunks = [slice(i, min(i + PULSES, len(turn))) for i in range(0, len(turn), PULSES)]
    with ThreadPoolExecutor(worker_count(workers)) as pool:
        parts = pool.map(lambda rows: _samples(seen, azimuth[rows], positions[rows], r0[rows], frequencies), chunks)
        samples = np.concatenate(list(parts))
    return PhaseHistory(read_only(samples), frequencies, positions, r0, azimuth, name="simulated circle")


#: Scatterers as the kernel takes them: x, y, z, real, imag, aspect, rate.
Columns = tuple[FloatArray, FloatArray, FloatArray, NDArray[np.float32], NDArray[np.float32], FloatArray, FloatArray]


def _seen(lot: ParkingLot, first_deg: float, last_deg: float) -> list[Columns]:
    """Those seen from everywhere, and those that are not 48 dB down at every azimuth from first to last."""
    middle, half = (first_deg + last_deg) / 2, (last_deg - first_deg) / 2
    away = np.abs(np.mod(lot.aspect_deg - middle + 180, 360) - 180) - half
    steady = np.isinf(lot.persistence_deg)
    near = ~steady & (away < 2 * lot.persistence_deg)
    groups: list[Columns] = []
    for rows in (steady, near):
        if rows.any():
            x, y, z = np.ascontiguousarray(lot.positions[rows].T)
            amplitude = lot.amplitude[rows]
            # Half the power half a persistence away from the lobe's middle.
            rate = 2 * math.log(2) / lot.persistence_deg[rows] ** 2
            groups.append((x, y, z, amplitude.real.copy(), amplitude.imag.copy(), lot.aspect_deg[rows], rate))
    return groups


def _samples(
    seen: list[Columns], azimuth: FloatArray, positions: FloatArray, r0: FloatArray, frequencies: FloatArray
) -> NDArray[np.complex64]:
    """(P, F) complex64 echoes of some pulses."""
    from scipy.fft import fft, next_fast_len

    from featreg.focusing.backprojection_kernels import project_points

    count = len(frequencies)
    length = int(next_fast_len(FINER * count))
    step = (frequencies[-1] - frequencies[0]) / (count - 1)
    middle = count // 2
    real, imag = (np.zeros((len(r0), length + 2), np.float32) for _ in range(2))
    per_metre, waves = 2 * step * length / SPEED_OF_LIGHT, 2 * frequencies[middle] / SPEED_OF_LIGHT
    for columns in seen:
        project_points(*columns, azimuth, positions, r0, per_metre, float(length // 2), waves, real, imag)
    profiles = (real[:, :length] + np.complex64(1j) * imag[:, :length]).astype(np.complex64)
    spectrum = fft(np.roll(profiles, -(length // 2), axis=1), axis=1)
    order = np.arange(count) - middle
    return np.asarray(spectrum[:, order] / np.sinc(order / length) ** 2, np.complex64)
