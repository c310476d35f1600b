"""Sensors from the metadata of products that the test writes: Capella's JSON, NISAR's HDF5, archives of Sentinel-1."""

from __future__ import annotations

import contextlib
import json
import logging
import re
import warnings
import zipfile
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from featreg.errors import InputError
from featreg.geolocation import RangeDopplerSensor, SicdSensor, sensor_from_dict, sensor_of
from featreg.io.ellipsoid import earth_fixed
from featreg.io.products.capella import sensor_of_capella
from featreg.io.products.nisar import sensor_of_nisar
from featreg.io.products.stated import stated_sensor
from featreg.io.products.vectors import seconds, thinned
from featreg.io.raster_source import Window, open_source
from featreg.simulate.orbit import RangeDoppler
from featreg.simulate.sicd import write_sicd

SHAPE = (900, 1200)
POINTS = np.random.default_rng(0).uniform(0, [SHAPE[1], SHAPE[0]], (30, 2))


def exact() -> RangeDoppler:
    return RangeDoppler.over((12.0, 47.0), SHAPE, incidence_deg=35.0, heading_deg=-12.0, pixel=1.0, height=400.0)


def stamp(time: float) -> str:
    """A time of the simulated orbit in nanoseconds, as Capella writes it."""
    whole = round(time * 1e9)
    moment = datetime(2024, 5, 6, 7, 8, 9) + timedelta(seconds=whole // 10**9)
    return f"{moment.isoformat()}.{whole % 10**9:09d}Z"


def capella(**changes: Any) -> str:
    o = exact().sensor(SHAPE, 400.0)
    centre = earth_fixed(np.array([[12.0, 47.0]]), np.array([400.0]))[0]
    vectors = [
        {"time": stamp(t), "position": p, "velocity": v}
        for t, p, v in zip(o.times.tolist(), o.positions.tolist(), o.velocities.tolist(), strict=True)
    ]
    geometry = {
        "type": "slant_plane",
        "doppler_centroid_polynomial": {"type": "standard", "degree": [0, 0], "coefficients": [[0.0]]},
        "first_line_time": stamp(o.first_line_time),
        "delta_line_time": o.line_interval,
        "range_to_first_sample": o.near_range,
        "delta_range_sample": o.range_spacing,
    } | changes
    image = {"rows": SHAPE[0], "columns": SHAPE[1], "image_geometry": geometry}
    image["center_pixel"] = {"target_position": centre.tolist()}
    state = {"coordinate_system": {"type": "ecef"}, "state_vectors": vectors}
    return json.dumps({"collect": {"image": image, "state": state, "radar": {"pointing": "right"}}})


def agrees(values: Any, atol: float = 2e-5) -> None:
    """A sensor of these values sees ground points where the simulated orbit does; a nanosecond is 1e-5 px."""
    sensor = sensor_from_dict(values)
    for height in (0.0, 3000.0):
        ground = exact().image_to_ground(POINTS, height)
        np.testing.assert_allclose(sensor.ground_to_image(ground, height), POINTS, atol=atol)


class TestCapella:
    def test_json_of_the_tag(self) -> None:
        values = stated_sensor("scene.tif", {"TIFFTAG_IMAGEDESCRIPTION": capella()}, SHAPE)
        assert values is not None
        agrees(values)
        assert values["ground_m"] == pytest.approx(400.0, abs=0.01)

    @pytest.mark.parametrize("name", ["scene.json", "scene_extended.json"])
    def test_json_beside_the_image(self, tmp_path: Path, name: str) -> None:
        (tmp_path / name).write_text(capella())
        agrees(stated_sensor(str(tmp_path / "scene.tif"), {}, SHAPE))

    @pytest.mark.parametrize(
        "changes",
        [{"type": "pfa"}, {"type": "geotransform"}, {"doppler_centroid_polynomial": {"coefficients": [[120.0, 1.0]]}}],
    )
    def test_images_of_another_geometry(self, changes: dict[str, Any]) -> None:
        assert sensor_of_capella(capella(**changes), "scene.tif") is None

    def test_broken(self, caplog: pytest.LogCaptureFixture) -> None:
        with pytest.raises(InputError, match=r"scene\.tif: its metadata"):
            sensor_of_capella(capella(first_line_time="once"), "scene.tif")
        with caplog.at_level(logging.WARNING):
            assert stated_sensor("a.tif", {"TIFFTAG_IMAGEDESCRIPTION": '{"collect": {}}'}, SHAPE) is None
        assert "cannot be used" in caplog.text

    @pytest.mark.parametrize(
        "text", ['{"collect": ' * 3000, '{"collect": {"image": {"image_geometry": []}}}', '{"collect"']
    )
    def test_nonsense_is_left_out(self, text: str) -> None:
        assert stated_sensor("a.tif", {"TIFFTAG_IMAGEDESCRIPTION": text}, SHAPE) is None

    def test_a_part_that_was_cut_out(self, caplog: pytest.LogCaptureFixture) -> None:
        with caplog.at_level(logging.WARNING):
            assert stated_sensor("a.tif", {"TIFFTAG_IMAGEDESCRIPTION": capella()}, (100, 100)) is None
        assert "describe 1200 x 900" in caplog.text

    def test_other_files(self, tmp_path: Path) -> None:
        assert stated_sensor(str(tmp_path / "a.tif"), {"TIFFTAG_IMAGEDESCRIPTION": "a picture"}, SHAPE) is None
        (tmp_path / "a.json").write_text('{"type": "FeatureCollection"}')
        assert stated_sensor(str(tmp_path / "a.tif"), {}, SHAPE) is None


class TestSentinel1:
    def test_in_a_folder_and_in_an_archive(self, tmp_path: Path, annotation: Any) -> None:
        folder = tmp_path / "S1A.SAFE"
        (folder / "annotation").mkdir(parents=True)
        (folder / "annotation" / "s1a-vv.xml").write_text(annotation("stripmap")[0])
        plain = stated_sensor(str(folder / "measurement" / "s1a-vv.tiff"), {}, SHAPE)
        assert plain is not None
        with zipfile.ZipFile(tmp_path / "S1A.zip", "w") as archive:
            archive.write(folder / "annotation" / "s1a-vv.xml", "S1A.SAFE/annotation/s1a-vv.xml")
        inside = f"/vsizip/{tmp_path}/S1A.zip/S1A.SAFE/measurement/s1a-vv.tiff"
        assert stated_sensor(inside, {}, SHAPE) == plain
        braced = f"/vsizip/{{{tmp_path}/S1A.zip}}/S1A.SAFE/measurement/s1a-vv.tiff"
        assert stated_sensor(braced, {}, SHAPE) == plain
        assert stated_sensor(inside.replace("s1a-vv", "other"), {}, SHAPE) is None
        assert stated_sensor(str(folder / "measurement" / "other.tiff"), {}, SHAPE) is None

    @pytest.mark.parametrize("number", ["inf", "nan", "1e400", "-1", "x"])
    def test_numbers_that_no_image_has(self, tmp_path: Path, annotation: Any, number: str) -> None:
        folder = tmp_path / "S1A.SAFE"
        (folder / "annotation").mkdir(parents=True)
        text = annotation("tops")[0]
        for name in ("numberOfSamples", "linesPerBurst", "azimuthTimeInterval"):
            changed = re.sub(f"<{name}>[^<]*<", f"<{name}>{number}<", text)
            (folder / "annotation" / "s1a-vv.xml").write_text(changed)
            found = stated_sensor(str(folder / "measurement" / "s1a-vv.tiff"), {}, SHAPE)
            if found is not None:
                with contextlib.suppress(InputError):  # that is what may be said of them; nothing else may be raised
                    assert sensor_from_dict(found).ground_to_image(np.array([[12.0, 47.0]]), 0.0).shape == (1, 2)

    def test_an_image_of_the_product_is_located_by_it(self, tmp_path: Path, annotation: Any) -> None:
        folder = tmp_path / "S1A.SAFE"
        for name in ("annotation", "measurement"):
            (folder / name).mkdir(parents=True)
        (folder / "annotation" / "s1a-vv.xml").write_text(annotation("grd")[0])
        path = folder / "measurement" / "s1a-vv.tiff"
        profile: dict[str, Any] = {"driver": "GTiff", "height": SHAPE[0], "width": SHAPE[1], "count": 1}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with rasterio.open(path, "w", dtype="uint16", **profile) as dataset:
                dataset.write(np.ones(SHAPE, np.uint16), 1)
        place = open_source(path).geolocation
        assert isinstance(sensor_of(place, SHAPE, "image"), RangeDopplerSensor)


class TestNisar:
    @pytest.fixture
    def path(self, tmp_path: Path) -> Path:
        h5py = pytest.importorskip("h5py")
        o = exact().sensor(SHAPE, 400.0)
        path = tmp_path / "rslc.h5"
        with h5py.File(path, "w") as file:
            root = file.create_group("science/LSAR")
            root["identification/lookDirection"] = np.bytes_("Right")
            swaths = root.create_group("RSLC/swaths")
            lines = swaths.create_dataset(
                "zeroDopplerTime", data=100 + o.first_line_time + np.arange(SHAPE[0]) * o.line_interval
            )
            lines.attrs["units"] = np.bytes_("seconds since 2024-05-06T07:06:29")
            own = swaths.create_group("frequencyA")
            own["slantRange"] = o.near_range + np.arange(SHAPE[1]) * o.range_spacing
            own["HH"] = np.ones(SHAPE, np.complex64)
            orbit = root.create_group("RSLC/metadata/orbit")
            times = orbit.create_dataset("time", data=o.times)
            times.attrs["units"] = "seconds since 2024-05-06 07:08:09"
            orbit["position"], orbit["velocity"] = o.positions, o.velocities
        return path

    def test_orbit_and_timing(self, path: Path) -> None:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path) as file:
            agrees(sensor_of_nisar(file, "/science/LSAR/RSLC/swaths/frequencyA/HH"))
            assert sensor_of_nisar(file, "/science/LSAR/RSLC/swaths/zeroDopplerTime") is None
            with pytest.raises(InputError, match="lacks what says where it lies"):
                sensor_of_nisar(file, "/science/LSAR/RSLC/swaths/frequencyB/HH")

    def test_no_link_leads_to_another_file(self, path: Path, tmp_path: Path) -> None:
        h5py = pytest.importorskip("h5py")
        name = "science/LSAR/RSLC/metadata/orbit"
        with h5py.File(path, "a") as file, h5py.File(tmp_path / "other.h5", "w") as other:
            file.copy(file[name], other, "orbit")
            del file[name]
            file[name] = h5py.ExternalLink("other.h5", "orbit")
        with h5py.File(path) as file, pytest.raises(InputError, match="not in the file itself"):
            sensor_of_nisar(file, "/science/LSAR/RSLC/swaths/frequencyA/HH")

    def test_a_part_that_was_cut_out(self, path: Path, caplog: pytest.LogCaptureFixture) -> None:
        h5py = pytest.importorskip("h5py")
        name = "science/LSAR/RSLC/swaths/frequencyA/HH"
        with h5py.File(path, "a") as file:
            del file[name]
            file[name] = np.ones((100, 90), np.complex64)
        assert open_source(f"{path}:/{name}").geolocation is None
        assert "another size" in caplog.text

    def test_the_file_is_located_by_it(self, path: Path) -> None:
        source = open_source(f"{path}:/science/LSAR/RSLC/swaths/frequencyA/HH")
        assert source.shape == SHAPE
        assert source.geolocation is not None
        agrees(source.geolocation.sensor)


