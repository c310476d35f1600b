"""Sound files of every kind that featreg reads, for `fuzz.py` to damage.

Each is (kind, path, what reads it), or (kind, path, what reads it, the file beside it that is damaged).
"""

from __future__ import annotations

import json
import logging
import shutil
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import rasterio
import rasterio.shutil
from rasterio.control import GroundControlPoint
from rasterio.rpc import RPC
from rasterio.vrt import WarpedVRT
from scipy.io import netcdf_file, savemat
from scipy.sparse import csc_array

import featreg
from featreg.cli.explain import explain_file
from featreg.exports.formats import FORMATS, export, read_tie_points
from featreg.focusing.phase_history_files import read_phase_history
from featreg.geolocation.elevation_model import DemHeights
from featreg.io import as_image
from featreg.io.raster_source import Window, open_source
from featreg.io.rpc_file import write_rpc
from featreg.marking.points import MarkedPoints
from featreg.results.registration import Registration
from featreg.scene.blocks import Block
from featreg.scene.state import BlockFiles
from featreg.scene.task import BlockResult
from featreg.study.experiment import Experiment
from featreg.study.truth import read_truth
from featreg.types import Matches

Sound = tuple[str, Path, Callable[[Path], object]] | tuple[str, Path, Callable[[Path], object], Path]
SHAPE = (60, 80)
RNG = np.random.default_rng(0)
AMPLITUDE = RNG.gamma(4, 60, SHAPE).astype(np.uint16)
COMPLEX = (RNG.normal(0, 90, SHAPE) + 1j * RNG.normal(0, 90, SHAPE)).astype(np.complex64)
ONE = [1.0] + [0.0] * 19
PLACE: dict[str, Any] = {
    "line_off": 30.0, "samp_off": 40.0, "line_scale": 30.0, "samp_scale": 40.0, "lat_off": 41.0, "lat_scale": 0.1,
    "long_off": 15.0, "long_scale": 0.1, "height_off": 0.0, "height_scale": 100.0,
    "line_num_coeff": [0.0, 0.0, 1.0] + [0.0] * 17, "line_den_coeff": ONE,
    "samp_num_coeff": [0.0, 1.0] + [0.0] * 18, "samp_den_coeff": ONE,
}  # fmt: skip


def whole(path: Path) -> object:
    return as_image(path)


def windows(path: Path) -> object:
    source = open_source(path)
    return source.read(Window(5, 6, 40, 40)), source.overview(2)


