"""Bias of the geolocation between two images, as a shift or affine map of the secondary's image space.

Named after the RPC, for which the method was made; it serves sensors of every kind, and for one by orbit and timing a
shift is a bias in range and azimuth time.
"""

from __future__ import annotations

import copyreg
from abc import ABCMeta
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError, ParameterError
from featreg.geolocation.corrected import CorrectedSensor
from featreg.geolocation.elevation_model import heights_from_dict
from featreg.geolocation.heights import ConstantHeight, Heights
from featreg.geolocation.range_doppler import RangeDopplerSensor
from featreg.geolocation.rpc import RpcSensor
from featreg.geolocation.sensor import Sensor
from featreg.geolocation.sensors import sensor_from_dict
from featreg.geolocation.transfer import Transfer
from featreg.geometry.base import DerivedModel, coefficient_array
from featreg.geometry.corrected import CorrectedModel
from featreg.geometry.matrix import Affine, Translation
from featreg.interfaces import FailedFit, Model
from featreg.registry import register
from featreg.runtime.parameters import check
from featreg.types import FloatArray

Kind = Literal["affine", "shift"]
CORRECTIONS: Mapping[str, type[Affine] | type[Translation]] = {"affine": Affine, "shift": Translation}
UNBOUND = (
    "the model 'rpc-bias' needs the sensors of both images: give images with orbit and timing, RPCs, a geotransform or "
    "ground control points and match them as a scene (a DEM file or a height), or use "
    "RpcBias.bind(reference, secondary, heights)"
)


class _Bindable(ABCMeta):
    """Classes that can be bound to sensors, and are pickled by what they are bound to."""


