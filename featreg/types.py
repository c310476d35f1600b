"""What flows through featreg: Image, Features, Matches, Registration.

Coordinate convention, valid everywhere in this package
--------------------------------------------------------
* A point is (x, y) = (column, row) in float64; the centre of the first pixel is (0, 0).
* Resizing an image by a factor s moves a point to ``(x + 0.5) * s - 0.5``.
* A model maps reference -> secondary pixel coordinates.
* Angles are counter-clockwise as seen on the displayed image (y up), 0 along +x, in radians in `Features.angle`.

All types are frozen dataclasses of arrays, checked where they are made, and hold read-only arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from featreg.array_checks import column as column
from featreg.array_checks import finite as finite
from featreg.array_checks import points as points
from featreg.array_checks import read_only as read_only
from featreg.derived import DerivedMaps
from featreg.errors import InputError

if TYPE_CHECKING:
    from featreg.interfaces import FailedFit, Model

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Geolocation:
    """Where an image lies on the ground, as its file says it; any of the three forms may be missing.

    `transform` is GDAL's affine (a, b, c, d, e, f) from pixel corners to `crs` (WKT or authority code); `rpcs` holds
    the rational polynomial coefficients under rasterio's names; `gcps` rows are (x, y, ground x, ground y, ground z)
    with x, y in this package's pixel convention.
    """

    transform: tuple[float, float, float, float, float, float] | None = None
    crs: str | None = None
    rpcs: Mapping[str, Any] | None = None
    gcps: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Image:
    """One SAR image: linear amplitude or complex samples, and which of its pixels are data.

    Parameters
    ----------
    pixels : (H, W) float32 linear amplitude (>= 0) or complex64; invalid pixels hold 0
    mask : (H, W) bool, True = valid
    geolocation : where the image lies, when known
    name : the path it came from, or "array"
    source_dtype : dtype of the samples before conversion; 8-bit sources are not stretched again for 8-bit code
    scale : what the source held: "amplitude", "intensity", "db" or "complex"

    Raises
    ------
    InputError
        Wrong number of dimensions, an empty image, a mask of another shape.

    Notes
    -----
    Use `featreg.io.as_image` to make one from a path or a plain array.
    """

    pixels: NDArray[np.float32] | NDArray[np.complex64]
    mask: BoolArray
    geolocation: Geolocation | None = None
    name: str = "array"
    source_dtype: str = "float32"
    scale: str = "amplitude"
    _derived: DerivedMaps = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.pixels.ndim != 2 or self.pixels.size == 0:
            raise InputError(f"an image must be a non-empty 2-D array, got shape {self.pixels.shape}")
        if self.pixels.dtype not in (np.float32, np.complex64):
            raise InputError(f"pixels must be float32 amplitude or complex64, got {self.pixels.dtype}")
        if self.mask.shape != self.pixels.shape or self.mask.dtype != np.bool_:
            raise InputError(f"mask must be bool {self.pixels.shape}, got {self.mask.dtype} {self.mask.shape}")
        read_only(self.pixels)
        read_only(self.mask)
        object.__setattr__(self, "_derived", DerivedMaps())

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.pixels.shape[0], self.pixels.shape[1]

    @property
    def is_complex(self) -> bool:
        return bool(np.iscomplexobj(self.pixels))

    @property
    def all_valid(self) -> bool:
        return bool(self.derive(_all_valid))

    @property
    def amplitude(self) -> NDArray[np.float32]:
        """(H, W) float32 linear amplitude; computed once for complex images."""
        return self.derive(_amplitude)

    def derive(self, function: Callable[..., T], **params: Any) -> T:
        """Return ``function(self, **params)``, computed once per image and parameter set and shared by all stages.

        `function` must be a module-level function; arrays it returns become read-only. See `DerivedMaps`.
        """
        value: T = self._derived.get(self, function, params)
        return value

    def release(self) -> None:
        """Forget every derived map."""
        self._derived.clear()

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k != "_derived"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        read_only(self.pixels)
        read_only(self.mask)
        self.__dict__["_derived"] = DerivedMaps()


def _amplitude(image: Image) -> NDArray[np.float32]:
    return np.abs(image.pixels) if image.is_complex else image.pixels  # type: ignore[return-value]


def _all_valid(image: Image) -> bool:
    return bool(image.mask.all())


class _ReadOnly:
    """Arrays come back from a pickle locked, as they were."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for value in state.values():
            if isinstance(value, np.ndarray):
                read_only(value)


