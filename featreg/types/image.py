"""An image: its samples, which of them are data, where it lies, and what was derived from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.runtime.showing import Shown, figure_of
from featreg.types.arrays import BoolArray, FloatArray, ReadOnlyArrays, is_everywhere, kept
from featreg.types.derived import DerivedMaps

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Geolocation(ReadOnlyArrays):
    """Where an image lies on the ground, as its file says it; any of the four forms may be missing.

    `transform` is GDAL's affine (a, b, c, d, e, f) from pixel corners to `crs` (WKT or authority code); `rpcs` holds
    the rational polynomial coefficients under rasterio's names; `gcps` rows are (x, y, ground x, ground y, ground z)
    with x, y in this package's pixel convention; `sensor` is the exact geometry that the metadata of a product state,
    plain values from which `featreg.geolocation.sensor_from_dict` makes the sensor.
    """

    transform: tuple[float, float, float, float, float, float] | None = None
    crs: str | None = None
    rpcs: Mapping[str, Any] | None = None
    gcps: FloatArray | None = None
    sensor: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if self.gcps is not None:
            object.__setattr__(self, "gcps", kept(self.gcps))


@dataclass(frozen=True, eq=False)
class Image(ReadOnlyArrays, Shown):
    """One SAR image: linear amplitude or complex samples, and which of its pixels are data.

    Parameters
    ----------
    pixels : (H, W) float32 linear amplitude (>= 0) or complex64; invalid pixels hold 0
    mask : (H, W) bool, True = valid
    geolocation : where the image lies, when known
    name : the path it came from, or "array"
    source_dtype : dtype of the samples before conversion; 8-bit sources are not stretched again for 8-bit code
    scale : what the source held: "amplitude", "intensity", "db" or "complex"
    band : what was read of a file of several bands, as `featreg.io.as_image` takes it; None = its only one
    filled : (H, W) bool, of an image prepared for features the valid pixels that hold no sample of their own but what
        the samples around them say; None = none
    calibration : "sigma0", "beta0" or "gamma0" where the squares of the amplitude are that quantity; None = not known
    nodata : the value of samples without data that was stated when they were read; None = none was

    Raises
    ------
    InputError
        Wrong number of dimensions, an empty image, a mask of another shape.

    Notes
    -----
    Use `featreg.io.as_image` to make one from a path or a plain array. Arrays that can be written to are copied, and
    those that are locked shared, unless they lie column by column.
    """

    pixels: NDArray[np.float32] | NDArray[np.complex64]
    mask: BoolArray
    geolocation: Geolocation | None = None
    name: str = "array"
    source_dtype: str = "float32"
    scale: str = "amplitude"
    filled: BoolArray | None = None
    band: str | None = None
    calibration: str | None = None
    nodata: complex | None = None
    _derived: DerivedMaps = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.pixels.ndim != 2 or self.pixels.size == 0:
            raise InputError(f"an image must be a non-empty 2-D array, got shape {self.pixels.shape}")
        if self.pixels.dtype not in (np.float32, np.complex64):
            raise InputError(f"pixels must be float32 amplitude or complex64, got {self.pixels.dtype}")
        if self.mask.shape != self.pixels.shape or self.mask.dtype != np.bool_:
            raise InputError(f"mask must be bool {self.pixels.shape}, got {self.mask.dtype} {self.mask.shape}")
        object.__setattr__(self, "pixels", kept(self.pixels))
        object.__setattr__(self, "mask", kept(self.mask))
        if self.filled is not None:
            object.__setattr__(self, "filled", kept(self.filled))
        object.__setattr__(self, "_derived", DerivedMaps())

    def __repr__(self) -> str:
        height, width = self.shape
        valid = float(self.mask.mean())
        more = [] if valid == 1 else [f"{100 * valid:.4g} % valid"]
        more += [] if self.geolocation is None else ["georeferenced"]
        name = self.name if len(self.name) <= 200 else f"…{self.name[-199:]}"
        return f"Image({', '.join([repr(name), f'{width} x {height} px', self.scale, *more])})"

    def show(self) -> Any:
        """Return a `matplotlib.figure.Figure` of the amplitude, logarithmic between its 1st and 99.5th percentile."""
        return figure_of(self)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.pixels.shape[0], self.pixels.shape[1]

    @property
    def is_complex(self) -> bool:
        return self.pixels.dtype == np.complex64

    @property
    def all_valid(self) -> bool:
        return self.valid_count == self.mask.size

    @property
    def valid_count(self) -> int:
        """How many pixels are valid; counted once."""
        known: int | None = self.__dict__.get("_valid")
        if known is None:
            known = self.mask.size if is_everywhere(self.mask) else int(np.count_nonzero(self.mask))
            self.__dict__["_valid"] = known
        return known

    @property
    def amplitude(self) -> NDArray[np.float32]:
        """(H, W) float32 linear amplitude; computed once for complex images."""
        return self.derive(_amplitude) if self.is_complex else self.pixels  # type: ignore[return-value]  # float32 then

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
        return {k: v for k, v in self.__dict__.items() if k not in ("_derived", "_valid")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self.__dict__["_derived"] = DerivedMaps()


def _amplitude(image: Image) -> NDArray[np.float32]:
    return np.abs(image.pixels)