@register("rpc-bias")
@dataclass(frozen=True, eq=False)
class RpcBias(CorrectedModel, metaclass=_Bindable):
    """The sensors' transfer between two images, followed by an estimated bias in the secondary's pixels.

    Parameters
    ----------
    reference, secondary : the sensors, or the dicts that `Sensor.to_dict` writes
    heights : of the ground, or the dict that `Heights.to_dict` writes
    kind : "affine" (6 parameters) or "shift" (2)
    bias : (2, 3) float64, sensor-predicted -> true secondary pixels

    Raises
    ------
    InputError
        Sensors, heights or a matrix that cannot be used.
    ParameterError
        An unknown kind; `from_estimate` of the class itself, which knows no sensors.

    Notes
    -----
    `RpcBias.bind` returns a class that knows the sensors and stands wherever a model's class is asked for. Bias
    compensation in image space is that of Grodecki and Dial [1]_ for one image with the other as control: only the
    relative bias of the two images is estimated, so the corrected RPC agrees with the reference, not with the truth.
    Any two sensors will do; of one by orbit and timing `timing_bias` gives the shift in metres and seconds.

    References
    ----------
    .. [1] J. Grodecki, G. Dial, "Block adjustment of high-resolution satellite images described by rational
       polynomials", Photogramm. Eng. Remote Sens. 69(1), 2003, DOI 10.14358/PERS.69.1.59
    """

    reference: Sensor
    secondary: Sensor
    heights: Heights
    kind: Kind = "affine"
    bias: FloatArray = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))  # type: ignore[assignment]  # an array once it is checked
    minimum: ClassVar[int] = Affine.minimum
    correction_kind: ClassVar[type[Model]] = Affine
    #: What a bound class is bound to; None for `RpcBias` itself.
    binding: ClassVar[tuple[Transfer, Kind] | None] = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("reference", "secondary"):
            given = getattr(self, name)
            put(self, name, sensor_from_dict(given) if isinstance(given, Mapping) else given)
        if isinstance(self.heights, Mapping):
            put(self, "heights", heights_from_dict(self.heights))
        good = isinstance(self.reference, Sensor) and isinstance(self.secondary, Sensor)
        if not (good and isinstance(self.heights, Heights)):
            raise InputError("rpc-bias needs two sensors and heights, or the dicts that they write")
        check("kind", self.kind, Kind)
        put(self, "bias", coefficient_array(self.bias, (2, 3), "RpcBias.bias"))
        Affine(self.bias)  # refuses a map that cannot be inverted

    @classmethod
    def bind(
        cls, reference: Sensor, secondary: Sensor, heights: Heights | None = None, kind: Kind = "affine"
    ) -> type[RpcBias]:
        """Return the model's class for one pair of sensors.

        Parameters
        ----------
        reference, secondary : the sensors
        heights : of the ground; None for height 0
        kind : "affine" or "shift"
        """
        check("kind", kind, Kind)
        transfer = Transfer(reference, secondary, heights or ConstantHeight())
        return _bound(transfer, kind)

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the least-squares bias; points whose ground is not found are left out.

        Raises
        ------
        ParameterError
            The class is not bound to sensors.
        """
        at = cls.known(np.asarray(reference_xy, np.float64).reshape(-1, 2))
        lost = np.asarray(np.isnan(at).any(axis=1))
        if lost.any():
            at = np.where(lost[:, None], 0.0, at)
            weights = np.where(lost, 0.0, np.ones(len(at)) if weights is None else weights)
        fitted = cls.correction_kind.from_estimate(at, secondary_xy, weights)
        return fitted if isinstance(fitted, FailedFit) else cls.with_correction(fitted)

    @classmethod
    def known(cls, xy: FloatArray) -> FloatArray:
        return cls._binding()[0](xy)

    @classmethod
    def with_correction(cls, correction: Model) -> Self:
        transfer, kind = cls._binding()
        if correction.matrix is None:
            raise InputError(f"the bias of an RPC is a shift or affine, got {type(correction).__name__}")
        return cls(transfer.reference, transfer.secondary, transfer.heights, kind, correction.matrix[:2])

    @classmethod
    def _binding(cls) -> tuple[Transfer, Kind]:
        if cls.binding is None:
            raise ParameterError(UNBOUND)
        return cls.binding

    @property
    def correction(self) -> Model:
        if self.kind == "shift":
            return Translation(*self.bias[:, 2].tolist())
        return Affine(self.bias)

    @property
    def transfer(self) -> Transfer:
        """Reference -> secondary as the sensors have it, without the bias."""
        return Transfer(self.reference, self.secondary, self.heights)

    def __call__(self, xy: ArrayLike) -> FloatArray:
        return self.correction(self.transfer(xy))

    @property
    def inverse(self) -> Model:
        return InverseRpcBias(self)

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {
            "reference": self.reference.to_dict(),
            "secondary": self.secondary.to_dict(),
            "heights": self.heights.to_dict(),
            "kind": self.kind,
            "bias": self.bias.tolist(),
        }

    def corrected_sensor(self) -> Sensor:
        """Return the secondary's sensor, of whatever kind, with the bias worked in: it agrees with the reference."""
        return CorrectedSensor(self.secondary, self.bias)

    def timing_bias(self) -> tuple[float, float]:
        """Return what the bias is in the secondary's radar geometry: metres of slant range and seconds of azimuth time.

        Both are what the image's own range and time must be increased by, at its centre, to agree with the reference.

        Raises
        ------
        InputError
            The secondary is not located by range and time.
        """
        if not isinstance(self.secondary, RangeDopplerSensor):
            raise InputError(
                "only an image located by orbit and timing has a bias in range and time, the secondary is located by a "
                f"{type(self.secondary).__name__}"
            )
        centre = np.array([self.secondary.centre])
        time, distance = self.secondary.time_and_range(np.concatenate([centre, self.correction.inverse(centre)]))
        return float(distance[1] - distance[0]), float(time[1] - time[0])

    def corrected_rpc(self) -> dict[str, Any]:
        """Return the secondary's RPC with the bias worked in, under rasterio's names.

        Raises
        ------
        InputError
            The secondary has no RPC, or none reproduces the bias to 0.01 px.

        Notes
        -----
        A shift is exact: it moves the offsets. For an affine bias the numerators are fitted anew on a lattice over the
        RPC's range of longitude, latitude and height. The errors stated by the RPC are kept: the bias is relative.
        """
        from featreg.geolocation.rpc_fit import with_affine

        if not isinstance(self.secondary, RpcSensor):
            raise InputError(
                f"only an RPC can be corrected, the secondary is located by a {type(self.secondary).__name__}"
            )
        return with_affine(self.secondary, self.bias)

    def write_corrected_rpc(self, path: str | Path) -> None:
        """Write `corrected_rpc` as GDAL reads it beside an image: ``NAME_RPC.TXT`` or ``NAME.RPB``.

        Raises
        ------
        ParameterError, InputError
            Another name, or a file that cannot be written.
        """
        from featreg.io.rpc_file import write_rpc

        write_rpc(path, self.corrected_rpc())


@dataclass(frozen=True, eq=False)
class InverseRpcBias(DerivedModel):
    """Secondary -> reference of an `RpcBias`: the bias taken off, then the sensors' transfer back."""

    forward: RpcBias

    def __call__(self, xy: ArrayLike) -> FloatArray:
        return self.forward.transfer.inverse(self.forward.correction.inverse(xy))

    @property
    def inverse(self) -> RpcBias:
        return self.forward

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"forward": self.forward}


def _bound(transfer: Transfer, kind: Kind) -> type[RpcBias]:
    """A subclass that knows its sensors; it carries the registered name, under which results record it."""
    correction = CORRECTIONS[kind]
    attributes = {
        "binding": (transfer, kind),
        "correction_kind": correction,
        "minimum": correction.minimum,
        "__doc__": RpcBias.__doc__,
        "__module__": __name__,
    }
    bound: Any = _Bindable("rpc-bias", (RpcBias,), attributes)
    made: type[RpcBias] = bound
    return made


def _reduced(cls: type[RpcBias]) -> Any:
    """A bound class is not an attribute of any module: it is pickled as what makes it again."""
    return cls.__qualname__ if cls.binding is None else (_bound, cls.binding)


copyreg.pickle(_Bindable, _reduced)  # type: ignore[arg-type]  # the stub asks for a function of instances, these are classes
