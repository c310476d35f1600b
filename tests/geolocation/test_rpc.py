"""RPC sensors: they agree with GDAL, with rpcm and with the exact geometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from rasterio.rpc import RPC
from rasterio.transform import RPCTransformer

from featreg.errors import InputError
from featreg.geolocation import RpcSensor, rpc_fit
from featreg.geolocation.rpc_fit import terms
from featreg.geolocation.sensor import METRES_PER_DEGREE
from featreg.geometry.least_squares import least_squares
from featreg.simulate import orbit as orbit_module
from featreg.simulate.orbit import RangeDoppler
from featreg.types import FloatArray

SHAPE = (2000, 2200)


@pytest.fixture(scope="module")
def cloud() -> tuple[FloatArray, FloatArray]:
    """Image points and heights."""
    rng = np.random.default_rng(5)
    return rng.uniform(0, [SHAPE[1], SHAPE[0]], (3000, 2)), rng.uniform(-100, 900, 3000)


class TestRpcSensor:
    def test_the_sample_of_an_rpc_counts_from_the_centre_of_the_first_pixel(self, rpc: RpcSensor) -> None:
        # GDAL's own coordinates count from the corner: half a pixel more.
        at = np.array([[rpc.rpcs["long_off"], rpc.rpcs["lat_off"]]])
        ours = rpc.ground_to_image(at, rpc.rpcs["height_off"])[0]
        with RPCTransformer(RPC(**rpc.rpcs)) as gdal:
            rows, columns = gdal.rowcol(*at.T, zs=[rpc.rpcs["height_off"]], op=float)
        assert np.allclose(ours + 0.5, [columns[0], rows[0]], atol=1e-7)
        constant = [
            rpc.rpcs[f"{n}_num_coeff"][0] * rpc.rpcs[f"{n}_scale"] + rpc.rpcs[f"{n}_off"] for n in ("samp", "line")
        ]
        assert np.allclose(ours, constant, atol=1e-9)

    def test_projection_agrees_with_gdal(self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]) -> None:
        ground = rpc.image_to_ground(*cloud)
        with RPCTransformer(RPC(**rpc.rpcs)) as gdal:
            rows, columns = gdal.rowcol(*ground.T, zs=cloud[1], op=lambda v: v)
        ours = rpc.ground_to_image(ground, cloud[1])
        assert np.abs(ours + 0.5 - np.column_stack([columns, rows])).max() < 1e-7

    def test_projection_and_location_agree_with_rpcm(
        self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]
    ) -> None:
        rpcm = pytest.importorskip("rpcm")
        names = {"long_off": "LONG_OFF", "samp_off": "SAMP_OFF"}
        text = {names.get(k, k.upper()): v for k, v in rpc.rpcs.items() if not isinstance(v, list)}
        text |= {k.upper(): " ".join(map(repr, v)) for k, v in rpc.rpcs.items() if isinstance(v, list)}
        oracle = rpcm.RPCModel(text)
        ground = rpc.image_to_ground(*cloud)
        assert np.abs(np.column_stack(oracle.projection(*ground.T, cloud[1])) - cloud[0]).max() < 1e-6
        located = np.column_stack(oracle.localization(*cloud[0].T, cloud[1]))
        assert np.abs(located - ground).max() * METRES_PER_DEGREE < 0.01

    def test_projection_is_the_quotient_of_the_twenty_terms(
        self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]
    ) -> None:
        rng = np.random.default_rng(3)
        wild = dict(rpc.rpcs)
        for name in ("samp", "line"):
            wild[f"{name}_num_coeff"] = rng.normal(size=20)
            wild[f"{name}_den_coeff"] = np.r_[1.0, rng.normal(scale=0.01, size=19)]
        unit = rng.uniform(-1, 1, (500, 3))
        scale = np.array([wild[f"{n}_scale"] for n in ("long", "lat", "height")])
        ground = unit * scale + [wild[f"{n}_off"] for n in ("long", "lat", "height")]
        found = RpcSensor(wild).ground_to_image(ground[:, :2], ground[:, 2])
        for axis, name in enumerate(("samp", "line")):
            value = (terms(unit) @ wild[f"{name}_num_coeff"]) / (terms(unit) @ wild[f"{name}_den_coeff"])
            assert np.allclose(found[:, axis], value * wild[f"{name}_scale"] + wild[f"{name}_off"], rtol=0, atol=1e-7)

    def test_there_and_back_is_exact(self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]) -> None:
        back = rpc.ground_to_image(rpc.image_to_ground(*cloud), cloud[1])
        assert np.abs(back - cloud[0]).max() < 1e-6

    def test_a_point_does_not_depend_on_the_others(self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]) -> None:
        whole = rpc.image_to_ground(*cloud)
        parts = [rpc.image_to_ground(cloud[0][i : i + 7], cloud[1][i : i + 7]) for i in range(0, 700, 7)]
        assert np.array_equal(np.concatenate(parts), whole[:700])
        with ThreadPoolExecutor(4) as pool:
            again = list(pool.map(lambda _: rpc.image_to_ground(*cloud), range(4)))
        assert all(np.array_equal(other, whole) for other in again)

    def test_it_is_the_range_doppler_geometry(
        self, rpc: RpcSensor, exact: RangeDoppler, cloud: tuple[FloatArray, FloatArray]
    ) -> None:
        ground = exact.image_to_ground(*cloud)
        assert np.abs(rpc.ground_to_image(ground, cloud[1]) - cloud[0]).max() < 1e-3

    def test_its_fit_is_the_least_squares_of_all_rows_at_once(
        self, exact: RangeDoppler, cloud: tuple[FloatArray, FloatArray], monkeypatch: Any
    ) -> None:
        def plain(design: FloatArray, values: FloatArray) -> Any:
            solution, _, _, singular = np.linalg.lstsq(design, values)
            return solution, singular

        # So few nodes that all rows at once do not keep the threads of a library waiting.
        monkeypatch.setattr(orbit_module, "NODES", (7, 7, 4))
        ground, errors = exact.image_to_ground(*cloud), []
        for solver in (least_squares, plain):
            monkeypatch.setattr(rpc_fit, "least_squares", solver)
            found = exact.rpc(SHAPE, -200.0, 1000.0, 15.0).ground_to_image(ground, cloud[1])
            errors.append(np.hypot(*(found - cloud[0]).T).max())
        assert errors[0] < 2e-7
        assert errors[0] < errors[1] + 1e-8

    def test_no_points_and_no_numbers(self, rpc: RpcSensor) -> None:
        assert rpc.image_to_ground(np.zeros((0, 2)), 0.0).shape == (0, 2)
        assert rpc.ground_to_image(np.zeros((0, 2)), 0.0).shape == (0, 2)
        holes = np.array([[100.0, np.nan], [100.0, 100.0]])
        assert np.isnan(rpc.image_to_ground(holes, 0.0)).any(axis=1).tolist() == [True, False]
        assert np.isnan(rpc.image_to_ground(holes[1:], np.nan)).all()

    def test_a_scene_may_lie_across_the_antimeridian(self, orbit: Callable[..., RangeDoppler]) -> None:
        there = orbit(place=(179.999, -17.0)).rpc(SHAPE, -200.0, 1000.0, 15.0)
        xy = np.array([[10.0, 10.0], [2190.0, 1990.0]])
        ground = there.image_to_ground(xy, 100.0)
        assert (np.abs(ground[:, 0]) <= 180).all()
        assert ground[:, 0].min() < 0 < ground[:, 0].max()
        assert np.abs(there.ground_to_image(ground, 100.0) - xy).max() < 1e-6

    def test_uncertainty_is_three_standard_errors_in_pixels(self, rpc: RpcSensor) -> None:
        assert rpc.uncertainty_px == pytest.approx(3 * math.hypot(15, 1) / 3, rel=0.02)
        unknown = {**rpc.rpcs, "err_bias": None, "err_rand": -1.0}
        assert RpcSensor(unknown).uncertainty_px == 20.0

    @pytest.mark.parametrize(
        ("change", "says"),
        [
            ({"samp_scale": 0.0}, "'samp_scale' must be > 0"),
            ({"lat_off": "north"}, "'lat_off' must be a number"),
            ({"lat_off": math.inf}, "'lat_off' must be finite"),
            ({"line_num_coeff": [1.0] * 19}, "'line_num_coeff' must be 20"),
            ({"line_den_coeff": "?"}, "'line_den_coeff' must be 20"),
        ],
    )
    def test_a_broken_rpc_is_refused(self, rpc: RpcSensor, change: dict[str, Any], says: str) -> None:
        with pytest.raises(InputError, match=says):
            RpcSensor({**rpc.rpcs, **change})

    @pytest.mark.parametrize("name", ["samp_off", "line_num_coeff"])
    def test_an_incomplete_rpc_is_refused(self, rpc: RpcSensor, name: str) -> None:
        with pytest.raises(InputError, match=f"lacks '{name}'"):
            RpcSensor({k: v for k, v in rpc.rpcs.items() if k != name})
