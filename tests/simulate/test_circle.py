"""The simulated circle: exact echoes, lobes in aspect, the stated contrast, and sectors that fit together."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from featreg.errors import ParameterError
from featreg.focusing.backprojection import SPEED_OF_LIGHT as C
from featreg.focusing.backprojection import back_project
from featreg.focusing.ground_grid import GroundGrid
from featreg.focusing.phase_history import PhaseHistory
from featreg.simulate.circle import CircularPath, ParkingLot, circular_phase_history, parking_lot

PATH = CircularPath(radius=700.0, height=700.0, pulses_per_degree=20, bandwidth=300e6, frequencies=128)
SMALL: dict[str, Any] = {"vehicles": 4, "targets": 2, "width": 36.0, "clutter_density": 3.0}


def lot_of(positions: Any, amplitude: Any, aspect: Any = 0.0, persistence: Any = np.inf) -> ParkingLot:
    place = np.reshape(np.asarray(positions, np.float64), (-1, 3))
    n = len(place)
    angle, width = (np.broadcast_to(np.asarray(v, np.float64), n).copy() for v in (aspect, persistence))
    strength = np.broadcast_to(np.asarray(amplitude, np.complex64), n).copy()
    return ParkingLot(place, strength, angle, width, np.zeros((0, 5)), np.zeros((0, 2)))


def by_sum(lot: ParkingLot, h: PhaseHistory) -> Any:
    """The signal model summed point by point in float64."""
    off = np.linalg.norm(h.positions[:, None] - lot.positions, axis=2) - h.r0[:, None]
    away = np.mod(h.azimuth_deg[:, None] - lot.aspect_deg + 180, 360) - 180
    lobe = np.where(np.isinf(lot.persistence_deg), 1.0, 0.5 ** (2 * (away / lot.persistence_deg) ** 2))
    strength = lot.amplitude * lobe
    return np.stack([(strength * np.exp(-4j * np.pi * off * f / C)).sum(axis=1) for f in h.frequencies], axis=1)


def test_the_echoes_are_those_of_the_signal_model() -> None:
    lot = parking_lot(seed=1, **SMALL)
    h = circular_phase_history(lot, 40.0, 41.0, PATH)
    expected = by_sum(lot, h)
    error = np.sqrt((np.abs(h.samples - expected) ** 2).mean(axis=0) / (np.abs(expected) ** 2).mean(axis=0))
    assert error[32:-32].max() < 1e-3
    assert error.max() < 4e-3


def test_half_the_power_is_left_half_a_persistence_away() -> None:
    lot = lot_of([1.0, 2.0, 0.0], 1.0, aspect=359.0, persistence=8.0)
    h = circular_phase_history(lot, 354.0, 365.0, PATH)
    power = np.abs(h.samples[:, 64]) ** 2
    at = {azimuth: power[i] for i, azimuth in enumerate(np.round(h.azimuth_deg, 3))}
    assert at[359.0] == pytest.approx(1.0, rel=0.01)
    assert at[355.0] == pytest.approx(0.5, rel=0.01)
    assert at[3.0] == pytest.approx(0.5, rel=0.01)
    assert np.abs(circular_phase_history(lot, 170.0, 171.0, PATH).samples).max() == 0


def test_a_scatterer_focuses_where_it_stands_from_every_side() -> None:
    lot = lot_of([3.0, -2.0, 0.0], 1.5)
    grid = GroundGrid((61, 61), spacing=0.2)
    for start in (0.0, 75.0, 200.0):
        pixels = back_project(circular_phase_history(lot, start, start + 4, PATH), grid).pixels
        row, col = np.unravel_index(np.abs(pixels).argmax(), pixels.shape)
        assert (int(col), int(row)) == (45, 40)
        assert abs(pixels[row, col]) == pytest.approx(1.5, rel=0.02)


def test_sectors_join_to_the_whole_and_overlap_in_the_same_pulses() -> None:
    lot = parking_lot(seed=1, **SMALL)
    whole = circular_phase_history(lot, 358.0, 362.0, PATH)
    parts = [circular_phase_history(lot, 358.0, 360.0, PATH), circular_phase_history(lot, 0.0, 2.0, PATH)]
    joined = PhaseHistory.concatenate(parts)
    assert len(whole) == 80
    np.testing.assert_allclose(joined.azimuth_deg, whole.azimuth_deg, atol=1e-9)
    np.testing.assert_allclose(joined.samples, whole.samples, atol=2e-3 * np.abs(whole.samples).max())


def test_threads_and_repetition_change_no_bit_and_seeds_do() -> None:
    lot, again, other = (parking_lot(seed=seed, **SMALL) for seed in (1, 1, 2))
    first = circular_phase_history(lot, 0.0, 8.0, PATH)
    np.testing.assert_array_equal(first.samples, circular_phase_history(again, 0.0, 8.0, PATH, workers=3).samples)
    assert not np.array_equal(lot.positions, other.positions)


def test_the_contrast_is_the_stated_one() -> None:
    """Radar cross-section per area of vehicles, averaged over all aspects, over that of the ground."""
    lot = parking_lot(seed=4, contrast_db=13.0, target_db=17.0, vehicles=6, targets=3, width=60.0, clutter_density=8.0)
    fading = np.isfinite(lot.persistence_deg)
    azimuth = np.arange(0, 360, 0.5)[:, None]
    away = np.mod(azimuth - lot.aspect_deg[fading] + 180, 360) - 180
    lobe = 0.5 ** (4 * (away / lot.persistence_deg[fading]) ** 2)
    section = (lobe * np.abs(lot.amplitude[fading]) ** 2).sum(axis=1).mean()
    area = (lot.vehicles[:, 2] * lot.vehicles[:, 3]).sum()
    assert 10 * np.log10(section / area) == pytest.approx(13.0, abs=0.05)
    steady = np.abs(lot.amplitude[~fading].astype(np.complex128)) ** 2
    np.testing.assert_allclose(10 * np.log10(steady[:3]), 17.0, atol=1e-3)
    assert steady[3:].sum() / 60.0**2 == pytest.approx(1.0, abs=0.05)


def test_vehicles_are_brighter_than_the_ground_by_about_the_contrast() -> None:
    lot = parking_lot(seed=5, **{**SMALL, "clutter_density": 12.0, "vehicles": 8})
    grid = GroundGrid((121, 121), spacing=0.25)
    rows, cols = np.mgrid[:121, :121]
    ground = grid.to_ground(np.column_stack([cols.ravel(), rows.ravel()]).astype(np.float64))
    turn = np.deg2rad(lot.vehicles[:, 4])
    off = ground[:, None] - lot.vehicles[:, :2]
    ahead = np.abs(off[..., 0] * np.cos(turn) + off[..., 1] * np.sin(turn))
    beside = np.abs(off[..., 1] * np.cos(turn) - off[..., 0] * np.sin(turn))
    inside = ((ahead < lot.vehicles[:, 2] / 2) & (beside < lot.vehicles[:, 3] / 2)).any(axis=1)
    outside = ((ahead > lot.vehicles[:, 2] + 1) | (beside > lot.vehicles[:, 3] + 1)).all(axis=1)
    outside &= (np.linalg.norm(ground[:, None] - lot.targets, axis=2) > 3).all(axis=1)
    power = np.zeros(len(ground))
    for start in (10, 100, 190, 280):
        power += np.abs(back_project(circular_phase_history(lot, start, start + 4, PATH), grid).pixels.ravel()) ** 2
    # Raised scatterers and the width of the response carry some of it over the outline.
    assert 5 < 10 * np.log10(power[inside].mean() / power[outside].mean()) < 12


def test_persistence_lies_in_the_range_and_everything_in_the_square() -> None:
    lot = parking_lot(seed=1, persistence_deg=(6.0, 9.0), **SMALL)
    fading = lot.persistence_deg[np.isfinite(lot.persistence_deg)]
    assert 6 <= fading.min() < 6.1
    assert 8.9 < fading.max() <= 9
    assert np.abs(lot.positions[:, :2]).max() <= 18
    assert len(lot.vehicles) == 4
    assert len(lot.targets) == 2


def test_speckle_of_neighbouring_apertures_is_independent_and_targets_stay() -> None:
    lot = parking_lot(seed=3, **{**SMALL, "vehicles": 0, "clutter_density": 30.0})
    grid = GroundGrid((101, 101), spacing=0.25)
    first, second = (np.abs(back_project(circular_phase_history(lot, a, a + 4, PATH), grid).pixels) for a in (0, 4))
    rows, cols = np.mgrid[:101, :101]
    ground = grid.to_ground(np.column_stack([cols.ravel(), rows.ravel()]).astype(np.float64))
    calm = (np.linalg.norm(ground[:, None] - lot.targets, axis=2) > 4).all(axis=1).reshape(grid.shape)
    assert abs(np.corrcoef(first[calm], second[calm])[0, 1]) < 0.1
    for col, row in np.rint(grid.to_pixels(lot.targets)).astype(int):
        for image in (first, second):
            assert image[row - 1 : row + 2, col - 1 : col + 2].max() > 3 * np.median(image[calm])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"vehicles": 10_000}, "do not fit"),
        ({"persistence_deg": (0.0, 5.0)}, "0 < persistence"),
        ({"persistence_deg": (9.0, 5.0)}, "0 < persistence"),
        ({"width": 10.0}, "a width over"),
        ({"targets": -1}, "no negative numbers"),
    ],
)
def test_impossible_lots(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        parking_lot(**{**SMALL, **wrong})


def test_impossible_collections() -> None:
    lot = lot_of([1.0, 0.0, 0.0], 1.0)
    with pytest.raises(ParameterError, match="from start to a larger stop"):
        circular_phase_history(lot, 4.0, 4.0, PATH)
    with pytest.raises(ParameterError, match="no pulse between"):
        circular_phase_history(lot, 4.001, 4.002, PATH)
    with pytest.raises(ParameterError, match="is unambiguous to 45 m"):
        circular_phase_history(lot_of([90.0, 0.0, 0.0], 1.0), 0.0, 1.0, PATH)
    with pytest.raises(ParameterError, match="bandwidth' must be a number above 0"):
        replace(PATH, bandwidth=0.0)
    with pytest.raises(ParameterError, match="persistence must be > 0"):
        lot_of([1.0, 0.0, 0.0], 1.0, persistence=0.0)
