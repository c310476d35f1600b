"""Displacement fields: right values on fields of known truth, reasons for what cannot be measured."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine
from scipy.ndimage import gaussian_filter

import featreg
from featreg import Offsets, Reason
from featreg.errors import InputError, ParameterError
from featreg.simulate import DisplacedPair, displaced_pair


@pytest.fixture(scope="module")
def glacier() -> DisplacedPair:
    return displaced_pair("glacier", (480, 520), seed=3)


@pytest.fixture(scope="module")
def flow(glacier: DisplacedPair) -> Offsets:
    return featreg.offsets(glacier.reference, glacier.secondary)


def errors(field: Offsets, truth: NDArray[Any]) -> NDArray[np.float64]:
    """(N, 2) errors of the good cells; windows of even sides have their middle between pixels."""
    x, y = np.meshgrid(field.x, field.y)
    u, v = np.floor(x).astype(int), np.floor(y).astype(int)
    around = truth[v, u] + truth[v, u + 1] + truth[v + 1, u] + truth[v + 1, u + 1]
    return np.asarray((np.stack([field.dx, field.dy], -1) - around / 4)[field.good])


def inner(field: Offsets, shape: tuple[int, int]) -> NDArray[np.bool_]:
    reach = field.grid.window / 2 + 8
    x, y = np.meshgrid(field.x, field.y)
    return np.asarray((x > reach) & (x < shape[1] - reach) & (y > reach) & (y < shape[0] - reach))


def test_a_glacier_is_followed_cell_by_cell(glacier: DisplacedPair, flow: Offsets) -> None:
    error = np.hypot(*errors(flow, glacier.displacement).T)
    # Within a window, the ice moves by 3 px more on one side than on the other.
    assert np.median(error) < 0.2
    assert flow.good[inner(flow, glacier.reference.shape)].mean() > 0.9
    assert flow.x[0] == 7.5
    assert np.diff(flow.x).tolist() == [16.0] * (flow.x.size - 1)


def test_ellipses_hold_as_many_errors_as_they_say(glacier: DisplacedPair, flow: Offsets) -> None:
    error = errors(flow, glacier.displacement)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(flow.covariance[flow.good]), error)
    assert 0.64 < (squared < 2.279).mean() < 0.80
    assert 0.89 < (squared < 5.991).mean() < 0.99


def test_a_fault_stays_sharp() -> None:
    pair = displaced_pair("fault", (320, 480), size=8.0, seed=5)
    field = featreg.offsets(pair.reference, pair.secondary, window=48)
    far = np.abs(field.x - 239.5) > 48
    error = np.hypot(field.dx, field.dy - 8.0 * (field.x > 239.5))[:, far]
    assert np.nanmedian(error) < 0.15
    rows = field.good.sum(axis=1) > 10
    # Between the last cell that stood still and the first that moved.
    steps = [(field.x[row < 4].max() + field.x[row > 4].min()) / 2 for row in field.dy[rows]]
    assert abs(float(np.median(steps)) - 239.5) < 24


def test_motion_beyond_the_first_levels_is_found_with_a_wider_search() -> None:
    rng = np.random.default_rng(1)
    still = np.exp(gaussian_filter(rng.normal(0, 5, (400, 420)), 1.5))
    first, second = (
        part * np.sqrt(rng.gamma(4, 0.25, part.shape)) for part in (still[:320, :320], still[41:361, 57:377])
    )
    field = featreg.offsets(first, second, search=64)
    assert field.good.sum() > 100
    assert np.hypot(field.dx + 57, field.dy + 41)[field.good].max() < 0.3


def test_another_place_has_no_peak(sar_texture: Any) -> None:
    field = featreg.offsets(sar_texture(300, 300, 1), sar_texture(300, 300, 2))
    assert field.good.mean() < 0.01
    assert field.counts["no_peak"] > 0.8 * inner(field, (300, 300)).sum()


def test_what_is_not_data_has_its_reason(glacier: DisplacedPair) -> None:
    holes = glacier.reference.copy()
    holes[200:260, 100:180] = np.nan
    field = featreg.offsets(holes, glacier.secondary)
    assert field.reason[14, 8] == Reason.MASKED
    assert np.isnan(field.dx[14, 8])
    x, y = np.meshgrid(field.x, field.y)
    touched = (np.abs(x - 139.5) < 40 + 31) & (np.abs(y - 229.5) < 30 + 31)
    assert not field.good[touched].any()
    assert (field.reason[0] == Reason.OUTSIDE).all()


def test_a_repeated_pattern_is_ambiguous() -> None:
    rng = np.random.default_rng(3)
    tile = np.exp(rng.normal(0, 1, (16, 16)))
    scene = np.tile(tile, (16, 16))
    first, second = (scene * np.sqrt(rng.gamma(8, 1 / 8, scene.shape)) for _ in range(2))
    field = featreg.offsets(first, second, search=20)
    assert not field.good.any()
    assert field.counts["ambiguous"] > 0.8 * inner(field, scene.shape).sum()


def test_the_displacement_of_a_known_model_is_included(glacier: DisplacedPair) -> None:
    pair = featreg.simulate.sar_pair((400, 400), rotation_deg=3.0, scale=1.01, shift=(25.0, -14.0), seed=2)
    field = featreg.offsets(pair.reference, pair.secondary, initial=pair.truth)
    x, y = np.meshgrid(field.x, field.y)
    there = np.stack([x, y], -1) @ pair.truth[:, :2].T + pair.truth[:, 2]
    error = np.hypot(x + field.dx - there[..., 0], y + field.dy - there[..., 1])[field.good]
    assert field.good.mean() > 0.4
    assert np.median(error) < 0.13
    assert np.abs(field.dx[field.good]).max() > 20


@pytest.mark.parametrize("how", [{"executor": "serial"}, {"workers": 2}, {"workers": 3}, {"executor": "threads"}])
def test_blocks_give_the_same_bits_however_they_are_run(glacier: DisplacedPair, how: Any, tmp_path: Path) -> None:
    same = featreg.offsets(glacier.reference, glacier.secondary, block=192, workers=1)
    field = featreg.offsets(glacier.reference, glacier.secondary, block=192, **how)
    for name in ("dx", "dy", "covariance", "peak", "snr", "reason"):
        assert getattr(field, name).tobytes() == getattr(same, name).tobytes(), name


def test_blocks_agree_with_the_whole(glacier: DisplacedPair, flow: Offsets) -> None:
    field = featreg.offsets(glacier.reference, glacier.secondary, block=160, workers=1)
    both = field.good & flow.good
    assert both.sum() > 0.98 * flow.good.sum()
    assert np.median(np.hypot(field.dx - flow.dx, field.dy - flow.dy)[both]) < 0.01


def test_finished_blocks_are_taken_from_their_folder(glacier: DisplacedPair, tmp_path: Path) -> None:
    job: Any = {"block": 192, "workers": 1, "resume": tmp_path}
    first = featreg.offsets(glacier.reference, glacier.secondary, **job)
    files = sorted(tmp_path.iterdir())
    assert len(files) == 9
    files[3].write_bytes(b"cut short")
    files[4].unlink()
    told: list[int] = []
    again = featreg.offsets(glacier.reference, glacier.secondary, **job, progress=lambda done, _: told.append(done))
    assert told[0] == 7
    assert again.dx.tobytes() == first.dx.tobytes()


def test_killed_and_resumed_it_ends_as_if_nothing_had_happened(glacier: DisplacedPair, tmp_path: Path) -> None:
    np.savez(tmp_path / "pair.npz", glacier.reference, glacier.secondary)
    state = tmp_path / "state"
    code = (
        "import time, numpy as np, featreg\n"
        f"first, second = np.load({str(tmp_path / 'pair.npz')!r}).values()\n"
        "featreg.offsets(first, second, block=192, workers=1,\n"
        f"    resume={str(state)!r}, progress=lambda done, total: time.sleep(0.2 * (done > 2)))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code])
    until = time.monotonic() + 120
    while time.monotonic() < until and len(list(state.glob("offsets_*"))) < 3 and process.poll() is None:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    told: list[int] = []
    job: Any = {"block": 192, "workers": 1}
    field = featreg.offsets(
        glacier.reference, glacier.secondary, **job, resume=state, progress=lambda done, _: told.append(done)
    )
    assert 3 <= told[0] < 9
    same = featreg.offsets(glacier.reference, glacier.secondary, **job)
    for name in ("dx", "dy", "covariance", "reason"):
        assert getattr(field, name).tobytes() == getattr(same, name).tobytes(), name


@pytest.mark.slow
def test_a_cluster_of_dask_gives_the_same_bits(glacier: DisplacedPair) -> None:
    distributed = pytest.importorskip("distributed")
    job: Any = {"block": 256, "step": 32}
    same = featreg.offsets(glacier.reference, glacier.secondary, **job, workers=1)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        field = featreg.offsets(glacier.reference, glacier.secondary, **job, executor=client)
    for name in ("dx", "dy", "covariance", "reason"):
        assert getattr(field, name).tobytes() == getattr(same, name).tobytes(), name


def test_windows_across_a_bend_say_so() -> None:
    # A ridge of motion one window wide: its crest is measured too low, and the covariance must know it.
    pair = displaced_pair("glacier", (260, 260), size=6.0, seed=11, looks=16)
    calm = displaced_pair("glacier", (260, 260), size=0.5, seed=11, looks=16)
    bent, still = (featreg.offsets(p.reference, p.secondary) for p in (pair, calm))
    error = errors(bent, pair.displacement)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(bent.covariance[bent.good]), error)
    assert (squared < 5.991).mean() > 0.9
    assert np.median(bent.covariance[bent.good][:, 0, 0]) > np.median(still.covariance[still.good][:, 0, 0])


def test_the_raster_says_what_its_bands_are_and_where_it_lies(glacier: DisplacedPair, tmp_path: Path) -> None:
    paths = [str(tmp_path / name) for name in ("a.tif", "b.tif")]
    for path, image in zip(paths, (glacier.reference, glacier.secondary), strict=True):
        height, width = image.shape
        profile: Any = {"driver": "GTiff", "dtype": "float32", "count": 1, "width": width, "height": height}
        # Pixels of 10 m, north up.
        place = Affine(10.0, 0.0, 500000.0, 0.0, -10.0, 4000000.0)
        with rasterio.open(path, "w", crs="EPSG:32633", transform=place, **profile) as out:
            out.write(image, 1)
    field = featreg.offsets(*paths)
    field.to_file(tmp_path / "offsets.tif")
    with rasterio.open(tmp_path / "offsets.tif") as made:
        assert made.descriptions == (
            "dx", "dy", "cov_xx", "cov_xy", "cov_yy", "peak", "snr", "reason", "east_m", "north_m",
        )  # fmt: skip
        assert made.units[0] == "pixel"
        assert made.units[8] == "metre"
        assert made.profile["tiled"]
        assert made.crs.to_epsg() == 32633
        assert made.transform[:6] == (160.0, 0.0, 500000.0, 0.0, -160.0, 4000000.0)
        assert made.tags(8)["REASON_4"].startswith("the window leaves")
        dx, dy, east, north = (made.read(k) for k in (1, 2, 9, 10))
    assert np.allclose(dx, np.where(field.good, field.dx, np.nan), atol=1e-6, equal_nan=True)
    assert np.allclose(east, 10 * dx, atol=1e-4, equal_nan=True)
    assert np.allclose(north, -10 * dy, atol=1e-4, equal_nan=True)


def test_dates_are_refused_where_they_would_be_lost(flow: Offsets, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="MintPy"):
        flow.to_file(tmp_path / "flow.tif", dates=["20210401", "20210413"])
    for name in ("flow.png", "flow.nc", "flow"):
        with pytest.raises(ParameterError, match=r"as a GeoTIFF \(.tif\) or for MintPy \(.h5\)"):
            flow.to_file(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_errors_say_what_would_be_right(glacier: DisplacedPair) -> None:
    with pytest.raises(ParameterError, match="window"):
        featreg.offsets(glacier.reference, glacier.secondary, window=4)
    with pytest.raises(ParameterError, match="block"):
        featreg.offsets(glacier.reference, glacier.secondary, block=-1)
    with pytest.raises(InputError, match="one band as an"):
        featreg.offsets(glacier.reference[0], glacier.secondary)


def test_an_image_smaller_than_a_window_is_outside() -> None:
    rng = np.random.default_rng(0)
    field = featreg.offsets(rng.gamma(1, 1, (40, 40)), rng.gamma(1, 1, (40, 40)))
    assert field.reason.shape == (2, 2)
    assert (field.reason == Reason.OUTSIDE).all()
    assert "outside" in str(field)
