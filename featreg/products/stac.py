"""The STAC item of a product: what it shows, where and when, in one JSON file beside it.

References
----------
SpatioTemporal Asset Catalog 1.1.0, item specification; projection extension 2.0.0.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from featreg._version import __version__
from featreg.errors import InputError, ParameterError
from featreg.geolocation.footprint import footprint, geojson
from featreg.geolocation.geotransform import on_map
from featreg.io.writers import refuse_input, replacing
from featreg.results.registration import Registration
from featreg.types import Geolocation

VERSION = "1.1.0"
PROJECTION = "https://stac-extensions.github.io/projection/v2.0.0/schema.json"
COG = "image/tiff; application=geotiff; profile=cloud-optimized"


class SampleKind(NamedTuple):
    """What a product holds: in words, the dtype and nodata value of its samples, how many bands."""

    title: str
    dtype: str
    nodata: float | None
    bands: int = 1


def acquired(text: str) -> dict[str, Any]:
    """Return when a product was acquired as the properties of an item.

    Parameters
    ----------
    text : a moment of ISO 8601, or two with a slash between them; UTC where it names no zone

    Raises
    ------
    ParameterError
        It is neither, or the second moment lies before the first.
    """
    try:
        moments = [datetime.fromisoformat(part.strip()) for part in str(text).split("/")]
        known = [moment.replace(tzinfo=moment.tzinfo or UTC).astimezone(UTC) for moment in moments]
    except (ValueError, OverflowError):
        known = []
    if len(known) not in (1, 2):
        raise ParameterError(
            f"a STAC item says when its data were acquired: a moment as 2024-05-01T05:11:20Z is needed, or START/END, "
            f"got '{text}'"
        )
    if known[-1] < known[0]:
        raise ParameterError(f"'{text}' ends before it begins")
    said = [moment.isoformat().replace("+00:00", "Z") for moment in known]
    if len(said) == 1:
        return {"datetime": said[0]}
    return {"datetime": None, "start_datetime": said[0], "end_datetime": said[1]}


def item_path(product: Path) -> Path:
    """Return where the item of a product stands: beside it, under its name with .json."""
    return product.with_suffix(".json")


def write_item(
    product: Path,
    shape: tuple[int, int],
    geolocation: Geolocation | None,
    when: dict[str, Any],
    registration: Registration,
    samples: SampleKind,
    sources: Sequence[str] = (),
) -> Path:
    """Write the item of a product and return its path.

    Parameters
    ----------
    product : the GeoTIFF that was written
    shape : (H, W)
    geolocation : where it lies
    when : from `acquired`
    registration : by which it was made; its verdict stands in the item under ``featreg:``
    samples : what the product holds
    sources : the files that it was made from

    Raises
    ------
    InputError
        Nothing says where it lies, or the file cannot be written.
    """
    ring = footprint(geolocation, shape, str(product))
    geometry = geojson(ring, "Polygon")
    properties = {
        **when,
        **_projection(shape, geolocation),
        "featreg:version": __version__,
        "featreg:method": str(registration.provenance.get("method", "")),
        "featreg:status": registration.status,
        "featreg:reason": registration.reason,
    }
    band: dict[str, Any] = {"data_type": STAC_TYPES.get(samples.dtype, "other")}
    if samples.nodata is not None:
        # JSON knows no NaN; STAC spells it out.
        band["nodata"] = samples.nodata if np.isfinite(samples.nodata) else str(samples.nodata)
    names: list[dict[str, Any]] = [{"name": f"b{k + 1}", **band} for k in range(samples.bands)]
    asset = {"href": f"./{product.name}", "type": COG, "title": samples.title, "roles": ["data"], "bands": names}
    folder = product.parent
    links = [{"rel": "derived_from", "href": _relative(path, folder)} for path in sources]
    item = {
        "type": "Feature",
        "stac_version": VERSION,
        "stac_extensions": [PROJECTION],
        "id": product.stem,
        "geometry": geometry,
        "bbox": _box(geometry),
        "properties": properties,
        "links": links,
        "assets": {"data": asset},
    }
    target = item_path(product)
    with replacing(target, inputs=sources) as temporary:
        temporary.write_text(json.dumps(item, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    return target


#: Names of dtypes in STAC, where they differ from numpy's.
STAC_TYPES = {
    **{name: name for name in ("uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")},
    "complex64": "cfloat32",
}


def _projection(shape: tuple[int, int], geolocation: Geolocation | None) -> dict[str, Any]:
    """The fields of the projection extension; of slant geometry only the shape, with no coordinate system."""
    found: dict[str, Any] = {"proj:code": None, "proj:shape": list(shape)}
    if geolocation is None or geolocation.transform is None or geolocation.rpcs is not None or not geolocation.crs:
        return found
    from rasterio.crs import CRS

    crs = CRS.from_user_input(geolocation.crs)
    authority = crs.to_authority()
    if authority is None:
        found["proj:wkt2"] = crs.to_wkt(version="WKT2_2019")
    else:
        found["proj:code"] = ":".join(authority)
    height, width = shape
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float64) - 0.5
    ground = on_map(geolocation.transform, corners)
    return found | {
        "proj:transform": list(geolocation.transform),
        "proj:bbox": [*ground.min(axis=0).tolist(), *ground.max(axis=0).tolist()],
    }


def _box(geometry: dict[str, Any]) -> list[float]:
    """West, south, east, north; west is larger than east where the shape crosses the date line."""
    parts = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
    rings = [np.array(part[0]) for part in parts]
    south, north = (f([f(ring[:, 1]) for ring in rings]) for f in (min, max))
    if len(rings) == 1:
        return [float(rings[0][:, 0].min()), float(south), float(rings[0][:, 0].max()), float(north)]
    west = max(float(ring[:, 0].min()) for ring in rings)
    east = min(float(ring[:, 0].max()) for ring in rings)
    return [west, float(south), east, float(north)]


def _relative(path: str, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive
        return Path(path).absolute().as_uri()


def check_item(
    product: Path, geolocation: Geolocation | None, shape: tuple[int, int], name: str, inputs: Iterable[Any]
) -> None:
    """Raise where the item of a product could not be written, before the product is made.

    Raises
    ------
    InputError
        The grid `name` has no outline on the ground, or what stands where the item would is an input or no item.
    """
    try:
        footprint(geolocation, shape, name)
    except InputError as error:
        raise InputError(f"a STAC item needs a georeferenced reference ({error})") from error
    target = item_path(product)
    refuse_input(target, inputs)
    if target.is_file():
        try:
            mine = "stac_version" in json.loads(target.read_text(encoding="utf-8"))
        except (OSError, ValueError, TypeError):
            mine = False
        if not mine:
            raise InputError(f"{target}: is no STAC item, which would replace it; give the product another name")