@dataclass(frozen=True, eq=False)
class Features(_ReadOnly):
    """Keypoints of one image and, once described, their descriptors.

    Parameters
    ----------
    xy : (N, 2) float64 pixel coordinates
    scale : (N,) float64 radius in pixels of the support from which the point is described
    angle : (N,) float64 radians, counter-clockwise as seen
    score : (N,) float64, higher is better
    level : (N,) int64 pyramid level or octave
    descriptors : (N, D) float32, or uint8 holding packed bits, or None before description
    norm : "l2" or "hamming", of the descriptors
    index : (N,) int64 rows of the features a descriptor was given, where it dropped or doubled some; else None
    subpixel : (N,) bool, False where the sub-pixel position could not be found and is that of the pixel; else None
    """

    xy: FloatArray
    scale: FloatArray
    angle: FloatArray
    score: FloatArray
    level: IntArray
    descriptors: NDArray[np.float32] | NDArray[np.uint8] | None = None
    norm: str = "l2"
    index: IntArray | None = None
    subpixel: BoolArray | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "xy", points(self.xy, "Features.xy"))
        n = len(self.xy)
        for name in ("scale", "angle", "score"):
            put(self, name, finite(column(getattr(self, name), n, f"Features.{name}"), f"Features.{name}"))
        put(self, "level", column(self.level, n, "Features.level", np.int64))
        if self.index is not None:
            put(self, "index", column(self.index, n, "Features.index", np.int64))
        if self.subpixel is not None:
            put(self, "subpixel", column(self.subpixel, n, "Features.subpixel", np.bool_))
        if self.norm not in ("l2", "hamming"):
            raise InputError(f"Features.norm must be 'l2' or 'hamming', got '{self.norm}'")
        if self.descriptors is not None:
            wanted = np.float32 if self.norm == "l2" else np.uint8
            d = self.descriptors
            if d.ndim != 2 or len(d) != n or d.dtype != wanted:
                raise InputError(f"descriptors must be ({n}, D) {np.dtype(wanted)}, got {d.dtype} {d.shape}")
            read_only(d)

    @classmethod
    def empty(cls) -> Self:
        none = np.zeros(0)
        return cls(xy=np.zeros((0, 2)), scale=none, angle=none, score=none, level=np.zeros(0, np.int64))

    @classmethod
    def concatenate(cls, parts: Sequence[Features]) -> Features:
        """The undescribed features of all parts, one after the other."""
        if not parts:
            return cls.empty()
        marks = [part.subpixel for part in parts]
        return cls(
            xy=np.concatenate([part.xy for part in parts]),
            scale=np.concatenate([part.scale for part in parts]),
            angle=np.concatenate([part.angle for part in parts]),
            score=np.concatenate([part.score for part in parts]),
            level=np.concatenate([part.level for part in parts]),
            subpixel=None if any(m is None for m in marks) else np.concatenate([m for m in marks if m is not None]),
        )

    def __len__(self) -> int:
        return len(self.xy)

    def take(self, rows: NDArray[Any]) -> Self:
        """The features of the given rows (indices or a bool mask), in that order."""
        return replace(
            self,
            xy=self.xy[rows],
            scale=self.scale[rows],
            angle=self.angle[rows],
            score=self.score[rows],
            level=self.level[rows],
            descriptors=None if self.descriptors is None else self.descriptors[rows],
            index=None if self.index is None else self.index[rows],
            subpixel=None if self.subpixel is None else self.subpixel[rows],
        )

    def best(self, count: int) -> Self:
        """At most `count` features of the highest score, best first, ties in the order given."""
        return self.take(np.argsort(-self.score, kind="stable")[:count])

    def to_keypoints(self) -> list[Any]:
        """As `cv2.KeyPoint` (size = diameter, angle in degrees clockwise as OpenCV has it)."""
        from featreg.opencv import to_keypoints

        return to_keypoints(self)

    @classmethod
    def from_keypoints(cls, keypoints: Any, descriptors: NDArray[Any] | None = None) -> Features:
        """From a sequence of `cv2.KeyPoint`; the inverse of `to_keypoints`."""
        from featreg.opencv import from_keypoints

        return from_keypoints(keypoints, descriptors)

    def to_lafs(self) -> Any:
        """As (1, N, 2, 3) local affine frames of kornia; see `featreg.torch_arrays`."""
        from featreg.torch_arrays import to_lafs

        return to_lafs(self)

    @classmethod
    def from_lafs(cls, lafs: Any, score: Any = None, descriptors: Any = None) -> Features:
        """From kornia's local affine frames; the inverse of `to_lafs`, in which an elongated frame becomes a circle."""
        from featreg.torch_arrays import from_lafs

        return from_lafs(lafs, score, descriptors)


