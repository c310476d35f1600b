"""The images of a report, made small enough that all of them fit into one page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import FeatregError, InputError
from featreg.io import as_image
from featreg.pictures.panels import display, resized
from featreg.types import Image

#: Longest and shortest side in pixels that a picture is reduced to, and bytes of all pictures of a page together.
LONGEST, SHORTEST, BUDGET = 1024, 256, 3_600_000
#: Samples beyond which a file is not read whole but averaged strip by strip.
LARGE = 36_000_000
#: Of WebP; speckle costs more than it shows beyond it.
QUALITY = 72


@dataclass(frozen=True)
class Picture:
    """One image as the page shows it.

    `webp` covers the pixels 0 to `extent` = (width, height) of an image of `size` = (width, height).
    """

    webp: bytes
    size: tuple[int, int]
    extent: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the image itself."""
        return self.size[1], self.size[0]


def picture(source: Any, allowance: int) -> Picture:
    """Return an image, stretched and reduced to at most about `allowance` bytes.

    Parameters
    ----------
    source : as `ReportPair.reference`
    allowance : bytes; a picture of `SHORTEST` pixels is made whatever it takes

    Raises
    ------
    InputError
        The image cannot be read.
    """
    image, size = _read(source)
    height, width = image.shape
    extent = (width, height) if size == (width, height) else _covered(size, width)
    side = min(LONGEST, max(width, height))
    # Bytes grow with the area, so one corrected step or two reach the allowance.
    for _ in range(4):
        small = _reduced(image, side / max(width, height))
        webp = _encoded(display(small))
        if len(webp) <= allowance or side <= SHORTEST:
            break
        side = max(SHORTEST, min(side - 8, int(side * np.sqrt(0.95 * allowance / len(webp)))))
    return Picture(webp, size, extent)


def _read(source: Any) -> tuple[Image, tuple[int, int]]:
    """The image, or an overview of a large one, and the (width, height) of the image itself."""
    if isinstance(source, str | Path) and Path(source).is_file():
        from featreg.io.raster_source import RasterSource

        try:
            scene = RasterSource(str(source))
            height, width = scene.shape
            if height * width > LARGE:
                return scene.overview(max(2, max(height, width) // (2 * LONGEST))), (width, height)
        except (FeatregError, AttributeError):
            # Whatever is wrong with the file, reading it whole says it better.
            pass
    image = source() if callable(source) else as_image(source)
    if not isinstance(image, Image):
        raise InputError(f"an image of a report must be an Image, got {type(image).__name__}")
    return image, (image.shape[1], image.shape[0])


def _covered(size: tuple[int, int], width: int) -> tuple[int, int]:
    """What an overview shows of its scene: whole cells only."""
    factor = size[0] // width
    return size[0] // factor * factor, size[1] // factor * factor


def _reduced(image: Image, factor: float) -> Image:
    if factor >= 1:
        return image
    amplitude, mask = resized(image.amplitude, image.mask, factor)
    return Image(np.asarray(np.where(mask, amplitude, 0), np.float32), np.asarray(mask))


def _encoded(gray: NDArray[np.uint8]) -> bytes:
    import cv2

    good, webp = cv2.imencode(".webp", gray, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    if not good:
        raise InputError("this build of OpenCV cannot write WebP, which the report's pictures need")
    return bytes(webp.tobytes())
