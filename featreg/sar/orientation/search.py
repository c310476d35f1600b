"""Global orientation correlation: which rotation, scale and shift align two images, by all of their pixels at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.sar.orientation.field import orientation_field, turned
from featreg.sar.pyramid import reduced
from featreg.types import FloatArray, Image

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]

#: Fields are computed on images of at most about so many pixels a side, with this alpha.
BASE_SIDE, ALPHA = 640, 3.0
#: Alignments whose corners lie this near to each other, as a share of the diagonal, are one.
NEAR = 0.1


@dataclass(frozen=True, eq=False)
class Alignment:
    """A similarity reference -> secondary.

    Parameters
    ----------
    affine : (2, 3) float64, px
    score : correlation of the fields over the standard deviation that unrelated ones of the same energy would have
    """

    affine: FloatArray
    score: float

    @property
    def scale(self) -> float:
        """Pixels of the secondary per pixel of the reference."""
        return math.sqrt(abs(float(np.linalg.det(self.affine[:, :2]))))

    def corners(self, shape: tuple[int, int]) -> FloatArray:
        """(4, 2) where the corners of an image of (H, W) lie in the secondary."""
        height, width = shape
        xy = np.array([[0, 0], [width, 0], [0, height], [width, height]], np.float64)
        return np.asarray(xy @ self.affine[:, :2].T + self.affine[:, 2])

    def alike(self, other: Alignment, shape: tuple[int, int], near: float = NEAR) -> bool:
        """Whether both map the corners of an image of (H, W) to places this near, as a share of the diagonal."""
        here, there = self.corners(shape), other.corners(shape)
        size = min(np.hypot(*(corners[3] - corners[0])) for corners in (here, there))
        return bool(np.hypot(*(here - there).T).max() <= near * size)


@dataclass(frozen=True, eq=False)
class Grid:
    """What is searched.

    Parameters
    ----------
    side : the longer side of both images is reduced to at most so many pixels
    rotation_step : degrees between neighbouring rotations, at most; there are a multiple of four
    scales : secondary over reference
    least_overlap : share of the smaller image that both must have in common, about
    """

    side: int = 48
    rotation_step: float = 7.5
    scales: Sequence[float] = (1.0,)
    least_overlap: float = 0.15


def scale_steps(largest: float, step: float) -> tuple[float, ...]:
    """Ratios from 1 / `largest` to `largest`, at most `step` apart; those nearest to 1 first."""
    half = math.ceil(math.log(largest) / math.log(step) - 1e-9)
    return tuple(largest ** (i / half) for i in sorted(range(-half, half + 1), key=abs)) if half else (1.0,)


@dataclass(frozen=True, eq=False)
class Prepared:
    """Two fields at one ground pixel size.

    Parameters
    ----------
    canvas : (n, n, 2) float32 the first one, in the middle of zeros
    second : (h, w, 2) float32
    origin : (x, y) of the first one in the canvas
    factor : its samples per pixel of the base image
    least : correlation of the squared fields at which a shift counts
    """

    canvas: F32
    second: F32
    origin: tuple[int, int]
    factor: float
    least: float

    def into(self, degrees: float) -> FloatArray:
        """(2, 3) map from the canvas to the second field turned about the middle of both."""
        angle, middle = math.radians(degrees), np.array([self.second.shape[1] - 1, self.second.shape[0] - 1]) / 2
        linear = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        return np.column_stack([linear, middle - linear @ np.full(2, len(self.canvas) / 2)])


#: What correlates two prepared fields at all rotations; see `by_spectra`.
Correlator = Callable[[Prepared, int], FloatArray]


def search(
    reference: Image, secondary: Image, grid: Grid, most: int, correlator: Correlator | None = None
) -> list[Alignment]:
    """Return the `most` best alignments that differ from each other, best first.

    Parameters
    ----------
    reference, secondary : the images
    grid : what is tried
    most : alignments
    correlator : what correlates the fields, None for `by_spectra`; `featreg.interop.torch_orientation` has another

    Notes
    -----
    Both fields are averaged down to one ground pixel size for every scale. For a rotation the secondary's is resampled
    and turned; half turns and quarter turns of it follow from its spectrum, so that one resampling and one transform
    forward serve four rotations. A correlation is divided by the square root of half the correlation of the squared
    fields: what the pixels that overlap give by chance where directions are independent, whatever share overlaps and
    wherever there is no data. Shifts beyond the transform's length fold onto others whose overlap is as small.
    """
    first, second = (_base(image) for image in (reference, secondary))
    fields = orientation_field(first, ALPHA), orientation_field(second, ALPHA)
    ratio = first.shape[1] / reference.shape[1] / (second.shape[1] / secondary.shape[1])
    found: list[tuple[float, float, float, tuple[float, float]]] = []
    rotations = math.ceil(90 / grid.rotation_step - 1e-9)
    for scale in grid.scales:
        prepared = _prepared(first, second, fields, scale / ratio, grid)
        if prepared is None:
            continue
        n = len(prepared.canvas)
        for row, (score, y, x) in enumerate((correlator or by_spectra)(prepared, rotations).tolist()):
            shift = ((x + n // 2) % n - n // 2, (y + n // 2) % n - n // 2)
            middle = [
                (n / 2 + d - o + 0.5) / prepared.factor - 0.5 for d, o in zip(shift, prepared.origin, strict=True)
            ]
            degrees = row // 4 * 90 / rotations + 90 * (row // 2 % 2) + 180 * (row % 2)
            found.append((score, degrees, scale, (middle[0], middle[1])))
    found.sort(key=lambda entry: -entry[0])
    kept: list[Alignment] = []
    for score, degrees, size, here in found:
        if not score > 0 or len(kept) == most:
            break
        one = Alignment(_affine(reference, secondary, first, degrees, size, here), score)
        if not any(one.alike(other, reference.shape) for other in kept):
            kept.append(one)
    return kept


def _base(image: Image) -> Image:
    """The image on which the field is computed."""
    return reduced(image, min(1.0, BASE_SIDE / max(image.shape)))


def _affine(
    reference: Image, secondary: Image, first: Image, degrees: float, scale: float, here: tuple[float, float]
) -> FloatArray:
    """The similarity that turns by degrees, clockwise as seen, and maps `here` to the secondary's centre."""
    angle = math.radians(degrees)
    linear = scale * np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    size = np.array([reference.shape[1] / first.shape[1], reference.shape[0] / first.shape[0]])
    at = (np.array(here) + 0.5) * size - 0.5
    centre = (np.array(secondary.shape[::-1]) - 1) / 2
    return np.column_stack([linear, centre - linear @ at])


