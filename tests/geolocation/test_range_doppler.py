"""Sensors by orbit and timing, against orbits that are known exactly and roots found by scipy."""

from __future__ import annotations

import json
import pickle
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from featreg.errors import InputError
from featreg.geolocation import (
    ConstantHeight,
    RangeDopplerSensor,
    RpcBias,
    ground_level,
    sensor_from_dict,
    sensor_of,
)
from featreg.geolocation.orbit import Orbit
from featreg.geolocation.pixel_size import pixel_size
from featreg.io.ellipsoid import earth_fixed, geodetic
from featreg.results.input_image import InputImage
from featreg.simulate.orbit import RangeDoppler
from featreg.types import FloatArray, Geolocation

#: A satellite like Sentinel-1: radius in metres, radians a second along the orbit, inclination, turn of the Earth.
RADIUS, RATE, INCLINATION, TURN = 7_070_000.0, 1.0619e-3, np.radians(98.18), 7.2921159e-5
SHAPE = (1500, 2000)
INTERVAL, NEAR, SPACING = 2e-3, 800e3, 5.0


def states(times: Any) -> tuple[FloatArray, FloatArray]:
    """Earth-fixed positions and velocities of a circular orbit over an Earth that turns; it crosses 40 north at 0 s."""
    t = np.asarray(times, np.float64)
    u = np.radians(40.0) + RATE * t
    c, s = np.cos(INCLINATION), np.sin(INCLINATION)
    fixed = RADIUS * np.stack([np.cos(u), np.sin(u) * c, np.sin(u) * s], -1)
    moving = RADIUS * RATE * np.stack([-np.sin(u), np.cos(u) * c, np.cos(u) * s], -1)
    a = TURN * t
    turn = np.stack([np.cos(a), np.sin(a)], -1)
    position = np.stack(
        [turn[..., 0] * fixed[..., 0] + turn[..., 1] * fixed[..., 1],
         turn[..., 0] * fixed[..., 1] - turn[..., 1] * fixed[..., 0], fixed[..., 2]], -1
    )  # fmt: skip
    velocity = np.stack(
        [turn[..., 0] * moving[..., 0] + turn[..., 1] * moving[..., 1] + TURN * position[..., 1],
         turn[..., 0] * moving[..., 1] - turn[..., 1] * moving[..., 0] - TURN * position[..., 0], moving[..., 2]], -1
    )  # fmt: skip
    return position, velocity


def sensor(every: float = 10.0, **more: Any) -> RangeDopplerSensor:
    times = np.asarray(np.arange(-5, 6) * every, np.float64)
    given: dict[str, Any] = {
        "line_interval": INTERVAL,
        "shape": SHAPE,
        "near_range": NEAR,
        "range_spacing": SPACING,
    } | more
    return RangeDopplerSensor(times, *states(times), **given)


