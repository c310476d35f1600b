"""Stacks from images to models: drift, a jump, an image of another place, the same bits however it is run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import Stack
from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine
from featreg.io.raster_source import ImageSource, Window
from featreg.simulate import SimulatedSeries, sar_series
from featreg.stacks.work import _options_digest
from featreg.types import Geolocation, Image

READ = ImageSource.read

JOB: Any = {"model": "rigid", "seed": 0}


@pytest.fixture(scope="module")
def series() -> SimulatedSeries:
    return sar_series(5, (260, 260), looks=4, unrelated=3, seed=4)


@pytest.fixture(scope="module")
def stack(series: SimulatedSeries) -> Stack:
    return featreg.register_stack(series.images, workers=1, **JOB)


def same(first: Stack, second: Stack) -> bool:
    """Whether all numbers of two stacks have the same bits."""
    models = [
        (a is None and b is None) or (a is not None and b is not None and a.parameters == b.parameters)
        for a, b in zip(first.models, second.models, strict=True)
    ]
    return (
        all(models)
        and first.closure == second.closure
        and first.standard_errors.tobytes() == second.standard_errors.tobytes()
        and [pair.weight for pair in first.pairs] == [pair.weight for pair in second.pairs]
    )


def test_every_date_but_that_of_another_place_is_registered(series: SimulatedSeries, stack: Stack) -> None:
    assert stack.status == ["ok", "ok", "ok", "left out", "ok"]
    assert "pairs can be trusted" in stack.reasons[3]
    grid = np.array([[20.0, 20.0], [240.0, 30.0], [130.0, 130.0], [20.0, 240.0]])
    for i in (1, 2, 4):
        model = stack.models[i]
        assert model is not None
        assert np.abs(model(grid) - Affine(series.truths[i])(grid)).max() < 0.5
        assert stack.standard_errors[i] < 0.5
    table = stack.to_dataframe()
    assert table["status"].tolist() == list(stack.status)
    assert table["dx"].isna().tolist() == [False, False, False, True, False]
    assert "left out: image 3" in str(stack)


@pytest.mark.parametrize("how", [{"workers": 2}, {"workers": 3}, {"executor": "threads"}])
def test_the_same_bits_however_it_is_run(series: SimulatedSeries, stack: Stack, how: Any) -> None:
    assert same(featreg.register_stack(series.images, **JOB, **how), stack)


def test_finished_pairs_are_kept_and_a_date_is_added(series: SimulatedSeries, stack: Stack, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    keep: Any = {"workers": 1, "resume": tmp_path, "progress": lambda *n: told.append(n)}
    shorter = featreg.register_stack(series.images[:4], **JOB, **keep)
    before = len(told)
    longer = shorter.add(series.images[4], **keep)
    assert len(longer.models) == 5
    assert 0 < len(told) - before <= 3
    assert same(longer, stack)
    told.clear()
    assert same(featreg.register_stack(series.images, **JOB, **keep), stack)
    assert told == []


def test_killed_and_resumed_it_ends_as_if_nothing_had_happened(
    series: SimulatedSeries, stack: Stack, tmp_path: Path
) -> None:
    np.savez(tmp_path / "images.npz", *series.images)
    code = (
        "import numpy as np, featreg\n"
        f"images = list(np.load({str(tmp_path / 'images.npz')!r}).values())\n"
        f"featreg.register_stack(images, workers=1, resume={str(tmp_path / 'state')!r}, model='rigid', seed=0)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code])
    state = tmp_path / "state"
    until = time.monotonic() + 60
    while time.monotonic() < until and len(list(state.glob("pair_*"))) < 2 and process.poll() is None:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert len(list(state.glob("pair_*"))) >= 2
    assert same(featreg.register_stack(series.images, **JOB, workers=1, resume=state), stack)


def test_images_on_one_grid(series: SimulatedSeries, stack: Stack, tmp_path: Path) -> None:
    arrays = stack.warp()
    assert arrays[3] is None
    inside = np.s_[30:-30, 30:-30]
    before = np.corrcoef(np.log(series.images[0][inside].ravel()), np.log(series.images[4][inside].ravel() + 1e-3))[
        0, 1
    ]
    after = np.corrcoef(np.log(arrays[0][inside].ravel()), np.log(arrays[4][inside].ravel() + 1e-3))[0, 1]
    assert after > before - 0.02
    files = stack.warp(tmp_path)
    assert [file is not None for file in files] == [True, True, True, False, True]
    assert np.allclose(featreg.as_image(files[4]).pixels[inside], arrays[4][inside], atol=1e-5)


def test_complex_images_stay_complex(series: SimulatedSeries, stack: Stack) -> None:
    phase = np.exp(1j * np.linspace(0, 1, 260)).astype(np.complex64)
    images = [image * phase for image in series.images]
    made = featreg.register_stack(images[:2], workers=1, **JOB)
    assert made.warp()[1].dtype == np.complex64


def test_a_file_gives_the_stack_back(stack: Stack, tmp_path: Path) -> None:
    stack.to_json(tmp_path / "stack.json")
    again = Stack.from_json(tmp_path / "stack.json")
    assert same(again, stack)
    assert again.to_dataframe().equals(stack.to_dataframe())
    # The file of a stack of arrays holds none of them.
    with pytest.raises(InputError, match="not at hand"):
        again.warp()
    for text in ('{"kind": "stack"}', "[" * 100_000):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(InputError, match="no stack of featreg"):
            Stack.from_json(tmp_path / "bad.json")
    whole = json.loads((tmp_path / "stack.json").read_text())
    damages: list[dict[str, Any]] = [
        {"reference": 9}, {"status": ["ok"]}, {"provenance": {}}, {"jumps": [[7, 1.0, 0.0]]},
    ]  # fmt: skip
    for wrong in damages:
        (tmp_path / "bad.json").write_text(json.dumps({**whole, **wrong}))
        with pytest.raises(InputError, match="no stack of featreg"):
            Stack.from_json(tmp_path / "bad.json")


def test_a_cube(stack: Stack) -> None:
    pytest.importorskip("xarray")
    cube = stack.to_xarray()
    assert cube["amplitude"].shape == (4, 260, 260)
    assert cube["date"].values.tolist() == ["image 0", "image 1", "image 2", "image 4"]


def test_what_runs_a_new_date_and_where_it_goes_is_checked(
    series: SimulatedSeries, stack: Stack, tmp_path: Path
) -> None:
    with pytest.raises(ParameterError, match="is_set"):
        stack.add(series.images[0], cancel=3)
    with pytest.raises(ParameterError, match="workers"):
        stack.add(series.images[0], workers=-1)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file': cannot be made"):
        stack.warp(tmp_path / "file")


def test_errors_say_what_would_be_right(series: SimulatedSeries) -> None:
    for wrong in ("abc", Path("abc"), 7):
        with pytest.raises(InputError, match="list of paths"):
            featreg.register_stack(wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="at least 2"):
        featreg.register_stack(series.images[:1])
    with pytest.raises(ParameterError, match="from 0 to 4"):
        featreg.register_stack(series.images, reference=7)
    with pytest.raises(ParameterError, match="'auto'"):
        featreg.register_stack(series.images, reference="best")
    with pytest.raises(ParameterError, match="secondary_band would mean"):
        featreg.register_stack(series.images, secondary_band="VV")


def test_a_cube_as_a_file(stack: Stack, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    stack.to_file(tmp_path / "cube.nc")
    with xarray.open_dataset(tmp_path / "cube.nc", engine="h5netcdf") as cube:
        assert cube["amplitude"].dims == ("date", "y", "x")
        assert np.allclose(cube["dx"].values, stack.to_dataframe()["dx"].dropna())
        assert np.array_equal(cube["amplitude"].values, stack.to_xarray()["amplitude"].values, equal_nan=True)
    with pytest.raises(InputError, match="must end in"):
        stack.to_file(tmp_path / "cube.tif")


@pytest.mark.parametrize("name", ["cube.nc", "cube.zarr"])
def test_a_complex_cube_in_its_place(series: SimulatedSeries, stack: Stack, name: str, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr" if name.endswith("zarr") else "h5netcdf")
    phase = np.exp(1j * np.linspace(0, 1, 260)).astype(np.complex64)
    place = Geolocation((10.0, 0.0, 500_000.0, 0.0, -10.0, 4_000_000.0), "EPSG:32633")
    images = [replace(featreg.as_image(image * phase), geolocation=place) for image in series.images]
    made = replace(stack, images=images)
    made.to_file(tmp_path / name)
    made.to_file(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    engine: Any = {"engine": "h5netcdf", "invalid_netcdf": True} if name.endswith("nc") else {"engine": "zarr"}
    with xarray.open_dataset(tmp_path / name, **engine) as cube:
        samples = cube["complex_samples"]
        assert samples.dtype == np.complex64
        assert samples.dims == ("date", "y", "x")
        whole = made.warp()[4]
        assert np.array_equal(samples.values[3], whole, equal_nan=True)
        assert cube["x"].values[0] == 500_005.0
        assert "32633" in str(cube["spatial_ref"].attrs["crs_wkt"])


def test_windows_make_the_whole(
    series: SimulatedSeries, stack: Stack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = stack.warp()
    monkeypatch.setattr("featreg.products.files.WINDOW", 100)
    read: list[tuple[int, int]] = []

    def watched(source: ImageSource, window: Window) -> Image:
        read.append(window.shape)
        return READ(source, window)

    monkeypatch.setattr(ImageSource, "read", watched)
    files = stack.warp(tmp_path)
    for path, values in zip(files, whole, strict=True):
        if path is not None:
            again = featreg.as_image(path)
            assert np.array_equal(again.mask, np.isfinite(values))
            assert np.allclose(again.pixels[again.mask], values[again.mask], atol=1e-3)
    assert max(max(shape) for shape in read) < 160


def test_options_survive_the_file(stack: Stack, tmp_path: Path) -> None:
    options: dict[str, Any] = {
        "method": "sar-orb", "model": "rigid", "seed": 0, "nodata": float("nan"), "scale": None,
        "initial": Affine(np.eye(3)[:2]), "threshold": np.float32(2.5), "margins": (1, 2),
        "focus": np.median,
    }  # fmt: skip
    made = replace(stack, provenance={**stack.provenance, "options": options})
    made.to_json(tmp_path / "stack.json")
    again = Stack.from_json(tmp_path / "stack.json")
    kept = dict(again.provenance["options"])
    assert np.isnan(kept.pop("nodata"))
    assert kept.pop("initial").parameters == options["initial"].parameters
    assert kept.pop("focus").name == "median"
    assert kept == {
        "method": "sar-orb",
        "model": "rigid",
        "seed": 0,
        "scale": None,
        "threshold": 2.5,
        "margins": [1, 2],
    }
    with pytest.raises(InputError, match="name of focus"):
        again.add(np.ones((64, 64)))


def test_finished_pairs_know_their_options_by_value() -> None:
    class Part:
        """Shown alike whatever it does."""

        def __init__(self, size: int) -> None:
            self.size = size

        def __repr__(self) -> str:
            return "Part"

    one, other = (_options_digest({"window": np.full(3, size)}) for size in (1, 2))
    assert one != other
    assert _options_digest({"window": np.full(3, 1)}) == one
    with pytest.raises(ParameterError, match="leave resume"):
        _options_digest({"part": Part(1)})
