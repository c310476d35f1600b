"""What a result records of the images it is made from."""

from __future__ import annotations

import numpy as np

from featreg.io.raster_source import ImageSource, Source
from featreg.results.input_image import InputImage
from featreg.sar.absurd import fill_hint
from featreg.types import Image


def input_image(image: Image | Source) -> InputImage:
    """Return the record of an image, or of a scene that is read by windows, whose valid pixels nobody counts."""
    if isinstance(image, ImageSource):
        image = image.image
    place, size = image.geolocation, None
    if place is not None:
        from featreg.geolocation.pixel_size import pixel_size

        size = pixel_size(place)
    if isinstance(image, Image):
        count = int(np.count_nonzero(image.mask))
        return InputImage(image.name, image.shape, image.scale, image.source_dtype, count, size, place)
    return InputImage(image.name, image.shape, image.known_scale, image.dtype, None, size, place)


def with_hints(reason: str, reference: Image, secondary: Image) -> str:
    """Return why a registration is not trusted, and what in the samples of either image may be the cause."""
    if not reason:
        return reason
    hints = (fill_hint(reference, "reference"), fill_hint(secondary, "secondary"))
    return "; ".join([reason, *filter(None, hints)])