def _prepared(first: Image, second: Image, fields: tuple[F32, F32], scale: float, grid: Grid) -> Prepared | None:
    """Both fields at one ratio of the scales, None where too little is left of one."""
    n = 2 * grid.side
    factor = min(grid.side / max(first.shape), grid.side * scale / max(second.shape), 1.0, scale)
    a, b = _averaged(fields[0], factor), _averaged(fields[1], factor / scale)
    areas = [float(image.mask.mean()) * field[..., 0].size for image, field in ((first, a), (second, b))]
    power = float(np.square(a).sum(dtype=np.float64)) * float(np.square(b).sum(dtype=np.float64))
    if not power > 0 or min(*a.shape[:2], *b.shape[:2]) < 4:
        return None
    canvas = np.zeros((n, n, 2), np.float32)
    top, left = (n - a.shape[0]) // 2, (n - a.shape[1]) // 2
    canvas[top : top + a.shape[0], left : left + a.shape[1]] = a
    return Prepared(canvas, b, (left, top), factor, grid.least_overlap * min(areas) * power / (areas[0] * areas[1]))


def by_spectra(prepared: Prepared, rotations: int) -> FloatArray:
    """Return (score, row, column) of the highest correlation at each of 4 `rotations`, (4 * rotations, 3) float64.

    Row 4 i + 2 q + h is for i * 90 / `rotations` degrees, a quarter turn where q is 1 and half a turn where h is 1.
    """
    import cv2

    from featreg.sar.orientation import orientation_kernels as kernels

    n = len(prepared.canvas)
    real, imaginary = _parts(_spectrum(prepared.canvas))
    power, nothing = _spectrum(_power(prepared.canvas)), np.zeros((n // 2, n // 2), np.complex64)
    product, products = np.empty((n, n), np.complex64), np.empty((n // 2, n // 2), np.complex64)
    out = np.empty((rotations, 2, 2, 3))
    for i in range(rotations):
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        degrees = i * 90 / rotations
        field = cv2.warpAffine(turned(prepared.second, degrees), prepared.into(degrees), (n, n), flags=flags)
        there = np.asarray(field, np.float32)
        spectrum, powers = _spectrum(there), _spectrum(_power(there))
        for quarter in (0, 1):
            kernels.cross_spectra(real, imaginary, spectrum, bool(quarter), np.float32(1 - 2 * quarter), product)
            kernels.cross_spectra(power, nothing, powers, bool(quarter), np.float32(1), products)
            kernels.highest(_inverse(product), _inverse(products), np.float32(prepared.least), out[i, quarter])
    return out.reshape(-1, 3)


def _averaged(field: F32, factor: float) -> F32:
    """The field `factor` times as large, by area weighting."""
    import cv2

    size = tuple(max(1, round(n * factor)) for n in field.shape[1::-1])
    return np.asarray(cv2.resize(field, size, interpolation=cv2.INTER_AREA), np.float32)


def _power(field: F32) -> F32:
    """The squared length of a field (n, n, 2), summed over 2 x 2 samples, as complex values (n / 2, n / 2, 2)."""
    import cv2

    square = np.square(field).sum(axis=2)
    out = np.zeros((field.shape[0] // 2, field.shape[1] // 2, 2), np.float32)
    out[..., 0] = 4 * cv2.resize(square, out.shape[1::-1], interpolation=cv2.INTER_AREA)
    return out


def _spectrum(values: F32) -> C64:
    """(n, n) spectrum of a complex map given as (n, n, 2)."""
    import cv2

    return np.asarray(cv2.dft(values, flags=cv2.DFT_COMPLEX_OUTPUT)).view(np.complex64)[..., 0]


def _inverse(spectrum: C64) -> F32:
    """(n, n, 2) complex map of a spectrum."""
    import cv2

    flags = cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_COMPLEX_OUTPUT
    return np.asarray(cv2.dft(spectrum.view(np.float32).reshape(*spectrum.shape, 2), flags=flags), np.float32)


def _parts(spectrum: C64) -> tuple[C64, C64]:
    """The spectra of the real and of the imaginary part of a complex map, from its own."""
    mirrored = np.roll(spectrum[::-1, ::-1], (1, 1), (0, 1)).conj()
    return (spectrum + mirrored) / np.complex64(2), (spectrum - mirrored) / np.complex64(2j)
