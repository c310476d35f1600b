"""What a result records of the images it is made from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from featreg.interfaces import Matcher, Model
from featreg.io.raster_source import ImageSource, RasterSource, SampleSource, Source
from featreg.results.input_image import InputImage
from featreg.sar.absurd import fill_hint
from featreg.types import FloatArray, Image

# Pixels over which the scale of a model is told.
STEP = 32.0


def input_image(image: Image | Source) -> InputImage:
    """Return the record of an image, or of a scene that is read by windows, whose valid pixels nobody counts."""
    if isinstance(image, ImageSource):
        image = image.image
    place, size = image.geolocation, None
    told: dict[str, Any]
    if place is not None:
        from featreg.geolocation.pixel_size import pixel_size

        size = pixel_size(place)
    if isinstance(image, Image):
        count = image.valid_count
        told = {"band": image.band, "calibration": image.calibration, "nodata": image.nodata}
        return InputImage(image.name, image.shape, image.scale, image.source_dtype, count, size, place, **told)
    told = {
        "band": None if image.band is None else str(image.band),
        "calibration": image.calibrate if isinstance(image, RasterSource) else None,
        "nodata": image.nodata if isinstance(image, SampleSource) else None,
    }
    return InputImage(image.path, image.shape, image.known_scale, image.dtype, None, size, place, **told)


def searched_record(matcher: Matcher, reference: Image, secondary: Image) -> dict[str, Any]:
    """Return where a matcher looks in two images, as a result records it; empty where it does not tell."""
    found = matcher.searched_in(reference, secondary)
    return {} if found is None else {"reference": found[0].to_dict(), "secondary": found[1].to_dict()}


def pixel_ratio(reference: InputImage, secondary: InputImage, initial: Model | None = None) -> tuple[float, float]:
    """Return the size (x, y) of a pixel of the secondary over that of one of the reference.

    From a model known beforehand, or where both images state their pixels in one unit; else 1.
    """
    if initial is not None:
        height, width = reference.shape
        scale = local_scale(initial, (width / 2, height / 2))
        return (1 / scale, 1 / scale) if scale else (1.0, 1.0)
    first, second = reference.pixel_size, secondary.pixel_size
    if first is None or second is None or first.unit != second.unit:
        return 1.0, 1.0
    return second.x / first.x, second.y / first.y


def local_scale(transfer: Callable[[FloatArray], FloatArray], at: tuple[float, float]) -> float:
    """Pixels of the secondary that one of the reference is long, around a point of it; 0 where it cannot be told."""
    steps = np.array([(0, 0), (1, 0), (0, 1)], np.float64) * STEP
    mapped = transfer(np.array(at) + steps)
    area = abs(float(np.linalg.det((mapped[1:] - mapped[0]) / STEP)))
    return float(np.sqrt(area)) if 0 < area < np.inf else 0.0


def with_hints(reason: str, reference: Image, secondary: Image) -> str:
    """Return why a registration is not trusted, and what in the samples of either image may be the cause."""
    if not reason:
        return reason
    hints = (fill_hint(reference, "reference"), fill_hint(secondary, "secondary"))
    return "; ".join([reason, *filter(None, hints)])
