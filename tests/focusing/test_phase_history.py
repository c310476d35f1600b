"""Phase histories: what the type refuses, selection around the circle, and the readers."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.focusing.phase_history import PhaseHistory

FREQUENCIES = np.linspace(9.3e9, 9.9e9, 8)
History = Callable[..., PhaseHistory]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"samples": np.zeros((3, 8))}, "samples must be complex"),
        ({"samples": np.zeros(8, np.complex64)}, "samples must be complex"),
        ({"samples": np.zeros((0, 8), np.complex64)}, "samples must be complex"),
        ({"samples": np.full((3, 8), np.nan, np.complex64)}, "samples must be finite"),
        ({"frequencies": FREQUENCIES[:7]}, "frequencies must have shape"),
        ({"frequencies": FREQUENCIES[::-1]}, "ascending and evenly spaced"),
        ({"frequencies": FREQUENCIES**2}, "ascending and evenly spaced"),
        ({"frequencies": FREQUENCIES - 9.5e9}, "ascending and evenly spaced"),
        ({"positions": np.zeros((2, 3))}, "positions must be finite"),
        ({"positions": np.full((3, 3), np.inf)}, "positions must be finite"),
        ({"r0": np.ones(4)}, "r0 must have shape"),
        ({"r0": np.array([1.0, np.nan, 1.0])}, "r0 must be finite"),
        ({"autofocus_phase": np.zeros(2)}, "autofocus_phase must have shape"),
    ],
)
def test_what_does_not_fit_is_refused(history: History, wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        history([0.0, 1.0, 2.0], **wrong)


def test_arrays_are_locked_and_the_callers_stay_free(history: History) -> None:
    samples = np.ones((2, 8), np.complex64)
    h = history([0, 1], samples=samples)
    samples[0] = 7
    for values in (h.samples, h.frequencies, h.positions, h.r0, h.azimuth_deg):
        assert not values.flags.writeable
    assert np.array_equal(pickle.loads(pickle.dumps(h)).samples, h.samples)


@pytest.mark.parametrize(
    ("start", "stop", "expected"),
    [
        (0.0, 2.0, [0, 1]),
        (1.0, 1.5, [1]),
        (358.0, 2.0, [358, 359, 0, 1]),
        (-2.0, 2.0, [358, 359, 0, 1]),
        (718.0, 722.0, [358, 359, 0, 1]),
    ],
)
def test_a_sector_is_half_open_and_goes_on_where_the_circle_closes(
    history: History, start: float, stop: float, expected: list[int]
) -> None:
    chosen = history(np.arange(360.0)).select(start, stop)
    assert chosen.azimuth_deg.tolist() == expected
    assert chosen.samples[:, 0].real.tolist() == expected


def test_the_whole_circle_starts_where_it_is_asked_to(history: History) -> None:
    chosen = history(np.arange(360.0)).select(90, 450)
    assert len(chosen) == 360
    assert chosen.azimuth_deg[[0, -1]].tolist() == [90, 89]


def test_azimuths_stay_below_360(history: History) -> None:
    assert history([-1e-14, 360.0, -90.0]).azimuth_deg.tolist() == [0, 0, 270]


def test_an_empty_sector_says_what_there_is(history: History) -> None:
    with pytest.raises(InputError, match=r"no pulse between azimuth 5 and 6 .* 3 from 0.000 to 2.000"):
        history([0, 1, 2]).select(5, 6)
    with pytest.raises(ParameterError, match="two numbers"):
        history([0, 1, 2]).select(np.nan, 6)


def test_the_middle_of_an_aperture_that_crosses_zero(history: History) -> None:
    h = history([358.0, 359.0, 0.0, 1.0, 2.0])
    np.testing.assert_allclose(h.relative_azimuth_deg, [-2, -1, 0, 1, 2], atol=1e-9)
    assert h.central_pulse == 2


def test_parts_make_the_whole_again(history: History) -> None:
    h = history(np.arange(6.0), autofocus_phase=np.arange(6.0))
    whole = PhaseHistory.concatenate([h.select(0, 2), h.select(2, 6)])
    for key in ("samples", "positions", "r0", "azimuth_deg", "autofocus_phase"):
        np.testing.assert_array_equal(getattr(whole, key), getattr(h, key))
    assert whole.autofocus_range is None


def test_what_does_not_belong_together_is_not_joined(history: History) -> None:
    h = history([0, 1])
    with pytest.raises(InputError, match="other frequencies"):
        PhaseHistory.concatenate([h, replace(h, frequencies=FREQUENCIES + 2e6)])
    with pytest.raises(InputError, match="state one polarisation"):
        PhaseHistory.concatenate([replace(h, polarisation="HH"), replace(h, polarisation="VV")])
    with pytest.raises(InputError, match="nothing to concatenate"):
        PhaseHistory.concatenate([])


def test_a_known_correction_is_applied_once(history: History) -> None:
    h = history([0, 1], autofocus_range=np.array([0.1, 0.2]), autofocus_phase=np.array([0.0, np.pi / 2]))
    done = h.corrected()
    np.testing.assert_allclose(done.r0, h.r0 + np.array([0.1, 0.2]))
    np.testing.assert_allclose(done.samples[1], 1j * h.samples[1], atol=1e-6)
    assert done.corrected() is done
