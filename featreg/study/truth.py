"""Truth: where points of the reference really lie in the secondary, from a model, a matrix, a flow or marked points."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import FeatregError, InputError
from featreg.geometry import Affine, model_from_dict, model_from_matrix
from featreg.interfaces import FailedFit, Model
from featreg.results.registration import Registration
from featreg.runtime.numpy_files import load_array
from featreg.types import FloatArray, points, read_only

#: Fewest marked points: an affine needs three, and only a fourth says how well they agree.
MINIMUM_MARKED = 4
#: Truths that need no file: both images on one grid, and what the images themselves say of where they lie.
IDENTITY, GEOLOCATION = "identity", "geolocation"
WORDS = (IDENTITY, GEOLOCATION)
#: Endings of the files that may hold a truth.
TRUTH_SUFFIXES = (".npy", ".json", ".txt", ".csv", ".points", ".pts")
FORMS = "a model, a (2, 3) or (3, 3) matrix, a flow (H, W, 2), marked points (N, 4), or a file of one of them"


@dataclass(frozen=True, eq=False)
class Truth:
    """A known map reference -> secondary; ``truth(xy)`` maps (N, 2) points, NaN where it is not known.

    Parameters
    ----------
    mapping : (N, 2) -> (N, 2), in pixels
    kind : "model", "matrix", "flow", "marked points", "identity" or "geolocation over ..."
    residual_px : RMS distance in pixels of the marked points from the affine fitted to them; None for the other kinds
    marked : number of marked points; None for the other kinds
    shape : (H, W) of the reference, where a flow gives it
    """

    mapping: Callable[[FloatArray], FloatArray]
    kind: str
    residual_px: float | None = None
    marked: int | None = None
    shape: tuple[int, int] | None = None

    def __call__(self, xy: ArrayLike) -> FloatArray:
        """Map (N, 2) reference points to the secondary image; rows of NaN where the truth is not known."""
        return np.asarray(self.mapping(points(xy, "xy")), dtype=np.float64)

    def __str__(self) -> str:
        if self.residual_px is None:
            return self.kind
        return f"affine of {self.marked} {self.kind}, RMS {self.residual_px:.2f} px"


TruthLike: TypeAlias = Truth | Model | Registration | str | Path | ArrayLike


def read_truth(truth: TruthLike, images: tuple[Any, Any] | None = None) -> Truth:
    """Make a `Truth` of whatever says where points really lie.

    Parameters
    ----------
    truth : a `Truth`, `Model` or `Registration`; a (2, 3) or (3, 3) matrix reference -> secondary; a dense flow
        (H, W, 2) of displacements (dx, dy) in pixels, NaN where unknown; marked points (N, 4) as
        (reference x, y, secondary x, y), N >= 4; or a path: ``.npy`` (any of these arrays), ``.json`` (a result of
        featreg, a model, ``{"matrix": ...}``, or the truth of a simulated scene), ``.txt`` or ``.csv`` (a matrix, or
        marked points with or without a header naming reference_x, reference_y, secondary_x and secondary_y),
        ``.points`` (marked in QGIS) or ``.pts`` (marked in ENVI). The word "identity" stands for two images on one
        grid; "geolocation" for what the images themselves say of where they lie, over ground at 0 m, and
        "geolocation:HEIGHT" over ground at so many metres above the ellipsoid or over the elevation model of that name.
    images : (reference, secondary) as `featreg.match` takes them; needed for "geolocation", and for points that were
        marked on a map

    Returns
    -------
    Truth

    Raises
    ------
    InputError
        The file cannot be read, or holds nothing that can stand for a truth.

    Notes
    -----
    Marked points are fitted by an affine, as the SAR-ORB paper does with its 100 points per pair; a projective or
    terrain-dependent truth is given as a model or a flow.
    """
    if isinstance(truth, Truth):
        return truth
    if isinstance(truth, Registration):
        return _from_model(truth.model, "the registration")
    if isinstance(truth, Model):
        return Truth(truth, "model")
    if isinstance(truth, str) and truth == IDENTITY:
        return Truth(model_from_matrix(np.eye(3)), IDENTITY)
    if isinstance(truth, str) and truth.partition(":")[0] == GEOLOCATION:
        return _from_geolocation(truth.partition(":")[2], images)
    if isinstance(truth, str | Path):
        return _from_file(Path(truth), images)
    return _from_array(truth, "the truth")


@dataclass(frozen=True, eq=False)
class Flow:
    """Bilinear look-up in a dense flow: (H, W, 2) displacements (dx, dy) reference -> secondary, in pixels.

    A point outside the pixel centres, or one that leans on an unknown pixel, maps to NaN.
    """

    displacement: FloatArray

    def __call__(self, xy: FloatArray) -> FloatArray:
        height, width = self.displacement.shape[:2]
        inside = np.all((xy >= 0) & (xy <= (width - 1, height - 1)), axis=1).reshape(-1)
        base = np.floor(np.where(inside[:, None], xy, 0)).astype(np.int64)
        part = np.where(inside[:, None], xy - base, 0)
        moved = np.zeros((len(xy), 2))
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            weight = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
            rows, columns = np.minimum(base[:, 1] + dy, height - 1), np.minimum(base[:, 0] + dx, width - 1)
            # A corner of weight 0 does not count, were it unknown or beyond the border.
            moved += np.where(weight[:, None] == 0, 0.0, weight[:, None] * self.displacement[rows, columns])
        known = inside & np.isfinite(moved).all(axis=1)
        return np.where(known[:, None], xy + moved, np.nan)


def _from_array(values: Any, what: str) -> Truth:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be {FORMS}, got {type(values).__name__}") from error
    if array.shape in ((2, 3), (3, 3)):
        try:
            return Truth(model_from_matrix(array), "matrix")
        except InputError as error:
            raise InputError(f"{what}: {error}") from error
    if array.ndim == 3 and array.shape[2] == 2 and array.size:
        if not np.isfinite(array).any():
            raise InputError(f"{what} is a flow that is known nowhere")
        flow = read_only(np.where(np.isfinite(array), array, np.nan))
        return Truth(Flow(flow), "flow", shape=(array.shape[0], array.shape[1]))
    if array.ndim == 2 and array.shape[1] == 4:
        return _from_marked(array, what)
    raise InputError(f"{what} must be {FORMS}, got an array of shape {array.shape}")


def _from_marked(array: NDArray[Any], what: str) -> Truth:
    if len(array) < MINIMUM_MARKED:
        raise InputError(f"{what} needs at least {MINIMUM_MARKED} marked points, got {len(array)}")
    reference, secondary = points(array[:, :2], f"{what}: reference"), points(array[:, 2:], f"{what}: secondary")
    model = Affine.from_estimate(reference, secondary)
    if isinstance(model, FailedFit):
        raise InputError(f"{what}: no affine fits the marked points: {model.reason}")
    rms = float(np.sqrt(np.mean(model.residuals(reference, secondary) ** 2)))
    return Truth(model, "marked points", rms, len(array))


def _from_model(model: Model | FailedFit, what: str) -> Truth:
    if isinstance(model, FailedFit):
        raise InputError(f"{what} holds no model that could be the truth: {model.reason}")
    return Truth(model, "model")


def _from_geolocation(height: str, images: tuple[Any, Any] | None) -> Truth:
    from featreg.geolocation.elevation_model import DemHeights
    from featreg.geolocation.heights import ConstantHeight, Heights
    from featreg.geolocation.sensors import ground_level, sensor_of
    from featreg.geolocation.transfer import Transfer
    from featreg.io.raster_source import open_source

    if images is None:
        raise InputError(f"truth '{GEOLOCATION}' needs the two images, and they are not known here")
    sensors = []
    for source in images:
        opened = open_source(source)
        sensors.append(sensor_of(opened.geolocation, opened.shape, opened.name))
    metres = _number(height) if height else ground_level(*sensors)[0]
    heights: Heights = DemHeights(height) if metres is None else ConstantHeight(metres)
    over = f"ground at {metres:g} m" if metres is not None else Path(height).name
    return Truth(_Known(Transfer(sensors[0], sensors[1], heights)), f"{GEOLOCATION} over {over}")


@dataclass(frozen=True, eq=False)
class _Known:
    """A transfer over the ground, NaN where it finds none."""

    transfer: Model

    def __call__(self, xy: FloatArray) -> FloatArray:
        mapped = np.array(self.transfer(xy), dtype=np.float64)
        mapped[~np.isfinite(mapped).all(axis=1)] = np.nan
        return mapped


def _from_file(path: Path, images: tuple[Any, Any] | None = None) -> Truth:
    """The truth of a file; points that QGIS marked on a map need the images."""
    what = f"truth '{path}'"
    files = [image if isinstance(image, str | Path) else None for image in images or ()]
    suffix = path.suffix.lower()
    if suffix not in TRUTH_SUFFIXES:
        raise InputError(f"{what} must be a {', '.join(TRUTH_SUFFIXES)} file, or one of the words {', '.join(WORDS)}")
    try:
        if suffix == ".npy":
            return _from_array(load_array(path), what)
        if suffix == ".json":
            return _from_json(path, what)
        return _from_text(path, what) if suffix in (".txt", ".csv") else _from_tie_points(path, what, *files)
    except FeatregError as error:
        if isinstance(error, InputError) and str(path) in str(error):
            raise
        raise InputError(f"{what} cannot be used: {error}") from error
    except OSError as error:
        raise InputError(f"{what} cannot be read: {error.strerror or error}") from error
    except (ValueError, TypeError, LookupError, EOFError, ArithmeticError, RecursionError) as error:
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{what} cannot be read: {why}") from error


def _from_json(path: Path, what: str) -> Truth:
    data = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(data, dict):
        return _from_array(data, what)
    if "schema_version" in data:
        if not data.get("model"):
            return _from_model(FailedFit(str(data.get("model_failure", "model is null"))), what)
        return Truth(model_from_dict(data["model"]), "model")
    if "terrain" in data:
        from featreg.simulate.scene import read_scene_truth

        return Truth(read_scene_truth(path), "geometry of a simulated scene")
    if "type" in data and "parameters" in data:
        return Truth(model_from_dict(data), "model")
    if "matrix" not in data:
        raise InputError(f'{what} must be a result of featreg or hold "matrix", got keys {", ".join(data) or "none"}')
    return _from_array(data["matrix"], what)


def _from_text(path: Path, what: str) -> Truth:
    from featreg.exports.columns import numbers
    from featreg.exports.csv import table_of

    names, rows = table_of(path)
    return _from_tie_points(path, what) if names else _from_array(numbers(rows), what)


def _from_tie_points(path: Path, what: str, *images: str | Path | None) -> Truth:
    from featreg.exports.formats import read_tie_points

    matches = read_tie_points(path, **dict(zip(("reference", "secondary"), images, strict=False)))
    return _from_marked(np.hstack([matches.reference_xy, matches.secondary_xy]), what)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
