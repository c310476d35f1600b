"""Covariances of windows' peaks: pieces add up to the slope of the correlation, and errors are as large as is said."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.sar.correlation import peaks, quadratic_steps
from featreg.sar.orientation.levels import Level
from featreg.sar.orientation.precision import Part, peak_covariances
from featreg.sar.orientation.precision_kernels import slopes_of_windows
from featreg.sar.orientation.windows import correlated_around

F32 = NDArray[np.float32]
SIDE, REACH = 48, 6
#: Squared Mahalanobis lengths that hold 50, 68, 95 and 99 % of two Gaussian errors.
LIMITS = -2 * np.log(1 - np.array([0.5, 0.68, 0.95, 0.99]))


def fields(noise: float, rng: np.random.Generator, count: int = 14) -> tuple[F32, F32, NDArray[np.float64]]:
    """Two fields of smooth structure, the second displaced by (0.3, -0.4), under smooth noise; windows in between."""
    shape = (count * (SIDE + 2 * REACH), count * (SIDE + 2 * REACH))

    def smooth(shift: tuple[float, float], values: NDArray[np.float64]) -> NDArray[np.float64]:
        frequencies = np.meshgrid(*(np.fft.fftfreq(n) for n in shape), indexing="ij")
        damped = np.exp(-2 * (np.pi * 1.3) ** 2 * (frequencies[0] ** 2 + frequencies[1] ** 2))
        moved = np.exp(-2j * np.pi * (frequencies[1] * shift[0] + frequencies[0] * shift[1]))
        return np.asarray(np.fft.ifft2(np.fft.fft2(values) * damped * moved).real)

    structure = rng.normal(size=(2, *shape))
    here, there = (
        np.stack([smooth(shift, part) + smooth((0, 0), noise * rng.normal(size=shape)) for part in structure], axis=-1)
        for shift in ((0.0, 0.0), (0.3, -0.4))
    )
    middles = (SIDE + 2 * REACH) * np.arange(count) + REACH + (SIDE - 1) / 2
    xy = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    return here.astype(np.float32), there.astype(np.float32), xy


def surfaces(here: F32, there: F32, xy: NDArray[np.float64]) -> F32:
    """Correlation coefficients of the windows."""
    level = Level(here, there, np.ones(here.shape[:2], np.bool_), np.eye(3), np.eye(3)[:2])
    return correlated_around(level, xy, SIDE, REACH)


def test_pieces_add_up_to_slope_and_curvature_of_the_correlation() -> None:
    rng = np.random.default_rng(3)
    here, there = np.zeros((2, 30, 36, 2), np.float32)
    # Nothing at the rim of the windows, so that either field's slope is that of the whole correlation.
    here[8:18, 10:20], there[9:19, 8:18] = rng.normal(size=(2, 10, 10, 2))
    sums, energy = np.empty((1, 4, 4, 5), np.float32), np.empty((1, 2), np.float32)
    at, moved = np.array([[7, 5]]), np.array([[-2, 1]])
    slopes_of_windows(here.ravel(), there.ravel(), 30, 36, at, moved, 16, 4, sums, energy)
    nine = np.array(
        [[[(here * np.roll(there, (-v, -u), (0, 1))).sum() for u in (-3, -2, -1)] for v in (0, 1, 2)]], np.float64
    )
    step, curvature, _ = quadratic_steps(nine)
    gx, gy, xx, xy, yy = sums.sum(axis=(0, 1, 2), dtype=np.float64)
    np.testing.assert_allclose([[xx, xy], [xy, yy]], curvature[0], rtol=1e-4, atol=1e-4)
    slope = [nine[0, :, 2].sum() - nine[0, :, 0].sum(), nine[0, 2].sum() - nine[0, 0].sum()]
    np.testing.assert_allclose([gx, gy], np.array(slope) / 6, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(energy[0], [(here**2).sum(), (there**2).sum()], rtol=1e-5)
    assert step.shape == (1, 2)


def test_windows_beyond_the_fields_hold_nothing_there() -> None:
    rng = np.random.default_rng(4)
    here, there = rng.normal(size=(2, 20, 24, 2)).astype(np.float32)
    at, moved = np.array([[-5, 12], [40, 3]]), np.array([[3, 2], [0, 0]])
    sums, energy = np.empty((2, 4, 4, 5), np.float32), np.empty((2, 2), np.float32)
    slopes_of_windows(here.ravel(), there.ravel(), 20, 24, at, moved, 16, 4, sums, energy)
    wide = [np.pad(field, ((40, 40), (40, 40), (0, 0))) for field in (here, there)]
    again, whole = np.empty_like(sums), np.empty_like(energy)
    slopes_of_windows(wide[0].ravel(), wide[1].ravel(), 100, 104, at + 40, moved, 16, 4, again, whole)
    np.testing.assert_array_equal(sums, again)
    np.testing.assert_array_equal(energy, whole)
    assert not sums[1].any()


@pytest.mark.parametrize("noise", [0.5, 1.5])
def test_ellipses_hold_the_share_of_errors_that_they_state(noise: float) -> None:
    here, there, xy = fields(noise, np.random.default_rng(11))
    values = surfaces(here, there, xy)
    seen = peaks(values.astype(np.float64))
    assert seen.sound.all()
    covariance = peak_covariances([Part(here, there, SIDE)], xy, values, seen)
    error = seen.shift - [0.3, -0.4]
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    inside = (squared[:, None] <= LIMITS).mean(axis=0)
    # Three standard errors of 196 windows that do not overlap.
    wanted = np.array([0.5, 0.68, 0.95, 0.99])
    assert (np.abs(inside - wanted) < 3 * np.sqrt(wanted * (1 - wanted) / len(xy))).all(), inside
    assert np.trace(covariance, axis1=1, axis2=2).mean() == pytest.approx((error**2).sum(axis=1).mean(), rel=0.25)


def test_a_rival_peak_widens_the_covariance_towards_itself() -> None:
    here, there, xy = fields(1.0, np.random.default_rng(7), 3)
    values = surfaces(here, there, xy)
    seen = peaks(values.astype(np.float64))
    part = [Part(here, there, SIDE)]
    alone = peak_covariances(part, xy, values, seen)
    rival = values.copy()
    rival[:, REACH, REACH + 4] = seen.height - 1e-6
    more = peak_covariances(part, xy, rival, seen) - alone
    assert (more[:, 0, 0] > 0).all()
    # From (0.3, -0.4) the rival at (4, 0) lies nine times as far along x as along y.
    assert np.median(more[:, 0, 0] / np.abs(more[:, 1, 1])) > 30


def test_a_pair_without_noise_is_known_well_but_not_without_end() -> None:
    # Alike on all sides of its peak: not even the rim of the window scatters.
    row = np.exp(-((np.arange(60) - 30.0) ** 2) / 8)
    field = np.stack([np.outer(row, row), np.zeros((60, 60))], axis=-1).astype(np.float32)
    xy = np.array([[29.5, 29.5]])
    values = surfaces(field, field, xy)
    seen = peaks(values.astype(np.float64))
    assert seen.sound.all()
    with np.errstate(all="raise", under="ignore"):
        (covariance,) = peak_covariances([Part(field, field, SIDE)], xy, values, seen)
    smallest, largest = np.linalg.eigvalsh(covariance)
    assert 0 < smallest <= largest < 1e-6


def test_no_window_gives_no_covariance() -> None:
    values = np.zeros((0, 13, 13), np.float32)
    field = np.zeros((60, 60, 2), np.float32)
    found = peak_covariances([Part(field, field, SIDE)], np.zeros((0, 2)), values, peaks(values.astype(np.float64)))
    assert found.shape == (0, 2, 2)
