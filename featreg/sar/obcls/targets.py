"""Extended targets: CFAR detections, clustered, cleaned and reduced to the centres of mass of connected regions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Interval, Predicate
from numpy.typing import NDArray

from featreg.runtime.parameters import Count, checked
from featreg.sar.obcls import cfar
from featreg.sar.speckle import mean_amplitude
from featreg.types import BoolArray, FloatArray, Image, IntArray


@dataclass(frozen=True, eq=False)
class Targets:
    """Connected regions of detected pixels, largest first.

    Parameters
    ----------
    xy : (N, 2) float64 centres of mass, px
    area : (N,) int64 number of pixels
    """

    xy: FloatArray
    area: IntArray

    def __len__(self) -> int:
        return len(self.xy)


def odd(number: int) -> bool:
    """Whether a number of pixels has one in the middle."""
    return number % 2 == 1


Order = Annotated[int, Interval(ge=1, le=25)]
Side = Annotated[int, Ge(1), Predicate(odd)]


@checked("targets")
def targets(
    image: Image,
    *,
    order: Order = 17,
    median: Side = 7,
    min_area: Count = 1,
    zeros_are_data: bool = False,
    **detection: Any,
) -> Targets:
    """Return the extended targets of an image, computed once per image and set of parameters.

    Parameters
    ----------
    image : amplitude or complex
    order : of the 5 x 5 order filter that fills targets, 1 to 25 from the smallest
    median : side of the median filter that removes what is small; 1 for none
    min_area : fewest pixels of a target
    zeros_are_data : whether areas of exactly zero amplitude are data; if not, they are neither tested nor trained on
    detection : parameters of `featreg.sar.obcls.cfar.detect`

    Raises
    ------
    ParameterError
        An impossible value.
    """
    return image.derive(
        _targets, order=order, median=median, min_area=min_area, zeros_are_data=zeros_are_data, **detection
    )


def _targets(image: Image, order: int, median: int, min_area: int, zeros_are_data: bool, **detection: Any) -> Targets:
    valid = image.mask if zeros_are_data else covered(image)
    # Relative to the mean, so that powers stay in float32's range whatever the image's calibration.
    relative = image.amplitude * np.float32(1 / max(mean_amplitude(image), 1e-30))
    found = cfar.detect(np.square(relative), valid, **detection)
    return regions(median_filter(order_filter(found, order), median), min_area)


def covered(image: Image) -> BoolArray:
    """Return the (H, W) valid pixels less the areas of exactly zero amplitude, which no radar sees: they were padded.

    Single zeros stay, for quantised images have them in shadows.
    """
    return image.derive(_covered)


def _covered(image: Image) -> BoolArray:
    import cv2

    dark = (image.amplitude == 0).view(np.uint8)
    if not dark.any():
        return image.mask
    area = cv2.morphologyEx(dark, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
    data: BoolArray = image.mask & (np.asarray(area) == 0)
    return data


def order_filter(binary: BoolArray, order: int = 17, side: int = 5) -> BoolArray:
    """Return the `order`-th smallest of the side x side neighbourhood of every pixel; outside the image all is False.

    Of a binary map that is True where more than side^2 - order neighbours are.
    """
    reached: BoolArray = _count(binary, side) > side * side - order
    return reached


def median_filter(binary: BoolArray, side: int = 7) -> BoolArray:
    """Return the median of the side x side neighbourhood of every pixel; outside the image all is False."""
    return binary if side == 1 else order_filter(binary, side * side // 2 + 1, side)


def _count(binary: BoolArray, side: int) -> NDArray[Any]:
    import cv2

    return np.asarray(
        cv2.boxFilter(binary.view(np.uint8), cv2.CV_16U, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    )


def regions(binary: BoolArray, min_area: int = 1) -> Targets:
    """Return the 8-connected regions of a binary map, largest first, ties in reading order."""
    import cv2

    _, _, stats, centres = cv2.connectedComponentsWithStats(binary.view(np.uint8), connectivity=8)
    area = stats[1:, cv2.CC_STAT_AREA].astype(np.int64)
    rows = np.argsort(-area, kind="stable")
    rows = rows[area[rows] >= min_area]
    return Targets(np.asarray(centres[1:], np.float64)[rows], area[rows])
