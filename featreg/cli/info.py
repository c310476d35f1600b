"""`featreg info`: what a file is, and what featreg will do with it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli.options import BandOption, CalibrateOption, NodataOption

if TYPE_CHECKING:
    from featreg.io.raster_source import RasterSource
    from featreg.types import BoolArray, FloatArray

#: Rows and columns of windows of the scene that are read for its mask and its looks, and their side.
WINDOWS, WINDOW = 3, 384


def info(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="File, product folder, archive or dataset.", show_default=False)
    ],
    band: BandOption = None,
    scale: Annotated[
        str | None,
        typer.Option(
            "--scale", metavar="SCALE", help="What the samples are: amplitude, intensity or db.",
            show_default="told from the samples",
        ),
    ] = None,
    calibrate: CalibrateOption = None,
    nodata: NodataOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:  # fmt: skip
    """Say what a file is and what featreg will do with it.

    Format, bands, size, what the samples are, looks, share of pixels without data, and where it lies and how well that
    is known. A file of several bands of which none is named is described too.
    """
    found = describe(file, band=band, scale=scale, calibrate=calibrate, nodata=nodata)
    if as_json:
        typer.echo(json.dumps(found, indent=1, allow_nan=False))
        return
    for name, value in found.items():
        if value is None or value == []:
            continue
        if name == "bands":
            typer.echo("bands")
            for i, one in enumerate(value, start=1):
                more = "".join(f", {one[k]}" for k in ("role", "states") if one[k])
                typer.echo(f"  {i}  {one['name'] or '-'}  {one['dtype']}, {one['width']} x {one['height']}{more}")
        else:
            typer.echo(f"{name.replace('_', ' '):<12} {_line(value)}")


def _line(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k.replace('_', ' ')} {_line(v)}" for k, v in value.items() if v not in (None, []))
    if isinstance(value, list):
        return " or ".join(map(str, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def describe(
    file: str,
    *,
    band: str | None = None,
    scale: str | None = None,
    calibrate: str | None = None,
    nodata: float | None = None,
) -> dict[str, Any]:
    """Describe a file.

    Returns
    -------
    A dict fit for JSON: ``file``, ``format``, ``bands`` [{name, dtype, width, height, role, states}], ``read`` (which
    band, None where one must be named), ``size`` {width, height}, ``samples`` {dtype, scale, told_by}, ``calibration``
    {possible, applied, note}, ``phase_ramp`` {kind, bursts, lines, cycles_per_line, note}, ``looks`` (the
    independent looks that the most even ground shows), ``without_data`` (share of pixels), ``place`` {kind,
    accuracy_px, pixel_x, pixel_y, unit, crs, centre_lon, centre_lat, note}, ``will`` (what a match does with it).

    Raises
    ------
    InputError
        The file cannot be read, or has no such band.
    """
    from featreg.errors import InputError
    from featreg.io.opening import open_reader
    from featreg.io.raster_source import open_source
    from featreg.io.scales import scale_of_words

    reader = open_reader(file)
    try:
        bands, driver = list(reader.bands), reader.driver
    finally:
        reader.close()
    listed = [
        {"name": b.name, "dtype": b.dtype, "width": b.shape[1], "height": b.shape[0]}
        | {"role": b.role, "states": scale_of_words(b.said) or ""}
        for b in bands
    ]
    found: dict[str, Any] = {"file": file, "format": driver, "bands": listed}
    try:
        source: RasterSource = open_source(file, band=band, scale=scale, calibrate=calibrate, nodata=nodata)  # type: ignore[assignment]  # of a path it is one
    except InputError as error:
        if band is not None or len(bands) < 2:
            raise
        return found | {"read": None, "will": f"not be read as it is: {error}"}
    image, mask = _sampled(source)
    looks = _looks(image, mask)
    head = source.head
    choice = {"one": "", "luminance": "luminance of red, green and blue", "iq": "complex samples of I and Q"}
    told = "stated" if scale else "its samples"
    if not scale and scale_of_words(head.first.said) == source.known_scale:
        told = "the name of the file" if head.first.said_by_file else "its names and units"
    told = "its dtype" if source.is_complex else told
    return found | {
        "read": choice[head.choice.how] or head.first.name or f"band {head.choice.bands[0] + 1}",
        "size": {"width": source.shape[1], "height": source.shape[0]},
        "samples": {"dtype": source.dtype, "scale": source.known_scale, "told_by": told},
        "calibration": _calibration(file, head.choice.bands[0], calibrate),
        "phase_ramp": _phase_ramp(file, head.choice.bands[0], source.shape[1]) if source.is_complex else None,
        "looks": looks,
        "without_data": round(1.0 - float(mask.mean()), 4) if mask.size else None,
        "place": _place(source),
        "will": _will(source),
    }


def _calibration(file: str, band: int, applied: str | None) -> dict[str, Any] | None:
    """What a band can be calibrated to; None where its file says nothing of it."""
    from featreg.errors import InputError
    from featreg.io.calibration import calibration_of
    from featreg.io.opening import open_reader

    reader = open_reader(file)
    try:
        known = calibration_of(reader, band)
    except InputError as error:
        return {"possible": [], "applied": applied, "note": str(error).removeprefix(f"{file}: ")}
    finally:
        reader.close()
    if known is None:
        return None
    return {"possible": list(known.factors), "applied": applied, "note": "thermal noise is left in"}


def _phase_ramp(file: str, band: int, width: int) -> dict[str, Any] | None:
    """What a product states of the phase of its samples; None where it states nothing."""
    from featreg.errors import InputError
    from featreg.io.opening import open_reader
    from featreg.io.products.sentinel1_tops import tops_of
    from featreg.products.tops_phase import TopsPhase

    reader = open_reader(file)
    try:
        terms = tops_of(reader, band)
    except InputError as error:
        return {"kind": "unknown", "note": str(error).removeprefix(f"{file}: ")}
    finally:
        reader.close()
    if terms is None:
        return None
    found = TopsPhase(terms)
    return {
        "kind": "TOPS",
        "bursts": found.bursts,
        "lines": terms.lines,
        "cycles_per_line": round(found.steepest(width), 2),
        "note": "warp needs --deramp",
    }


def _sampled(source: RasterSource) -> tuple[FloatArray, BoolArray]:
    """Amplitude and mask of some windows of the scene, one above the other."""
    import numpy as np

    from featreg.io.window import Window

    height, width = source.shape
    h, w = min(height, WINDOW), min(width, WINDOW)
    tops = np.unique(np.linspace(0, height - h, WINDOWS).astype(int)).tolist()
    lefts = np.unique(np.linspace(0, width - w, WINDOWS).astype(int)).tolist()
    parts = [source.read(Window(x, y, w, h)) for y in tops for x in lefts]
    amplitude = np.concatenate([part.amplitude for part in parts]).astype(np.float64)
    return amplitude, np.concatenate([part.mask for part in parts])


def _looks(amplitude: FloatArray, mask: BoolArray) -> float | None:
    """As `featreg.sar.speckle.equivalent_looks`; None where nothing shows speckle."""
    import numpy as np

    from featreg.sar.speckle import equivalent_looks
    from featreg.types import Image, read_only

    if not mask.any():
        return None
    looks = equivalent_looks(Image(read_only(amplitude.astype(np.float32)), read_only(mask)))
    return round(looks, 2) if np.isfinite(looks) else None


def _place(source: RasterSource) -> dict[str, Any] | None:
    import numpy as np

    from featreg.errors import FeatregError
    from featreg.geolocation import ground_level, sensor_of
    from featreg.geolocation.pixel_size import pixel_size

    known = source.geolocation
    if known is None:
        return None
    made: dict[str, Any] = {"kind": "geotransform" if known.transform is not None else "unknown", "accuracy_px": None}
    size = pixel_size(known)
    if size is not None:
        made |= {"pixel_x": float(f"{size.x:.8g}"), "pixel_y": float(f"{size.y:.8g}"), "unit": size.unit}
    try:
        sensor = sensor_of(known, source.shape, source.name)
        centre = np.array([[(source.shape[1] - 1) / 2, (source.shape[0] - 1) / 2]])
        level, whence = ground_level(sensor)
        lon, lat = sensor.image_to_ground(centre, np.array([level]))[0]
        made |= {"kind": KINDS.get(type(sensor).__name__, type(sensor).__name__)}
        made |= {"accuracy_px": round(float(sensor.uncertainty_px), 3)}
        made |= {"centre_lon": round(float(lon), 6), "centre_lat": round(float(lat), 6)}
        made |= {"ground_level_m": round(float(level), 1), "level_from": whence}
    except FeatregError as error:
        made["note"] = str(error).removeprefix(f"{source.name}: ")
    made["crs"] = _crs(known.crs)
    return {
        name: None if isinstance(value, float) and not np.isfinite(value) else value for name, value in made.items()
    }


KINDS = {
    "GeotransformSensor": "geotransform",
    "GcpSensor": "ground control points",
    "RpcSensor": "rational polynomial coefficients",
    "SicdSensor": "projection of the SICD",
    "SiddSensor": "grid of the SIDD",
    "RangeDopplerSensor": "orbit and timing (range-Doppler)",
}


def _crs(text: str | None) -> str | None:
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        return None if not text else str(CRS.from_user_input(text).to_string())[:80]
    except CRSError:
        return text[:80] if text else None


def _will(source: RasterSource) -> str:
    from featreg.matching import MOST_PIXELS

    height, width = source.shape
    large = height * width > MOST_PIXELS
    how = "match it in blocks" if large else "match it whole, unless its partner is large"
    where = "" if not large else (
        ", from where both files say they lie" if source.geolocation is not None else ", from a match of the overviews"
    )  # fmt: skip
    what = {
        "complex": "the amplitude of its complex samples",
        "intensity": "the root of its intensities",
        "db": "amplitudes from its decibels",
        "amplitude": "its samples as amplitudes",
    }[source.known_scale]
    return f"take {what} and {how}{where}"
