"""What a result says of the images it was made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from featreg.errors import InputError
from featreg.types import Geolocation, PixelSize


@dataclass(frozen=True, eq=False)
class InputImage:
    """One of the two images of a registration, without its samples.

    Parameters
    ----------
    path : of its file as it was given, "array", or "tie points" where there was no image
    shape : (H, W)
    scale : "amplitude", "intensity", "db" or "complex", what its samples were taken for; None where not known
    dtype : of its samples before conversion; None where not known
    valid_pixels : how many are data; None where they were never counted
    pixel_size : on the ground, where its geolocation tells it
    geolocation : where it lies, as its file says it
    band : what was read of a file of several bands; None where it has one only
    calibration : "sigma0", "beta0" or "gamma0" where its samples were calibrated to it when they were read, else None
    nodata : the value of samples without data that was stated for it, NaN where that was none; None where the file's
        own counted

    Raises
    ------
    InputError
        A path that is no text, a shape that no image has.
    """

    path: str
    shape: tuple[int, int]
    scale: str | None = None
    dtype: str | None = None
    valid_pixels: int | None = None
    pixel_size: PixelSize | None = None
    geolocation: Geolocation | None = None
    band: str | None = None
    calibration: str | None = None
    nodata: complex | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.path, str):
            raise InputError(f"the path of an image must be a text, got {self.path!r}")
        height, width = (int(n) for n in self.shape)
        if height < 1 or width < 1:
            raise InputError(f"the shape of an image must be (H, W) of at least 1 x 1, got {tuple(self.shape)}")
        object.__setattr__(self, "shape", (height, width))
        if self.nodata is not None:
            # What is not finite is no data anyway, but stated it takes the place of the file's own value.
            plain = complex(self.nodata) if np.isfinite(self.nodata) else complex(np.nan)
            object.__setattr__(self, "nodata", plain if plain.imag else plain.real)

    @property
    def reading(self) -> dict[str, Any]:
        """The keywords of `featreg.as_image` with which its samples are read again as they were.

        A mask is none of them: it says where to match, and not what there is.
        """
        scale = None if self.scale == "complex" or self.calibration is not None else self.scale
        return {"scale": scale, "band": self.band, "nodata": self.nodata, "calibrate": self.calibration}

    def to_dict(self) -> dict[str, Any]:
        """Return what a file holds of it: path, width, height, and the rest where known."""
        place = self.geolocation
        more = {
            "scale": self.scale,
            "dtype": self.dtype,
            "valid_pixels": self.valid_pixels,
            "pixel_size": None if self.pixel_size is None else self.pixel_size._asdict(),
            "geolocation": None if place is None else _known(vars(place)),
            "band": self.band,
            "calibration": self.calibration,
            "nodata": _nodata_written(self.nodata),
        }
        return {"path": self.path, "width": self.shape[1], "height": self.shape[0], **_known(more)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self | None:
        """Return the image that `to_dict` wrote; None for one of which nothing is known."""
        path, width, height = values["path"], values["width"], values["height"]
        if path is None and width is None and height is None:
            return None
        size, place = values.get("pixel_size"), values.get("geolocation")
        return cls(
            path,
            (height, width),
            values.get("scale"),
            values.get("dtype"),
            values.get("valid_pixels"),
            None if size is None else PixelSize(**size),
            None if place is None else _geolocation(**place),
            None if values.get("band") is None else str(values["band"]),
            values.get("calibration"),
            _nodata_read(values.get("nodata")),
        )


def _nodata_written(nodata: complex | None) -> Any:
    if isinstance(nodata, complex):
        return [nodata.real, nodata.imag]
    return "nan" if nodata is not None and np.isnan(nodata) else nodata


def _nodata_read(written: Any) -> complex | None:
    if isinstance(written, list | tuple):
        return complex(*written)
    return None if written is None else float(written)


def _known(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _geolocation(
    transform: Any = None, crs: Any = None, rpcs: Any = None, gcps: Any = None, sensor: Any = None
) -> Geolocation:
    if transform is not None:
        a, b, c, d, e, f = (float(n) for n in transform)
        transform = a, b, c, d, e, f
    # A number that is not finite stands as null.
    return Geolocation(
        transform, crs, rpcs, None if gcps is None else np.array(gcps, np.float64).reshape(-1, 5), sensor
    )
