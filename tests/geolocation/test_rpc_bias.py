"""The bias of an RPC as a model: bound to sensors, fitted among outliers, written, and worked into a new RPC."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import rasterio
from rasterio.rpc import RPC
from rasterio.transform import RPCTransformer, from_origin

import featreg
from featreg.errors import InputError, ParameterError
from featreg.geolocation import ConstantHeight, DemHeights, GeotransformSensor, RpcBias, RpcSensor, Transfer
from featreg.geometry import Affine, Translation, model_from_dict, model_to_dict, prediction_covariance
from featreg.geometry.robust import fit_consensus, irls, plain_irls
from featreg.interfaces import FailedFit
from featreg.io.rpc_file import write_rpc
from featreg.registry import model_class, model_name
from featreg.simulate.orbit import RangeDoppler, Terrain
from featreg.types import FloatArray

SHAPE = (1500, 1600)
PLACE = (12.0, 47.0)
HILLS = Terrain.made(PLACE, 400.0, 700.0, 4000.0, np.random.default_rng(0))
BIAS = np.array([[1.0003, -0.0004, 7.5], [0.0002, 0.9998, -5.25]])
GRID = np.stack(np.meshgrid(np.linspace(100, 1500, 8), np.linspace(100, 1400, 8)), -1).reshape(-1, 2)


@pytest.fixture(scope="module")
def sensors() -> tuple[RpcSensor, RpcSensor]:
    views = [
        RangeDoppler.over(PLACE, SHAPE, incidence_deg=i, heading_deg=h, pixel=3.0, height=400.0)
        for i, h in ((35.0, -12.0), (44.0, -10.0))
    ]
    first, second = (view.rpc(SHAPE, -200.0, 1000.0, 20.0) for view in views)
    return first, second


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> DemHeights:
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    step, n = 2.5e-4, 520
    west, north = PLACE[0] - 0.5 * n * step, PLACE[1] + 0.5 * n * step
    x, y = west + (np.arange(n) + 0.5) * step, north - (np.arange(n) + 0.5) * step
    values = HILLS.at(np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)).reshape(n, n).astype(np.float32)
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": "EPSG:4326"}
    with rasterio.open(
        path, "w", width=n, height=n, transform=from_origin(west, north, step, step), **profile
    ) as dataset:
        dataset.write(values, 1)
    return DemHeights(str(path))


@pytest.fixture(scope="module")
def bound(sensors: tuple[RpcSensor, RpcSensor], dem: DemHeights) -> type[RpcBias]:
    return RpcBias.bind(*sensors, dem)


@pytest.fixture(scope="module")
def ties(sensors: tuple[RpcSensor, RpcSensor], dem: DemHeights) -> tuple[FloatArray, FloatArray]:
    """Tie points that obey the bias exactly."""
    here = np.random.default_rng(3).uniform(50, 1450, (400, 2))
    return here, Affine(BIAS)(Transfer(*sensors, dem)(here))


def outliers(there: FloatArray, share: float, seed: int = 4) -> tuple[FloatArray, Any]:
    rng = np.random.default_rng(seed)
    bad = rng.random(len(there)) < share
    return np.where(bad[:, None], rng.uniform(0, 1500, there.shape), there + rng.normal(0, 0.2, there.shape)), bad


class TestFit:
    def test_an_affine_bias_is_recovered(self, bound: type[RpcBias], ties: tuple[FloatArray, FloatArray]) -> None:
        model = bound.from_estimate(*ties)
        assert model
        assert np.allclose(model.bias, BIAS, atol=1e-6)
        assert bound.minimum == 3

    def test_a_shift_is_recovered(
        self, sensors: tuple[RpcSensor, RpcSensor], dem: DemHeights, ties: tuple[FloatArray, FloatArray]
    ) -> None:
        shifted = RpcBias.bind(*sensors, dem, kind="shift")
        model = shifted.from_estimate(ties[0], Translation(7.5, -5.25)(Transfer(*sensors, dem)(ties[0])))
        assert model
        assert np.allclose(model.bias, [[1, 0, 7.5], [0, 1, -5.25]], atol=1e-9)
        assert shifted.minimum == 1

    def test_no_affine_map_would_do(self, bound: type[RpcBias], ties: tuple[FloatArray, FloatArray]) -> None:
        plane = Affine.from_estimate(*ties)
        assert plane
        assert plane.residuals(*ties).max() > 20

    def test_consensus_is_sought_on_the_mapped_points(
        self, bound: type[RpcBias], ties: tuple[FloatArray, FloatArray]
    ) -> None:
        # Relief moves points by tens of pixels: affine hypotheses on the reference points would find no consensus.
        there, bad = outliers(ties[1], 0.6)
        model, inliers = fit_consensus(bound, ties[0], there, threshold=1.5, rng=np.random.default_rng(0))
        assert isinstance(model, RpcBias)
        assert inliers[~bad].mean() > 0.98
        assert inliers[bad].mean() < 0.02
        assert np.abs(model(GRID) - Affine(BIAS)(model.transfer(GRID))).max() < 0.2

    def test_reweighting_the_correction_is_reweighting_the_model(
        self, bound: type[RpcBias], ties: tuple[FloatArray, FloatArray]
    ) -> None:
        there, _ = outliers(ties[1], 0.2)
        model, weights = irls(bound, ties[0], there, scale_px=0.1)
        plain, by_model = plain_irls(bound, ties[0], there, np.ones(len(there)), 0.1, 30)
        assert isinstance(model, RpcBias)
        assert isinstance(plain, RpcBias)
        assert np.abs(model(GRID) - plain(GRID)).max() < 1e-6
        assert np.abs(weights - by_model).max() < 1e-6

    def test_points_without_ground_count_for_nothing(
        self, sensors: tuple[RpcSensor, RpcSensor], ties: tuple[FloatArray, FloatArray]
    ) -> None:
        # A sensor that loses every fifth point.
        class Lossy(RpcSensor):
            def ground_to_image(self, lonlat: FloatArray, heights: Any) -> FloatArray:
                out = super().ground_to_image(lonlat, heights)
                out[::5] = np.nan
                return out

        lossy = RpcBias.bind(sensors[0], Lossy(sensors[1].rpcs), ConstantHeight(400.0))
        there = Translation(3.0, 4.0)(Transfer(*sensors, ConstantHeight(400.0))(ties[0]))
        model = lossy.from_estimate(ties[0], there)
        assert model
        assert np.allclose(model.bias, [[1, 0, 3.0], [0, 1, 4.0]], atol=1e-6)
        assert model.residuals(ties[0], there)[::5].min() > 1e6
        robust, weights = irls(lossy, ties[0], there)
        assert robust
        assert (weights[::5] == 0).all()
        found, inliers = fit_consensus(lossy, ties[0], there, threshold=1.0, rng=np.random.default_rng(0))
        assert found
        assert inliers.tolist() == [False, True, True, True, True] * 80

    def test_too_few_points_fail_and_say_so(self, bound: type[RpcBias]) -> None:
        assert isinstance(bound.from_estimate(GRID[:2], GRID[:2]), FailedFit)
        assert isinstance(bound.from_estimate(np.zeros((0, 2)), np.zeros((0, 2))), FailedFit)

    def test_it_knows_its_standard_error(self, bound: type[RpcBias], ties: tuple[FloatArray, FloatArray]) -> None:
        rng = np.random.default_rng(0)
        truth = Affine(BIAS)(bound.known(GRID))
        errors, predicted = [], []
        for _ in range(30):
            there = ties[1] + rng.normal(0, 0.5, ties[1].shape)
            model = bound.from_estimate(ties[0], there)
            assert model
            covariance = prediction_covariance(model, ties[0], there, at=GRID)
            assert not isinstance(covariance, FailedFit)
            errors.append(((model(GRID) - truth) ** 2).sum(axis=1).mean())
            predicted.append(np.trace(covariance, axis1=1, axis2=2).mean())
        assert np.mean(errors) == pytest.approx(np.mean(predicted), rel=0.35)

    def test_the_pipeline_takes_the_class(self, bound: type[RpcBias], ties: tuple[FloatArray, FloatArray]) -> None:
        there, _ = outliers(ties[1], 0.3)
        result = featreg.fit(np.c_[ties[0], there], model=bound, reference_shape=SHAPE, secondary_shape=SHAPE)
        assert result.status == "ok", result.reason
        assert result.gates["held_out"].value == pytest.approx(0.2, abs=0.1)
        assert result.provenance["parameters"]["model"] == "rpc-bias"

    def test_the_class_itself_knows_no_sensors(self, ties: tuple[FloatArray, FloatArray]) -> None:
        assert model_class("rpc-bias") is RpcBias
        with pytest.raises(ParameterError, match="needs the sensors of both images"):
            RpcBias.from_estimate(*ties)
        with pytest.raises(ParameterError, match="needs the sensors of both images"):
            featreg.fit(np.c_[ties[0], ties[1]], model="rpc-bias")

    def test_an_unknown_kind_is_refused(self, sensors: tuple[RpcSensor, RpcSensor]) -> None:
        wrong: Any = "cubic"
        with pytest.raises(ParameterError, match="'affine' or 'shift', got 'cubic'"):
            RpcBias.bind(*sensors, kind=wrong)


@pytest.fixture(scope="module")
def model(sensors: tuple[RpcSensor, RpcSensor], dem: DemHeights) -> RpcBias:
    return RpcBias(*sensors, dem, "affine", BIAS)


class TestModel:
    def test_the_inverse_goes_back(self, model: RpcBias) -> None:
        assert np.abs(model.inverse(model(GRID)) - GRID).max() < 1e-4
        assert model.inverse.inverse is model
        with pytest.raises(InputError, match="not fitted"):
            model.inverse.from_estimate(GRID, GRID)

    def test_it_is_rebuilt_to_the_last_bit(self, model: RpcBias, bound: type[RpcBias]) -> None:
        again = model_from_dict(model_to_dict(model))
        assert np.array_equal(again(GRID), model(GRID))
        fitted = bound.with_correction(Affine(BIAS))
        assert model_name(type(fitted)) == "rpc-bias"
        record = model_to_dict(fitted)
        assert record["type"] == "rpc-bias"
        assert np.array_equal(model_from_dict(record)(GRID), model(GRID))

    def test_a_result_file_gives_it_back(
        self, bound: type[RpcBias], ties: tuple[FloatArray, FloatArray], tmp_path: Path
    ) -> None:
        result = featreg.fit(np.c_[ties[0], ties[1]], model=bound, reference_shape=SHAPE, secondary_shape=SHAPE)
        result.to_json(tmp_path / "result.json")
        again = featreg.Registration.from_json(tmp_path / "result.json")
        assert isinstance(again.model, RpcBias)
        assert isinstance(result.model, RpcBias)
        assert np.array_equal(again.model(GRID), result.model(GRID))

    def test_models_and_bound_classes_travel_to_workers(self, model: RpcBias, bound: type[RpcBias]) -> None:
        assert pickle.loads(pickle.dumps(RpcBias)) is RpcBias
        assert np.array_equal(pickle.loads(pickle.dumps(model))(GRID), model(GRID))
        there = pickle.loads(pickle.dumps(bound))
        assert there.minimum == bound.minimum
        assert np.array_equal(there.known(GRID), bound.known(GRID))
        fitted = pickle.loads(pickle.dumps(bound.with_correction(Affine(BIAS))))
        assert np.array_equal(fitted(GRID), model(GRID))
        assert type(fitted).from_estimate(GRID, fitted(GRID))

    @pytest.mark.parametrize(
        ("change", "says"),
        [
            ({"reference": {"type": "?"}}, "a sensor's type"),
            ({"heights": {"type": "?"}}, "type of heights"),
            ({"heights": 12.0}, "two sensors and heights"),
            ({"bias": [[1, 0, 0]]}, r"RpcBias.bias must be a finite array of shape \(2, 3\)"),
            ({"bias": np.zeros((2, 3))}, "invert"),
            ({"colour": 1}, "no model 'rpc-bias' has the parameters"),
        ],
    )
    def test_a_broken_record_is_refused(self, model: RpcBias, change: dict[str, Any], says: str) -> None:
        record = {"type": "rpc-bias", "parameters": {**model.parameters, **change}}
        with pytest.raises(InputError, match=says):
            model_from_dict(record)


class TestCorrectedRpc:
    @pytest.mark.parametrize("kind", ["affine", "shift"])
    def test_the_corrected_rpc_is_the_model(
        self, sensors: tuple[RpcSensor, RpcSensor], dem: DemHeights, kind: Literal["affine", "shift"]
    ) -> None:
        bias = BIAS if kind == "affine" else Translation(7.5, -5.25).matrix[:2]
        model = RpcBias(*sensors, dem, kind, bias)
        corrected = Transfer(sensors[0], RpcSensor(model.corrected_rpc()), dem)
        assert np.abs(corrected(GRID) - model(GRID)).max() < (1e-9 if kind == "shift" else 1e-3)

    @pytest.mark.parametrize("name", ["scene_RPC.TXT", "scene_rpc.txt", "scene.RPB"])
    def test_gdal_reads_the_file_beside_the_image(
        self, sensors: tuple[RpcSensor, RpcSensor], dem: DemHeights, tmp_path: Path, name: str
    ) -> None:
        model = RpcBias(*sensors, dem, "affine", BIAS)
        with rasterio.open(
            tmp_path / "scene.tif", "w", driver="GTiff", width=16, height=16, count=1, dtype="uint8"
        ) as made:
            made.write(np.ones((16, 16), np.uint8), 1)
        model.write_corrected_rpc(tmp_path / name)
        with rasterio.open(tmp_path / "scene.tif") as dataset:
            read = dataset.rpcs
        want = model.corrected_rpc()
        for key, value in want.items():
            assert getattr(read, key) == pytest.approx(value, rel=1e-14), key
        lonlat = np.array([[12.003, 47.002]])
        with RPCTransformer(RPC(**want)) as gdal:
            row, column = gdal.rowcol(12.003, 47.002, zs=450.0, op=float)
        assert np.allclose(RpcSensor(want).ground_to_image(lonlat, 450.0)[0] + 0.5, [column, row], atol=1e-7)
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["scene.tif", name])

    def test_what_cannot_be_corrected_or_written_is_said(
        self, sensors: tuple[RpcSensor, RpcSensor], tmp_path: Path
    ) -> None:
        grid = GeotransformSensor((1e-5, 0.0, 12.0, 0.0, -1e-5, 47.0), "EPSG:4326", SHAPE)
        with pytest.raises(InputError, match="only an RPC can be corrected"):
            RpcBias(sensors[0], grid, ConstantHeight()).corrected_rpc()
        with pytest.raises(ParameterError, match=r"NAME_RPC\.TXT or NAME\.RPB"):
            write_rpc(tmp_path / "scene.txt", sensors[0].rpcs)
        with pytest.raises(InputError, match="cannot be written"):
            write_rpc(tmp_path / "none" / "scene.RPB", sensors[0].rpcs)
