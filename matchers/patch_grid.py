"""The baseline of OBCLS: tie points by the correlation of patches on a uniform grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge

from featreg.geometry import Rigid
from featreg.interfaces import Matcher
from featreg.registry import register
from featreg.runtime.parameters import Count
from featreg.runtime.timing import stage
from featreg.sar.obcls.association import Map
from featreg.sar.obcls.patch_location import PatchLocation, Samples, check_samples
from featreg.types import FloatArray, Image, Matches


@register("patch-grid")
@dataclass(frozen=True)
class PatchGrid(Matcher):
    """Tie points at the correlation peaks of patches on a uniform grid, for images that are nearly aligned.

    Parameters
    ----------
    tie_points : "cc" (peak of the modulus of the complex correlation) or "rc" (of the correlation of the amplitudes)
    patch, patch_width : height and width of the patches, px; a width of 0 is that of the height
    step : distance of neighbouring patches along both axes, px; 0 for patches that touch
    subpixel : whether the correlation peak is interpolated
    passes : the secondary is aligned by what a pass found and correlated again, at most so often in all
    zeros_are_data : whether areas of exactly zero amplitude are data

    Notes
    -----
    The shift between the images must stay below a patch. The patches' means are removed.

    References
    ----------
    L. Pallotta, G. Giunta, C. Clemente, "SAR image registration in the presence of rotation and translation: a
    constrained least squares approach", IEEE Geosci. Remote Sens. Lett. 18(9), 1595-1599, 2021, as described in L.
    Pallotta et al., "SAR coregistration by robust selection of extended targets and iterative outlier cancellation"
    """

    tie_points: Samples = "rc"
    patch: Annotated[int, Ge(4)] = 100
    patch_width: Annotated[int, Ge(0)] = 0
    step: Annotated[int, Ge(0)] = 0
    subpixel: bool = True
    passes: Count = 1
    zeros_are_data: bool = False

    @property
    def reach(self) -> float:
        """Half a patch."""
        return max(self.patch, self.patch_width) / 2

    @property
    def complex_only(self) -> bool:
        return self.tie_points == "cc"

    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return one tie point per patch that holds something, wrong ones included.

        Raises
        ------
        InputError
            "cc" of images that are not complex.
        """
        check_samples(self.tie_points, reference, secondary)
        shape = np.minimum(reference.shape, secondary.shape)
        size = np.minimum((self.patch, self.patch_width or self.patch), shape)
        y, x = (
            np.arange(extent // 2, length - (extent - 1) // 2, self.step or extent)
            for extent, length in zip(size, shape, strict=True)
        )
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2).astype(np.float64)
        way = PatchLocation(
            self.tie_points, (int(size[0]), int(size[1])), self.passes, self.subpixel, False, self.zeros_are_data
        )
        with stage("tie points"):
            return way.locate(reference, secondary, grid, grid, _fitted)


def _fitted(reference_xy: FloatArray, secondary_xy: FloatArray) -> Map | None:
    return Rigid.from_estimate(reference_xy, secondary_xy) or None
