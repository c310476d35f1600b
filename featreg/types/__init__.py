"""What flows through featreg: Image, Features, Matches, and the gates by which a result is judged.

Coordinate convention, valid everywhere in this package
--------------------------------------------------------
* A point is (x, y) = (column, row) in float64; the centre of the first pixel is (0, 0).
* Resizing an image by a factor s moves a point to ``(x + 0.5) * s - 0.5``.
* A model maps reference -> secondary pixel coordinates.
* Angles are counter-clockwise as seen on the displayed image (y up), 0 along +x, in radians in `Features.angle`.

All types are frozen dataclasses of arrays, checked where they are made. The arrays that they hold are read-only; those
that they were given stay as they are, and writing to them changes no object.
"""

from featreg.types.arrays import BoolArray, FloatArray, IntArray, column, everywhere, finite, kept, points, read_only
from featreg.types.features import Features
from featreg.types.gate import Gate, verdict
from featreg.types.image import Geolocation, Image
from featreg.types.matches import Matches
from featreg.types.pixel_size import PixelSize
from featreg.types.searched import Searched

__all__ = [
    "BoolArray",
    "Features",
    "FloatArray",
    "Gate",
    "Geolocation",
    "Image",
    "IntArray",
    "Matches",
    "PixelSize",
    "Searched",
    "column",
    "everywhere",
    "finite",
    "kept",
    "points",
    "read_only",
    "verdict",
]