@dataclass(frozen=True, eq=False)
class Matches(_ReadOnly):
    """Tie points: pairs of homologous points of the two images.

    Parameters
    ----------
    reference_xy, secondary_xy : (M, 2) float64 pixel coordinates
    score : (M,) float64, higher is better, NaN where unknown
    covariance : (M, 2, 2) float64 px^2 of the secondary position, or None
    origin : (M,) int64 row of the match that a refined one came from, else -1
    rotation : (M,) float64 radians, secondary minus reference feature angle, or None where unknown
    scale_ratio : (M,) float64 secondary over reference feature scale, or None where unknown
    """

    reference_xy: FloatArray
    secondary_xy: FloatArray
    score: FloatArray
    covariance: FloatArray | None = None
    origin: IntArray = -1  # type: ignore[assignment]  # one number stands for all rows until it is checked
    rotation: FloatArray | None = None
    scale_ratio: FloatArray | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "reference_xy", points(self.reference_xy, "Matches.reference_xy"))
        put(self, "secondary_xy", points(self.secondary_xy, "Matches.secondary_xy"))
        m = len(self.reference_xy)
        if len(self.secondary_xy) != m:
            raise InputError(f"as many reference as secondary points are needed, got {m} and {len(self.secondary_xy)}")
        put(self, "score", column(self.score, m, "Matches.score"))
        put(self, "origin", column(self.origin, m, "Matches.origin", np.int64))
        for name in ("rotation", "scale_ratio"):
            if getattr(self, name) is not None:
                put(self, name, column(getattr(self, name), m, f"Matches.{name}"))
        if self.covariance is not None:
            covariance = np.array(self.covariance, dtype=np.float64)
            if covariance.shape != (m, 2, 2):
                raise InputError(f"Matches.covariance must be ({m}, 2, 2), got {covariance.shape}")
            put(self, "covariance", read_only(covariance))

    @classmethod
    def empty(cls) -> Self:
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))

    def __len__(self) -> int:
        return len(self.reference_xy)

    def take(self, rows: NDArray[Any]) -> Self:
        """The matches of the given rows (indices or a bool mask), in that order."""

        def pick(values: NDArray[Any] | None) -> NDArray[Any] | None:
            return None if values is None else values[rows]

        return replace(
            self,
            reference_xy=self.reference_xy[rows],
            secondary_xy=self.secondary_xy[rows],
            score=self.score[rows],
            covariance=pick(self.covariance),
            origin=self.origin[rows],
            rotation=pick(self.rotation),
            scale_ratio=pick(self.scale_ratio),
        )

    def appended(self, more: Matches) -> Matches:
        """These matches followed by `more`; covariances unknown on one side are NaN, other extras are dropped there."""

        def join(name: str, blank: tuple[int, ...]) -> FloatArray | None:
            a, b = getattr(self, name), getattr(more, name)
            if a is None and b is None:
                return None
            a = np.full((len(self), *blank), np.nan) if a is None else a
            b = np.full((len(more), *blank), np.nan) if b is None else b
            return np.concatenate([a, b])

        return Matches(
            np.concatenate([self.reference_xy, more.reference_xy]),
            np.concatenate([self.secondary_xy, more.secondary_xy]),
            np.concatenate([self.score, more.score]),
            join("covariance", (2, 2)),
            np.concatenate([self.origin, more.origin]),
            join("rotation", ()),
            join("scale_ratio", ()),
        )


@dataclass(frozen=True)
class Gate:
    """One condition of trust: `value` must be at least `low` and at most `high` (either may be None)."""

    value: float | None
    passed: bool
    low: float | None = None
    high: float | None = None
    meaning: str = ""


@dataclass(frozen=True, eq=False)
class Registration:
    """What `featreg.match` returns.

    Parameters
    ----------
    matches : every tie point, refined ones appended at the end
    stages : filter name -> (M,) bool, in the order in which the filters ran
    inliers : (M,) bool, the final set, on which the model was fitted
    model : the best fit, kept also when it is not trusted; a falsy `FailedFit` where none could be made
    status : "ok" or "unreliable"
    reason : why it is unreliable; empty when ok
    gates : name -> Gate, every condition with its value
    timings : stage -> seconds
    provenance : method, every parameter, versions, seed and inputs
    """

    matches: Matches
    stages: Mapping[str, BoolArray]
    inliers: BoolArray
    model: Model | FailedFit
    status: str
    reason: str = ""
    gates: Mapping[str, Gate] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        m = len(self.matches)
        object.__setattr__(self, "inliers", column(self.inliers, m, "Registration.inliers", np.bool_))
        stages = {k: column(v, m, f"Registration.stages['{k}']", np.bool_) for k, v in self.stages.items()}
        object.__setattr__(self, "stages", stages)
        if self.status not in ("ok", "unreliable"):
            raise InputError(f"status must be 'ok' or 'unreliable', got '{self.status}'")
        if self.status == "unreliable" and not self.reason:
            raise InputError("an unreliable registration needs a reason")

    @property
    def putative(self) -> BoolArray:
        """(M,) bool, True for the tie points of the matcher, False for those that refinement appended."""
        mine = self.matches.origin < 0
        return mine & ~self.stages["refine"] if "refine" in self.stages else mine

    def residuals(self) -> FloatArray:
        """(M,) distance in pixels of each tie point from the model; NaN where there is no model."""
        if not self.model:
            return np.full(len(self.matches), np.nan)
        return self.model.residuals(self.matches.reference_xy, self.matches.secondary_xy)

    @property
    def standard_errors(self) -> Mapping[str, Any]:
        """Of a rigid model: ``rotation_deg_se``, ``shift_se_px`` (x, y at the image centre), ``degrees_of_freedom``."""
        from featreg.standard_errors import standard_errors

        return standard_errors(self)

    def to_json(self, path: str | Path) -> None:
        """Write the result as one JSON file (beyond 20 000 tie points, these stand in a Parquet file beside it)."""
        from featreg.result_file import write_registration

        write_registration(self, Path(path))

    @classmethod
    def from_json(cls, path: str | Path) -> Registration:
        """Read what `to_json` wrote, whole."""
        from featreg.result_file import read_registration

        return read_registration(Path(path))