def scenes(root: Path) -> Iterator[Sound]:
    """Images, read whole and by windows; masks, elevation models, RPC files, phase histories."""
    logging.getLogger("rasterio").setLevel(logging.CRITICAL)
    warnings.simplefilter("ignore")
    gcps = [GroundControlPoint(r, c, 10 + c / 1e3, 50 - r / 1e3, 30.0) for r in (0, 30, 59) for c in (0, 40, 79)]
    place = rasterio.transform.from_origin(15.0, 41.0, 1e-4, 1e-4)
    one, rpcs = {"height": SHAPE[0], "width": SHAPE[1], "count": 1}, RPC(**PLACE, err_bias=1.0, err_rand=1.0)
    tiled = {"tiled": True, "blockxsize": 32, "blockysize": 32}
    made: dict[str, tuple[dict[str, Any], Any]] = {
        "plain.tif": ({"dtype": "uint16", "crs": "EPSG:4326", "transform": place, "nodata": 0}, AMPLITUDE),
        "deflate.tif": ({"dtype": "float32", "compress": "deflate", "predictor": 3, **tiled}, AMPLITUDE / 7),
        "lzw.tif": ({"dtype": "uint16", "compress": "lzw", **tiled}, AMPLITUDE),
        "slc.tif": ({"dtype": "complex64"}, COMPLEX),
        "cint16.tif": ({"dtype": "complex_int16", "crs": "EPSG:4326", "gcps": gcps}, COMPLEX.round()),
        "rpc.tif": ({"dtype": "uint16", "rpcs": rpcs}, AMPLITUDE),
        "scene.ntf": ({"dtype": "uint16", "driver": "NITF", "rpcs": rpcs}, AMPLITUDE),
    }
    for name, (profile, samples) in made.items():
        path = _folder(root, name) / name
        with rasterio.open(path, "w", **{"driver": "GTiff", **one, **profile}) as dataset:
            dataset.write(samples.astype(np.complex64 if "complex" in profile["dtype"] else profile["dtype"]), 1)
        yield "images", path, whole
        yield "windows", path, windows
    yield from formats(root, place)
    gray = (AMPLITUDE // 4).clip(0, 255).astype(np.uint8)
    for name in ("gray.png", "gray.jpg", "gray.bmp"):
        path = _folder(root, name) / name
        cv2.imwrite(str(path), gray)
        yield "images", path, whole
    path = _folder(root, "array.npy") / "array.npy"
    np.save(path, COMPLEX)
    yield "images", path, whole
    yield "windows", path, windows
    path = _folder(root, "array.mat") / "array.mat"
    savemat(path, {"amplitude": AMPLITUDE, "note": "x"}, do_compression=True)
    yield "images", path, whole
    path = _folder(root, "plain.mat") / "plain.mat"
    cells = np.array([[1, "two", [3.0]]], object)
    held = {"z": COMPLEX, "cells": cells, "tree": {"a": {"b": 1.5}}, "sparse": csc_array(np.eye(3))}
    savemat(path, {"note": "x", **held, "flag": np.array([[True]])})
    yield "images", path, whole
    path = _folder(root, "mask") / "mask.png"
    cv2.imwrite(str(path), (gray > 30).astype(np.uint8) * 255)
    yield "masks", path, lambda file: as_image(AMPLITUDE, mask=file)
    path = _folder(root, "dem") / "dem.tif"
    profile = {"driver": "GTiff", **one, "dtype": "int16", "crs": "EPSG:4326", "transform": place, "nodata": -32768}
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(AMPLITUDE.astype(np.int16), 1)
    yield (
        "elevation models",
        path,
        lambda file: DemHeights(str(file)).at(np.array([[15.004, 40.996], [15.001, 40.999]])),
    )
    for name in ("scene_RPC.TXT", "scene.RPB"):
        path = _folder(root, name) / "scene.tif"
        with rasterio.open(path, "w", driver="GTiff", **one, dtype="uint16") as dataset:
            dataset.write(AMPLITUDE, 1)
        write_rpc(path.with_name(name), PLACE)
        yield "RPC files", path, whole, path.with_name(name)
    yield "phase histories", _history(root), read_phase_history


def formats(root: Path, place: Any) -> Iterator[Sound]:
    """Files of the formats that are told by what lies beside them, of datasets, products and archives."""
    one: dict[str, Any] = {"height": SHAPE[0], "width": SHAPE[1], "count": 1}
    where: dict[str, Any] = {"crs": "EPSG:4326", "transform": place}
    written: dict[str, tuple[str, Any, str]] = {
        "envi.dat": ("ENVI", COMPLEX, "envi.hdr"), "isce.slc": ("ISCE", COMPLEX, "isce.slc.xml"),
        "roi.slc": ("ROI_PAC", COMPLEX, "roi.slc.rsc"), "hfa.img": ("HFA", AMPLITUDE, ""),
        "mapper.ers": ("ERS", AMPLITUDE, ""), "esri.bil": ("EHdr", AMPLITUDE, "esri.hdr"),
        "pci.pix": ("PCIDSK", AMPLITUDE, ""), "wavelets.jp2": ("JP2OpenJPEG", AMPLITUDE, ""),
        "lines.gif": ("GIF", (AMPLITUDE // 4).clip(0, 255).astype(np.uint8), ""),
        "gray.pgm": ("PNM", AMPLITUDE, ""), "heights.asc": ("AAIGrid", AMPLITUDE.astype(np.int32), ""),
        "planet.vic": ("VICAR", AMPLITUDE.astype(np.float32), ""), "planet.cub": ("ISIS3", AMPLITUDE, ""),
        "label.xml": ("PDS4", AMPLITUDE, ""), "grid.sdat": ("SAGA", AMPLITUDE.astype(np.float32), "grid.sgrd"),
    }  # fmt: skip
    for name, (driver, samples, header) in written.items():
        path = _folder(root, name) / name
        with rasterio.open(path, "w", driver=driver, dtype=samples.dtype, **one, **where) as dataset:
            dataset.write(samples, 1)
        yield "formats", path, windows
        if header:
            yield "formats", path, windows, path.with_name(header)
    path = _folder(root, "a.vrt") / "a.vrt"
    with rasterio.open(path.with_suffix(".tif"), "w", driver="GTiff", dtype="uint16", **one, **where) as dataset:
        dataset.write(AMPLITUDE, 1)
    path.write_text(
        f'<VRTDataset rasterXSize="{SHAPE[1]}" rasterYSize="{SHAPE[0]}"><VRTRasterBand dataType="UInt16" band="1">'
        '<SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    yield "formats", path, windows
    yield "formats", path, whole, path.with_suffix(".tif")
    path = _folder(root, "w.vrt") / "w.vrt"
    with rasterio.open(path.with_suffix(".tif"), "w", driver="GTiff", dtype="uint16", **one, **where) as dataset:
        dataset.write(AMPLITUDE, 1)
    with rasterio.open(path.with_suffix(".tif")) as dataset, WarpedVRT(dataset, crs="EPSG:32633") as warped:
        rasterio.shutil.copy(warped, path, driver="VRT")
    yield "formats", path, windows
    path = root / "a-vrt" / "a.vrt"
    with zipfile.ZipFile(_folder(root, "p.zip") / "p.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(path.with_suffix(".tif"), "inside/a.tif")
    yield "formats", root / "p-zip" / "p.zip", windows
    safe = _folder(root, "s.safe")
    (safe / "manifest.safe").write_text('<X><fileLocation href="./measurement/s1a-iw-grd-vv-1-2.tiff"/></X>')
    (safe / "measurement").mkdir(exist_ok=True)
    shutil.copyfile(path.with_suffix(".tif"), safe / "measurement" / "s1a-iw-grd-vv-1-2.tiff")
    yield "formats", safe / "manifest.safe", windows
    yield from datasets(root)


def datasets(root: Path) -> Iterator[Sound]:
    """HDF5, netCDF and MATLAB 7.3."""
    x, y = 15 + 1e-4 * np.arange(SHAPE[1]), 41 - 1e-4 * np.arange(SHAPE[0])
    path = _folder(root, "a.h5") / "a.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("science/grids")
        group.create_dataset("HH", data=COMPLEX, chunks=(16, 16), compression="gzip")
        group["xCoordinates"], group["yCoordinates"], group["projection"] = x, y, np.int32(4326)
        file["title"] = "words"
    yield "formats", path, windows
    yield "formats", path, lambda file: as_image(f"{file}:/science/grids/HH")
    path = _folder(root, "a.nc") / "a.nc"
    with netcdf_file(path, "w") as made:
        for name, values in (("lat", y), ("lon", x)):
            made.createDimension(name, len(values))
            made.createVariable(name, "d", (name,))[:] = values
        made.createVariable("sigma0", "f", ("lat", "lon"))[:] = AMPLITUDE
    yield "formats", path, windows


def _history(root: Path) -> Path:
    turn, frequencies = np.linspace(0, 0.1, 12), np.linspace(9.3e9, 9.9e9, 8)
    x, y, z = 700 * np.cos(turn), 700 * np.sin(turn), np.full(12, 500.0)
    axes: dict[str, Any] = {"x": x[None], "y": y[None], "z": z[None], "r0": np.hypot(np.hypot(x, y), z)[None]}
    angles = {"th": np.rad2deg(turn)[None], "phi": np.full((1, 12), 35.0)}
    data = {"fp": np.ones((8, 12), np.complex64), "freq": frequencies[:, None], **axes, **angles}
    path = _folder(root, "history") / "data_3dsar_pass1_az001_HH.mat"
    savemat(path, {"data": data})
    return path


def results(root: Path) -> Iterator[Sound]:
    """Results, whole and with a table beside them, what `featreg focus` writes, and files of finished blocks."""
    result = registration(40)
    path = _folder(root, "result") / "result.json"
    result.to_json(path)
    yield "results", path, lambda file: _used(Registration.from_json(file))
    yield "results", path, lambda file: explain_file(file)
    path = _folder(root, "large") / "large.json"
    registration(21_000).to_json(path)
    yield "results", path, Registration.from_json, path.with_name("large.tie_points.parquet")
    gates = {"pulses": {"value": 9.0, "passed": True, "low": 8, "high": None, "meaning": "pulses"}}
    record = {
        "schema_version": 1,
        "method": "auto",
        "status": "ok",
        "reason": "",
        "gates": gates,
        "image_entropy": [9.0, 8.0],
    }
    path = _folder(root, "focus") / "focus.json"
    path.write_text(json.dumps(record, indent=1))
    yield "results", path, lambda file: explain_file(file)
    files = BlockFiles(_folder(root, "blocks"), "0" * 64)
    block = Block(0, 0, 0, Window(0, 0, 200, 200))
    files.save(
        block, BlockResult(0, "done", matches=result.matches, stages={"gms": result.inliers}, window=Window(0, 0, 9, 9))
    )
    # A damaged block is no error: it is computed again.
    yield "block files", files.path(block), lambda file: BlockFiles(file.parent, "0" * 64).load(block)


def _used(result: Registration) -> object:
    return result.explain(), result.residuals(), result.standard_errors, result.putative


def registration(count: int) -> Registration:
    here = np.random.default_rng(1).uniform(0, 300, (count, 2))
    there = here @ np.array([[1.01, 0.02], [-0.02, 0.99]]) + 3
    return featreg.fit(Matches(here, there, np.ones(count), np.tile(np.eye(2) * 0.01, (count, 1, 1))))


def tables(root: Path) -> Iterator[Sound]:
    """Tie points, marked points, truths and experiments."""
    result = registration(30)
    for name, to in (("t.csv", "csv"), ("t.parquet", "parquet"), ("t.points", "qgis"), ("t.pts", "envi")):
        assert to in FORMATS
        path = _folder(root, name) / name
        export(result, path, to=to)
        yield "tie points", path, read_tie_points
        if to != "parquet":
            yield (
                "marked points",
                path,
                lambda file: MarkedPoints(file, ("a.tif", "b.tif"), ((400, 400), (400, 400))).state(),
            )
            yield "truths", path, read_truth
    path = _folder(root, "t.npy") / "t.npy"
    np.save(path, np.hstack([result.matches.reference_xy, result.matches.secondary_xy]))
    yield "tie points", path, read_tie_points
    yield "truths", path, read_truth
    path = _folder(root, "truth.txt") / "truth.txt"
    np.savetxt(path, np.array([[1.01, 0.02, 3.0], [-0.02, 0.99, 3.0], [0.0, 0.0, 1.0]]))
    yield "truths", path, read_truth
    path = _folder(root, "truth.json") / "truth.json"
    result.to_json(path)
    yield "truths", path, read_truth
    methods = ["sar-orb", {"method": "orb", "n_features": 900}]
    more: dict[str, Any] = {"grid": {"n_features": [500, 1000]}, "protocol": {"threshold": 2.0}, "title": "t"}
    experiment = Experiment([("a.tif", "b.tif", "t.csv")], methods, seeds=(0, 1), **more)
    for name in ("e.yaml", "e.toml"):
        path = _folder(root, name) / name
        experiment.to_file(path)
        yield "experiments", path, lambda file: Experiment.from_file(file).labelled()


def _folder(root: Path, name: str) -> Path:
    """A folder for one file and what lies beside it."""
    folder = root / name.replace(".", "-")
    folder.mkdir(parents=True, exist_ok=True)
    return folder