def image_points(count: int = 40, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(0, [SHAPE[1], SHAPE[0]], (count, 2))


def truth(lonlat: FloatArray, heights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times and ranges of closest approach by bracketing on the exact orbit."""
    points = earth_fixed(lonlat, heights)

    def off(t: float, point: FloatArray) -> float:
        position, velocity = states(np.array(t))
        return float((point - position) @ velocity)

    time = np.array([brentq(off, -60, 60, args=(point,), xtol=1e-13) for point in points])
    return time, np.linalg.norm(points - states(time)[0], axis=1)


class TestOrbit:
    @pytest.mark.parametrize(("every", "metres"), [(10.0, 1e-4), (60.0, 1e-2)])
    def test_between_state_vectors(self, every: float, metres: float) -> None:
        knots = np.asarray(np.arange(-3, 4) * every, np.float64)
        orbit = Orbit(knots, *states(knots))
        t: FloatArray = np.linspace(knots[0], knots[-1], 301)
        position, velocity = orbit.at(t)
        assert np.abs(position - states(t)[0]).max() < metres
        assert np.abs(velocity - states(t)[1]).max() < metres
        np.testing.assert_allclose(orbit.at(knots)[0], orbit.positions, atol=1e-6)

    def test_velocities_are_those_that_are_stated_also_between_the_vectors(self) -> None:
        knots = np.asarray(np.arange(-4, 5) * 10.0, np.float64)
        position, velocity = states(knots)
        odd = np.array([0.02, -0.01, 0.015])
        t: FloatArray = np.linspace(-20.0, 20.0, 81)
        found, speed = Orbit(knots, position, velocity + odd).at(t)
        assert np.abs(found - states(t)[0]).max() < 1e-4
        assert np.abs(speed - states(t)[1] - odd).max() < 1e-4

    def test_two_vectors_will_do(self) -> None:
        knots = np.array([0.0, 10.0])
        assert np.abs(Orbit(knots, *states(knots)).at(np.array([5.0]))[0] - states(np.array([5.0]))[0]).max() < 1e-3

    def test_velocities_that_do_not_turn_with_the_earth_are_refused(self) -> None:
        knots = np.asarray(np.arange(5) * 10.0, np.float64)
        position, velocity = states(knots)
        inertial = velocity + TURN * np.stack([-position[:, 1], position[:, 0], np.zeros(5)], -1)
        with pytest.raises(InputError, match="turns with the Earth"):
            Orbit(knots, position, inertial)

    def test_bad_vectors_are_named(self) -> None:
        with pytest.raises(InputError, match="at least 2"):
            Orbit(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
        knots = np.array([0.0, 0.0, 1.0])
        with pytest.raises(InputError, match="increase"):
            Orbit(knots, *states(knots))


def test_geodetic_coordinates_come_back() -> None:
    lonlat, heights = np.array([[12.5, 48.2], [-70.0, -33.3], [0.0, 89.0]]), np.array([300.0, 8000.0, -50.0])
    np.testing.assert_allclose(geodetic(earth_fixed(lonlat, heights)), np.column_stack([lonlat, heights]), atol=1e-6)


class TestProjection:
    @pytest.mark.parametrize("look", ["right", "left"])
    def test_against_the_exact_orbit(self, look: Any) -> None:
        made = sensor(look=look)
        p = image_points()
        heights = np.linspace(-100.0, 8000.0, len(p))
        ground = made.image_to_ground(p, heights)
        assert np.isfinite(ground).all()
        time, distance = truth(ground, heights)
        expected = np.column_stack([(distance - NEAR) / SPACING, time / INTERVAL])
        np.testing.assert_allclose(expected, p, atol=1e-4)
        np.testing.assert_allclose(made.ground_to_image(ground, heights), p, atol=1e-6)
        # The satellite flies north: what it sees to its right lies east.
        aside = ground[:, 0] - geodetic(states(np.zeros(1))[0])[0, 0]
        assert (aside > 0).all() if look == "right" else (aside < 0).all()

    def test_the_other_side_and_beyond_the_orbit_are_nowhere(self) -> None:
        right, left = sensor(), sensor(look="left")
        ground = right.image_to_ground(image_points(5), 0.0)
        assert np.isnan(left.ground_to_image(ground, 0.0)).all()
        assert np.isnan(right.ground_to_image(np.array([[ground[0, 0], -60.0]]), 0.0)).all()
        assert np.isnan(sensor(near_range=100e3).image_to_ground(np.zeros((1, 2)), 0.0)).all()
        assert np.isnan(right.ground_to_image(np.full((1, 2), np.nan), 0.0)).all()

    def test_a_point_does_not_depend_on_its_company(self) -> None:
        made, p = sensor(), image_points(200)
        together = made.image_to_ground(p, 100.0)
        assert np.array_equal(together[7:8], made.image_to_ground(p[7:8], 100.0))

    def test_a_bistatic_correction_of_one_range(self) -> None:
        plain, late = sensor(), sensor(bistatic_range=NEAR)
        ground = plain.image_to_ground(image_points(), 50.0)
        x, y = plain.ground_to_image(ground, 50.0).T
        expected = np.column_stack([x, y - x * SPACING / 299_792_458.0 / INTERVAL])
        np.testing.assert_allclose(late.ground_to_image(ground, 50.0), expected, atol=1e-7)
        np.testing.assert_allclose(late.image_to_ground(expected, 50.0), ground, atol=1e-11)

    def test_ground_range(self) -> None:
        coefficients = [[800e3, 0.5, 5e-7, -3e-14], [800.1e3, 0.505, 5e-7, -3e-14]]
        ranges = {"spacing": 10.0, "times": [-1.0, 4.0], "origins": [0.0, -50.0], "coefficients": coefficients}
        made = sensor(ground_range=ranges)
        p = image_points()
        ground = made.image_to_ground(p, 200.0)
        np.testing.assert_allclose(made.ground_to_image(ground, 200.0), p, atol=1e-6)
        time, distance = truth(ground, np.full(len(p), 200.0))
        part = (time + 1) / 5
        powers = np.array(coefficients[0]) * (1 - part[:, None]) + np.array(coefficients[1]) * part[:, None]
        metres = 10.0 * p[:, 0] + 50.0 * part
        np.testing.assert_allclose(distance, sum(powers[:, k] * metres**k for k in range(4)), atol=1e-3)

    def test_bursts_overlap_in_time(self) -> None:
        lines, step = 500, 400 * INTERVAL
        bursts = {"times": [0.0, step, 2 * step], "lines": lines, "valid": [[20, 480]] * 3}
        made = sensor(bursts=bursts)
        # The middles of bursts are seen once, and come back where they were.
        p = np.array([[100.0, 250.0], [900.0, 760.0], [1500.0, 1240.0]])
        ground = made.image_to_ground(p, 0.0)
        np.testing.assert_allclose(made.ground_to_image(ground, 0.0), p, atol=1e-6)
        time, _ = truth(ground, np.zeros(3))
        np.testing.assert_allclose(time, [250 * INTERVAL, step + 260 * INTERVAL, 2 * step + 240 * INTERVAL], atol=1e-7)
        # Line 490 of the first burst holds no data; the second has the same ground in its line 90.
        seen = made.ground_to_image(made.image_to_ground(np.array([[100.0, 490.0]]), 0.0), 0.0)
        np.testing.assert_allclose(seen, [[100.0, lines + 90.0]], atol=1e-6)

    def test_the_simulated_orbit(self) -> None:
        exact = RangeDoppler.over((12.0, 47.0), SHAPE, incidence_deg=35.0, heading_deg=-12.0, pixel=3.0, height=400.0)
        made = exact.sensor(SHAPE, 400.0)
        p, heights = image_points(), np.linspace(0, 3000, 40)
        np.testing.assert_allclose(made.image_to_ground(p, heights), exact.image_to_ground(p, heights), atol=1e-9)
        assert made.centre == (999.5, 749.5)
        assert np.allclose(made.pixel_size(400.0), 3.0, rtol=0.02)
        assert made.uncertainty_px == pytest.approx(5.0, rel=0.02)


class TestRecord:
    def test_dict_and_pickle(self) -> None:
        ranges = {"spacing": 10.0, "times": [0.0], "origins": [0.0], "coefficients": [[800e3, 0.5]]}
        bursts = {"times": [0.0, 1.0], "lines": 700, "valid": [[0, 699]] * 2}
        made = sensor(ground_range=ranges, bursts=bursts, bistatic_range=8e5, ground_m=300.0)
        p = image_points(9)
        for again in (sensor_from_dict(json.loads(json.dumps(made.to_dict()))), pickle.loads(pickle.dumps(made))):
            assert np.array_equal(again.image_to_ground(p, 10.0), made.image_to_ground(p, 10.0))
        assert ground_level(made) == (300.0, "the metadata of the product")

    def test_of_an_image_before_its_control_points(self) -> None:
        made = sensor()
        gcps = np.array([[0, 0, 1, 1, 0], [9, 0, 2, 1, 0], [0, 9, 1, 2, 0], [9, 9, 2, 2, 0.0]])
        place = Geolocation(crs="EPSG:4326", gcps=gcps, sensor=made.to_dict())
        assert isinstance(sensor_of(place, SHAPE, "image"), RangeDopplerSensor)
        size = pixel_size(place)
        assert size is not None
        assert size[:2] == pytest.approx(made.pixel_size())
        noted = InputImage("image", SHAPE, geolocation=place)
        again = InputImage.from_dict(json.loads(json.dumps(noted.to_dict(), default=lambda a: a.tolist())))
        assert again is not None
        assert again.geolocation is not None
        assert again.geolocation.sensor == made.to_dict()

    @pytest.mark.parametrize(
        ("more", "text"),
        [
            ({"line_interval": 0.0}, "line_interval"),
            ({"near_range": -1.0}, "near_range"),
            ({"near_range": float("nan")}, "finite"),
            ({"bursts": {"times": [1.0, 0.0], "lines": 5, "valid": [[0, 4]] * 2}}, "bursts"),
            ({"ground_range": {"spacing": 0, "times": [0], "origins": [0], "coefficients": [[1, 1]]}}, "spacing"),
        ],
    )
    def test_impossible_values(self, more: dict[str, Any], text: str) -> None:
        with pytest.raises(InputError, match=text):
            sensor(**more)

    def test_values_of_no_sensor(self) -> None:
        values = sensor().to_dict()
        for name, wrong in (("times", ["a"]), ("positions", [[1.0]]), ("shape", [1]), ("velocities", None)):
            with pytest.raises(InputError):
                sensor_from_dict({**values, name: wrong})
        near = np.asarray(values["times"], np.float64) * 1e-300
        with pytest.raises(InputError):
            sensor_from_dict({**values, "times": near.tolist()})
        with pytest.raises(InputError, match="no sensor of type 'range-doppler'"):
            sensor_from_dict({"type": "range-doppler", "orbit": 1})


class TestBias:
    def test_a_shift_is_range_and_time(self) -> None:
        exact, late = sensor(), sensor(first_line_time=3 * INTERVAL, near_range=NEAR - 2 * SPACING)
        p = image_points()
        there = late.ground_to_image(exact.image_to_ground(p, 100.0), 100.0)
        model = RpcBias.bind(exact, exact, ConstantHeight(100.0), kind="shift").from_estimate(p, there)
        assert model
        np.testing.assert_allclose(model.bias[:, 2], [2.0, -3.0], atol=1e-5)
        # What the image says is to be increased by that to agree with the reference.
        np.testing.assert_allclose(model.timing_bias(), [-2 * SPACING, 3 * INTERVAL], rtol=1e-4)
        np.testing.assert_allclose(
            model.corrected_sensor().image_to_ground(there, 100.0), exact.image_to_ground(p, 100.0), atol=1e-9
        )
        again = sensor_from_dict(json.loads(json.dumps(model.corrected_sensor().to_dict())))
        np.testing.assert_allclose(again.ground_to_image(exact.image_to_ground(p, 100.0), 100.0), there, atol=1e-5)
