"""Where in an image features were looked for: at what share of its size, for keypoints of which sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Searched:
    """Where in an image features were looked for.

    Parameters
    ----------
    share : of its sides to which the image was reduced first; 1 = it was not
    reduced_by : the parameter that asks for it, as `featreg.match` takes it; "" where it was not
    radii : of the keypoints that were looked for, px of the image (`Features.scale`); () where the detector does not
        tell
    left_out : parameter -> such radii that were not looked for, since the image has pixels enough without them
    """

    share: float = 1.0
    reduced_by: str = ""
    radii: tuple[float, ...] = ()
    left_out: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether nothing was left out."""
        return not self.reduced_by and not self.left_out

    def of_part(self, role: str) -> Searched:
        """The same with the names of parameters as those of a part of a method."""
        reduced_by = f"{role}.{self.reduced_by}" if self.reduced_by else ""
        left_out = {f"{role}.{name}": radii for name, radii in self.left_out.items()}
        return Searched(self.share, reduced_by, self.radii, left_out)

    def reduced(self, share: float, parameter: str) -> Searched:
        """What it is of an image of which it was told of the reduced one, to a share of the sides by a parameter."""

        def larger(radii: tuple[float, ...]) -> tuple[float, ...]:
            return tuple(radius / share for radius in radii)

        left_out = {name: larger(radii) for name, radii in self.left_out.items()}
        return Searched(share * self.share, parameter, larger(self.radii), left_out)

    def to_dict(self) -> dict[str, Any]:
        """Return what a file holds of it, without what is not there: shares to .01, radii to .1 px."""
        found: dict[str, Any] = {"share": round(self.share, 2)}
        if self.reduced_by:
            found["reduced_by"] = self.reduced_by
        if self.radii:
            found["radii_px"] = [round(radius, 1) for radius in self.radii]
        if self.left_out:
            found["left_out_px"] = {name: [round(r, 1) for r in radii] for name, radii in self.left_out.items()}
        return found
