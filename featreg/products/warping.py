"""Products from file to file: the secondary on the reference grid, in windows, with bounded memory.

Windows go in order into a plain tiled TIFF, which is then copied to a cloud-optimised GeoTIFF and renamed into place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg._version import __version__
from featreg.errors import InputError, ParameterError, suggest
from featreg.io.bands import BandLike, listing
from featreg.io.calibration import check_calibration
from featreg.io.gdal_errors import quiet
from featreg.io.opening import open_reader
from featreg.io.raster_files import is_same
from featreg.io.raster_source import RasterSource, Window
from featreg.io.source_names import parse_source
from featreg.io.writers import refuse_input, replacing
from featreg.products.coherence import coherence as coherence_of
from featreg.products.coherence import window_size
from featreg.products.deramping import Ramp, ramp_of, warn_of_ramp
from featreg.products.files import Runner, bounded_cache, cloud_optimised, rasterio_window, tiled_tiff
from featreg.products.grid import Grid, grid_model, inputs_of, reference_grid
from featreg.products.rendering import Job
from featreg.products.resample import TAPS
from featreg.products.samples import Encoding, encoding_of
from featreg.products.stac import SampleKind, acquired, check_item, write_item
from featreg.products.tops_phase import TopsPhase
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.runtime.files import check_ending
from featreg.runtime.watching import Canceller, Progress


@dataclass(frozen=True)
class Product:
    """What `warp_file` wrote.

    Parameters
    ----------
    path : of the GeoTIFF
    shape : (H, W)
    dtype, nodata : of its samples; complex samples have no nodata value, they are nan+nanj
    bands : numbers of the secondary's bands it holds, in order
    georeferenced : whether it has the reference's georeferencing
    valid : share of pixels that are data in the first band
    ramp : the phase ramp that was taken out for the interpolation, if asked for: as the annotation of a TOPS image
        states it, else as its samples show it
    coherence : mean coherence with the reference over the scene, if asked for
    items : STAC items that were written beside the product and its coherence, if asked for
    """

    path: Path
    shape: tuple[int, int]
    dtype: str
    nodata: float | None
    bands: tuple[int, ...]
    georeferenced: bool
    valid: float
    ramp: Ramp | None = None
    coherence: float | None = None
    items: tuple[Path, ...] = ()


def warp_file(
    registration: Registration | str | Path,
    secondary: str | Path,
    output: str | Path,
    *,
    like: str | Path | tuple[int, int] | None = None,
    resampling: str = "lanczos",
    band: BandLike = None,
    scale: str | None = None,
    nodata: complex | None = None,
    calibrate: str | None = None,
    secondary_scale: float | tuple[float, float] | None = None,
    deramp: bool = False,
    coherence: str | Path | None = None,
    coherence_window: int | tuple[int, int] = 5,
    stac: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    cancel: Canceller | None = None,
) -> Product:
    """Write the secondary on the reference grid as a cloud-optimised GeoTIFF, scenes of any size in bounded memory.

    Parameters
    ----------
    registration : the result, or its JSON file; its model is used even when it is not trusted (a warning is logged)
    secondary : the secondary's file, or another file of the same footprint: more bands, another pixel size
    output : GeoTIFF to write, replaced if it exists; the file appears whole or not at all
    like : the reference, or a file of its footprint with another pixel size, or (H, W); default: the path in the result
    resampling : "nearest", "bilinear", "cubic" or "lanczos"
    band : the one band to warp: its number from 1, its name, "iq" or "rgb"; None for that of the result where the
        secondary is the file that was matched, else for all
    scale : what real samples are: "amplitude", "intensity" or "db"; default: as in the result, else told from them
    nodata : value of samples without data; default: as it was stated where the secondary is the file that was matched,
        else the file's own
    calibrate : "sigma0", "beta0" or "gamma0": the product holds this quantity, of complex samples those whose squared
        modulus it is; default: as in the result where the secondary is the file that was matched
    secondary_scale : pixels of this file per pixel of the secondary that was matched (one number, or along x and along
        y); default: told from georeferencing where both files have it, else from the sizes
    deramp : interpolate complex samples without their phase ramp and put it back: that of a Sentinel-1 TOPS image, all
        its bursts, by its annotation where that is there; else one is estimated from the samples, which a single smooth
        ramp must explain
    coherence : GeoTIFF to write the coherence with the reference to; both images must be complex
    coherence_window : of `featreg.coherence`
    stac : when the secondary was acquired (ISO 8601, UTC unless it names a zone; START/END for an interval): write a
        STAC item beside each product, under its name with ``.json``
    workers : threads; default: one per core, at most 8
    progress : called with (windows done, windows in all)
    cancel : an event that stops the work

    Returns
    -------
    Product

    Raises
    ------
    InputError
        No model, an unreadable file, another footprint, an output that is an input or cannot be written; a STAC item
        without georeferencing.
    ParameterError
        An unknown resampling or quantity, a band that the file lacks, `deramp` or `coherence` without complex samples.
    CancelledError
        `cancel` was set.

    Notes
    -----
    The product holds the user's own values: the dtype, the scale and the value for no data of the file
    (`featreg.products.samples.Encoding`). Intensity and decibels are interpolated as amplitude and turned back.
    Overviews are averages, of complex samples every n-th.
    """
    given = registration
    if isinstance(registration, str | Path):
        registration = Registration.from_json(registration, tie_points=False)
    if resampling not in TAPS:
        raise ParameterError(f"unknown resampling '{resampling}', {suggest(resampling, TAPS)}")
    secondary, output = str(secondary), Path(output)
    grid = reference_grid(registration, like)
    inputs = [secondary, grid.path, like if not isinstance(like, tuple) else None, *inputs_of(registration)]
    window_size(coherence_window)
    if coherence is not None and Path(coherence).absolute() == output.absolute():
        raise InputError(f"{coherence}: is also the output, the coherence needs a file of its own")
    targets = [Path(target) for target in (output, coherence) if target is not None]
    when = None if stac is None else acquired(stac)
    for target in targets:
        check_ending(target, ".tif", ".tiff")
        refuse_input(target, inputs)
        if when is not None:
            check_item(target, grid.geolocation, grid.shape, grid.path or "the reference", [*inputs, given])
    told = _recorded(registration.secondary, secondary)
    calibrate = told.get("calibrate") if calibrate is None else calibrate
    # What is calibrated is an amplitude, whatever the samples were.
    scale = told.get("scale") if scale is None and calibrate is None else scale
    nodata = told.get("nodata") if nodata is None else nodata
    if band is None and str(told.get("band") or "").startswith("iq"):
        band = told["band"]
    check_calibration(calibrate, scale)
    sources = _sources(secondary, band, scale, nodata, calibrate)
    wanted = (secondary_scale,) * 2 if isinstance(secondary_scale, int | float) else secondary_scale
    if wanted is not None and len(wanted) != 2:
        raise ParameterError(f"secondary_scale must be one number or two (along x, along y), got {secondary_scale}")
    model = grid_model(registration, grid, sources[0], wanted)
    if (deramp or coherence is not None) and not sources[0].is_complex:
        raise ParameterError(f"{secondary}: holds {sources[0].dtype} samples, deramp and coherence need complex ones")
    if coherence is not None and len(sources) > 1:
        raise ParameterError(f"{secondary}: has {len(sources)} bands, the coherence is that of one; give its number")
    partner = None if coherence is None else _partner(grid, registration)
    ramp = ramp_of(sources[0]) if deramp else None
    if not deramp and resampling != "nearest":
        warn_of_ramp(sources[0])
    encodings = [encoding_of(source) for source in sources]
    encodings = [replace(e, dtype=encodings[0].dtype, nodata=encodings[0].nodata) for e in encodings]
    job = Job(tuple(sources), tuple(encodings), model, resampling, ramp)
    runner = Runner(workers, progress, cancel)
    tags = {
        "TIFFTAG_SOFTWARE": f"featreg {__version__}",
        "FEATREG_STATUS": registration.status,
        "FEATREG_METHOD": str(registration.provenance.get("method", "")),
        "FEATREG_RESAMPLING": resampling,
    }
    if ramp is not None:
        tags["FEATREG_DERAMP"] = "annotation" if isinstance(ramp, TopsPhase) else "samples"
    names: list[str] = []
    if calibrate is not None:
        tags["FEATREG_CALIBRATION"] = calibrate
        names = [" ".join(filter(None, (calibrate, source.head.first.name))) for source in sources]
    first = encodings[0]
    flat = resampling == "nearest" or first.dtype == "complex64"
    good, mean = 0, None
    with replacing(output, inputs=inputs) as target, quiet(), bounded_cache():
        plain = target.with_name("plain.tif")
        with tiled_tiff(plain, grid, first, len(sources), tags, encodings, names) as dataset:
            for window, (arrays, count) in runner.run(job.render, grid.shape):
                dataset.write(arrays, window=rasterio_window(window))
                good += count
        if good == 0:
            raise InputError(
                f"{secondary}: holds no valid pixel within the reference (all are NaN, nodata or masked, or the model "
                "leads outside); check the file, the result and nodata"
            )
        if coherence is not None and partner is not None:
            mean = _write_coherence(plain, partner, Path(coherence), grid, coherence_window, runner, tags, inputs)
        cloud_optimised(plain, target, "NEAREST" if flat else "AVERAGE", first.dtype, runner.workers)
        plain.unlink()
    numbers = tuple(number + 1 for source in sources for number in source.head.choice.bands)
    share = good / (grid.shape[0] * grid.shape[1])
    located = grid.geolocation is not None
    items: list[Path] = []
    if when is not None:
        files = [path for path in (secondary, grid.path) if path is not None]
        kinds = [("the secondary on the grid of the reference", output, first.dtype, first.nodata, len(sources))]
        if coherence is not None:
            kinds.append(("coherence with the reference", Path(coherence), "float32", float("nan"), 1))
        for title, target, dtype, blank, bands in kinds:
            samples = SampleKind(title, dtype, blank, bands)
            items.append(write_item(target, grid.shape, grid.geolocation, when, registration, samples, files))
    return Product(output, grid.shape, first.dtype, first.nodata, numbers, located, share, ramp, mean, tuple(items))


def _sources(
    secondary: str, band: BandLike, scale: str | None, nodata: complex | None, calibrate: str | None
) -> list[RasterSource]:
    """The bands to warp: the one that is asked for or meant, else all of one size and kind."""
    reader = open_reader(secondary)
    try:
        bands = list(reader.bands)
    finally:
        reader.close()
    data = [i for i, known in enumerate(bands) if known.role != "alpha"]
    if band is not None or len(data) < 2 or parse_source(secondary).dataset is not None:
        return [RasterSource(secondary, scale, nodata, band, None, calibrate).checked()]
    kinds, sizes = {bands[i].dtype for i in data}, {bands[i].shape for i in data}
    if len(kinds) > 1 or len(sizes) > 1:
        what = "dtypes" if len(kinds) > 1 else "sizes"
        raise InputError(f"{secondary}: its bands are of several {what}; give one band: {listing(bands)}")
    return [RasterSource(secondary, scale, nodata, i + 1, None, calibrate).checked() for i in data]


def _recorded(known: InputImage | None, path: str) -> dict[str, Any]:
    """How an image of a result was read, where a path names its file; nothing of any other file."""
    return dict(known.reading) if known is not None and is_same(known.path, path) else {}


def _partner(grid: Grid, registration: Registration) -> RasterSource:
    if grid.path is None:
        raise InputError("the coherence needs the reference image; give its file as like")
    told = _recorded(registration.reference, grid.path)
    source = RasterSource(grid.path, nodata=told.get("nodata"), band=told.get("band"))
    if not source.is_complex:
        raise InputError(f"{grid.path}: the reference holds {source.dtype} samples, coherence needs complex ones")
    return source


def _write_coherence(
    aligned: Path,
    reference: RasterSource,
    output: Path,
    grid: Grid,
    side: int | tuple[int, int],
    runner: Runner,
    tags: dict[str, str],
    inputs: list[Any],
) -> float:
    """Write the coherence of an aligned product with the reference; return its mean."""
    other = RasterSource(str(aligned))
    margin = max(window_size(side)) // 2 + 1

    def work(window: Window) -> NDArray[np.float32]:
        around = window.grown(margin)
        found = coherence_of(reference.read(around), other.read(around), window=side)
        return found[margin:-margin, margin:-margin]

    total, count = 0.0, 0
    with replacing(output, inputs=inputs) as target:
        plain = target.with_name("plain.tif")
        first = Encoding("float32", float("nan"), "amplitude")
        with tiled_tiff(plain, grid, first, 1, tags | {"FEATREG_PRODUCT": "coherence"}) as dataset:
            for window, values in runner.run(work, grid.shape):
                dataset.write(values, 1, window=rasterio_window(window))
                known = np.isfinite(values)
                total, count = total + float(values[known].sum(dtype=np.float64)), count + int(known.sum())
        cloud_optimised(plain, target, "AVERAGE", "float32", runner.workers)
        plain.unlink()
    return total / count if count else float("nan")
