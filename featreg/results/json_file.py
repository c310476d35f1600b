"""The JSON of a registration: written whole, read back whole.

Layout (schema version 1)
-------------------------
One object: ``schema_version, method, status, reason, gates, seed, reference, secondary, model, counts, blocks, timings,
provenance, tie_points``. Points are (x, y) in pixels, the centre of the first pixel is (0, 0). ``nan`` and ``inf`` are
written as null. Relative paths count from ``provenance.folder``, as seen from the file's own, where there is one.
`reference` and `secondary` hold path, width and height (null where the images are not known) and, where known, scale,
dtype, valid_pixels, pixel_size {x, y, unit} and geolocation {transform, crs, rpcs, gcps}. `counts`
lists the filters in the order in which they ran. The column `stage` is how many filters, from the first on, a tie point
survived; a mask that does not follow from it (that of a refinement, whose points are not in the stages before it)
stands packed in ``tie_points.masks`` (base64 of `numpy.packbits`). Where no model could be fitted `model` is null and
`model_failure` says why. More than 20 000 tie points stand in a Parquet file beside the JSON.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from featreg.errors import InputError
from featreg.geometry import model_from_dict, model_to_dict
from featreg.interfaces import FailedFit, Model
from featreg.results.input_image import InputImage
from featreg.results.tie_point_table import (
    columns_of,
    no_columns,
    packed_masks,
    parquet_of,
    read_columns,
    read_stages,
    rows_of,
    stage_of,
    table_of,
    tuples_of,
    whole_numbers,
)
from featreg.runtime.digests import digest_bytes
from featreg.runtime.files import check_ending, folder_of, is_stream, write_atomic
from featreg.types import BoolArray, Gate, Matches

if TYPE_CHECKING:
    from featreg.results.registration import Registration

SCHEMA_VERSION = 1
#: Most tie points that stand in the JSON itself.
MAX_ROWS = 20_000
BLOCK_COUNTS = ("total", "computed", "reused", "skipped", "failed")
RESERVED = ("putative", "inliers")

R = TypeVar("R")


def plain(value: Any) -> Any:
    """Return `value` in the types of JSON: numpy scalars, tuples, paths, models, dataclasses converted, NaN as None."""
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, set | frozenset):
        return sorted((plain(v) for v in value), key=str)
    if isinstance(value, Model):
        return plain(model_to_dict(value))
    if isinstance(value, Gate):
        return plain(value.to_dict())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, type) or callable(value):
        return getattr(value, "__qualname__", type(value).__qualname__)
    text = str(value)
    # An address in memory would make two writings of one result differ.
    return type(value).__qualname__ if " at 0x" in text else text


def registration_to_dict(registration: Registration) -> dict[str, Any]:
    """Return the object that `write_registration` writes, every tie point in it, in plain Python values."""
    stage = stage_of(registration)
    columns = columns_of(registration, stage)
    return {**_head(registration), "tie_points": table_of(columns, packed_masks(registration, stage), rows_of(columns))}


def write_registration(registration: Registration, path: str | Path) -> None:
    """Write a registration as JSON; beyond 20 000 tie points these go to ``<name>.tie_points.parquet`` beside it.

    Each file appears whole or not at all, the Parquet file first. Equal registrations give equal bytes.
    A pipe or terminal as `path` gets every tie point itself.

    Raises
    ------
    InputError
        The file cannot be written, or a filter is called "putative" or "inliers".
    """
    check_ending(path, ".json")
    path = Path(path)
    # A pipe has no place beside it.
    if len(registration.matches) > MAX_ROWS and not is_stream(path):
        stage = stage_of(registration)
        columns, masks, head = columns_of(registration, stage), packed_masks(registration, stage), _head(registration)
        head["provenance"] |= _folder(registration, path)
        beside = tie_point_file(path)
        content = parquet_of(columns)
        write_atomic(beside, content)
        table = {"file": beside.name, "columns": list(columns), "sha256": digest_bytes(content)}
        text = _layout({**head, "tie_points": table | ({"masks": masks} if masks else {})}) + "\n"
    else:
        text = registration_text(registration, _folder(registration, path))
    # A name of a file that is no UTF-8 stands as JSON's escapes of its bytes.
    write_atomic(path, text.encode(errors="backslashreplace"))


def registration_text(registration: Registration, provenance: Mapping[str, Any] | None = None) -> str:
    """Return what `write_registration` writes into a pipe: every tie point in it; `provenance` is added to its own."""
    stage = stage_of(registration)
    columns, masks, head = columns_of(registration, stage), packed_masks(registration, stage), _head(registration)
    head["provenance"] |= provenance or {}
    # The rows are encoded in one go, one tie point a line: a general pretty printer would take seconds.
    rows = json.dumps(tuples_of(columns), separators=(",", ":"), allow_nan=False).replace("],[", "],\n      [")
    slot = uuid.uuid4().hex
    text = _layout({**head, "tie_points": table_of(columns, masks, slot)})
    return text.replace(f'"{slot}"', rows.replace("[[", "[\n      [", 1)) + "\n"


def tie_point_file(path: Path) -> Path:
    """Return the file beside a result in which its tie points stand where they are many."""
    return path.with_name(f"{path.stem}.tie_points.parquet")


def read_registration(path: str | Path, make: Callable[..., R], *, tie_points: bool = True) -> R:
    """Read what `write_registration` wrote.

    Parameters
    ----------
    path : of the JSON file
    make : makes the result of the fields of a `Registration`, as keywords
    tie_points : False leaves out those that stand in a file of their own, which then need not be there

    Raises
    ------
    InputError
        The file is missing, truncated, of another schema version or no result of featreg.
    """
    path = Path(path)
    try:
        return make(**_fields(json.loads(path.read_text(encoding="utf-8")), path.parent, tie_points))
    except OSError as error:
        raise InputError(f"cannot read '{error.filename or path}': {error.strerror}") from error
    except KeyError as error:
        raise InputError(f"'{path}' is not a featreg result: {error.args[0]} is missing") from error
    except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"'{path}' is not a whole featreg result: {why}") from error


def _head(registration: Registration) -> dict[str, Any]:
    """Everything but the tie points, in the order of the file."""
    provenance = {k: v for k, v in registration.provenance.items() if k != "tie_point_blocks"}
    blocks = provenance.get("blocks") or {}
    for name in registration.stages:
        if name in RESERVED:
            raise InputError(f"a filter cannot be called '{name}': the result counts the {name} tie points under it")
    model = registration.model
    return {
        "schema_version": SCHEMA_VERSION,
        "method": plain(provenance.get("method")),
        "status": registration.status,
        "reason": registration.reason,
        "gates": plain(registration.gates),
        "seed": plain(provenance.get("seed")),
        "reference": _image(registration.reference),
        "secondary": _image(registration.secondary),
        "model": None if isinstance(model, FailedFit) else {**plain(model), **plain(registration.standard_errors)},
        **({"model_failure": model.reason} if isinstance(model, FailedFit) else {}),
        "counts": {
            "putative": int(registration.putative.sum()),
            **{name: int(mask.sum()) for name, mask in registration.stages.items()},
            "inliers": int(registration.inliers.sum()),
        },
        "blocks": {key: int(blocks.get(key, 0)) for key in BLOCK_COUNTS},
        "timings": plain(registration.timings),
        "provenance": plain(provenance),
    }


def _folder(registration: Registration, path: Path) -> dict[str, str]:
    """Where relative paths of images count from, where that is not the folder of the result."""
    paths = [image.path for image in (registration.reference, registration.secondary) if image is not None]
    if is_stream(path) or not any(not os.path.isabs(p) and os.path.exists(p) for p in paths):
        return {}
    try:
        folder = Path(os.path.relpath(os.curdir, folder_of(path))).as_posix()
    except ValueError:  # another drive
        return {}
    return {} if folder == "." else {"folder": folder}


def _found(image: InputImage | None, data: Mapping[str, Any], folder: Path) -> InputImage | None:
    """The image with a path that leads to its file from here, where one does."""
    if image is None or os.path.isabs(image.path) or image.path == "array":
        return image
    for candidate in (folder / str(data["provenance"].get("folder", ".")) / image.path, folder / image.path):
        if candidate.is_file():
            here = Path(image.path)
            same = here.is_file() and here.samefile(candidate)
            return image if same else dataclasses.replace(image, path=os.path.normpath(candidate))
    return image


def _image(image: InputImage | None) -> dict[str, Any]:
    return dict.fromkeys(("path", "width", "height")) if image is None else plain(image.to_dict())


def _layout(value: Any, indent: int = 0) -> str:
    """JSON with short objects and all innermost lists on one line."""
    flat = json.dumps(value, allow_nan=False, ensure_ascii=False)
    if not isinstance(value, dict | list) or len(flat) + indent <= 110 or not value:
        return flat
    pad = "\n" + " " * (indent + 2)
    if isinstance(value, list):
        if not any(isinstance(v, dict | list) for v in value):
            return flat
        return "[" + ",".join(pad + _layout(v, indent + 2) for v in value) + pad[:-2] + "]"
    lines = (f"{pad}{json.dumps(k, ensure_ascii=False)}: {_layout(v, indent + 2)}" for k, v in value.items())
    return "{" + ",".join(lines) + pad[:-2] + "}"


def _fields(data: Any, folder: Path, tie_points: bool) -> dict[str, Any]:
    """The fields of the registration that a file holds."""
    if not isinstance(data, dict) or "schema_version" not in data:
        raise InputError("it has no schema_version")
    if data["schema_version"] != SCHEMA_VERSION:
        raise InputError(f"schema_version is {data['schema_version']}, this featreg reads {SCHEMA_VERSION}")
    complete = tie_points or "file" not in data["tie_points"]
    columns = read_columns(data["tie_points"], folder) if complete else no_columns(data["tie_points"])
    stage = whole_numbers(columns["stage"])
    stages = read_stages([n for n in data["counts"] if n not in RESERVED], stage, data["tie_points"].get("masks", {}))
    covariance = None
    if "cov_xx" in columns:
        xx, xy, yy = columns["cov_xx"], columns["cov_xy"], columns["cov_yy"]
        covariance = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    matches = Matches(
        np.stack([columns["reference_x"], columns["reference_y"]], -1),
        np.stack([columns["secondary_x"], columns["secondary_y"]], -1),
        columns["score"],
        covariance,
        whole_numbers(columns["origin"]),
        columns.get("rotation"),
        columns.get("scale_ratio"),
    )
    inliers = whole_numbers(columns["inlier"]) != 0
    if complete and _contradicts(data, inliers, stages):
        raise InputError("its counts and its tie points disagree")
    block = whole_numbers(columns["block"])
    return {
        "matches": matches,
        "stages": stages,
        "inliers": inliers,
        "model": FailedFit(data["model_failure"]) if data["model"] is None else model_from_dict(data["model"]),
        "status": data["status"],
        "reason": data["reason"],
        "gates": {name: Gate.from_dict(gate) for name, gate in data["gates"].items()},
        "timings": dict(data["timings"]),
        "provenance": {k: v for k, v in data["provenance"].items() if k != "folder"}
        | ({"tie_point_blocks": block} if (block >= 0).any() else {}),
        "reference": _found(InputImage.from_dict(data["reference"]), data, folder),
        "secondary": _found(InputImage.from_dict(data["secondary"]), data, folder),
    }


def _contradicts(data: Any, inliers: BoolArray, stages: Mapping[str, BoolArray]) -> bool:
    counts = data["counts"]
    return int(inliers.sum()) != counts["inliers"] or any(counts[name] != mask.sum() for name, mask in stages.items())