def test_a_sicd_is_read_in_windows_with_its_projection(tmp_path: Path) -> None:
    pytest.importorskip("sarkit")
    rng = np.random.default_rng(0)
    samples = (rng.normal(size=(80, 60)) + 1j * rng.normal(size=(80, 60))).astype(np.complex64)
    view = RangeDoppler.over((12.0, 47.0), (80, 60), incidence_deg=35.0, heading_deg=-12.0, pixel=3.0, height=400.0)
    write_sicd(tmp_path / "scene.nitf", samples, view, 400.0)
    source = open_source(tmp_path / "scene.nitf")
    # Rows of a SICD are range, which runs along x in the simulation.
    assert source.shape == (60, 80)
    np.testing.assert_array_equal(source.read(Window(7, 5, 40, 30)).pixels, samples.T[5:35, 7:47])
    sensor = sensor_of(source.geolocation, source.shape, "scene")
    assert isinstance(sensor, SicdSensor)
    points = np.array([[0.0, 0.0], [79.0, 59.0], [30.5, 20.25]])
    for height in (0.0, 3000.0):
        ground = view.image_to_ground(points[:, ::-1], height)
        np.testing.assert_allclose(sensor.ground_to_image(ground, height), points, atol=1e-3)


def test_state_vectors_around_an_image() -> None:
    times = np.arange(-1000.0, 1000.0)
    kept = thinned(times, 0.0, 10.0)
    assert times[kept][[0, -1]].tolist() == [-5.0, 14.0]
    many = thinned(np.arange(-10.0, 1000.0, 0.1), 0.0, 900.0)
    assert len(many) == 120
    np.testing.assert_allclose(seconds(["2024-01-01T00:00:01.5Z"], "2024-01-01T00:00:00.000000001"), [1.499999999])
