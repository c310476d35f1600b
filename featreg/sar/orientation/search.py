"""Global orientation correlation: which rotation, scale and shift align two images, by all of their pixels at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
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


def search(reference: Image, secondary: Image, grid: Grid, most: int) -> list[Alignment]:
    """Return the `most` best alignments that differ from each other, best first.

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
    for scale in grid.scales:
        found.extend(_at_scale(first, second, fields, scale / ratio, grid))
    found.sort(key=lambda entry: -entry[0])
    kept: list[Alignment] = []
    for score, degrees, size, here in found:
        if not score > 0 or len(kept) == most:
            break
        one = Alignment(_affine(reference, secondary, first, degrees, size * ratio, here), score)
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


def _at_scale(
    first: Image, second: Image, fields: tuple[F32, F32], scale: float, grid: Grid
) -> Iterator[tuple[float, float, float, tuple[float, float]]]:
    """Yield (score, degrees, scale, point of the first image at the second's centre) of every rotation."""
    import cv2

    from featreg.sar.orientation import orientation_kernels as kernels

    n = 2 * grid.side
    factor = min(grid.side / max(first.shape), grid.side * scale / max(second.shape), 1.0, scale)
    a, b = _averaged(fields[0], factor), _averaged(fields[1], factor / scale)
    area_a, area_b = first.mask.mean() * a[..., 0].size, second.mask.mean() * b[..., 0].size
    if not area_a or not area_b or min(*a.shape[:2], *b.shape[:2]) < 4:
        return
    canvas = np.zeros((n, n, 2), np.float32)
    top, left = (n - a.shape[0]) // 2, (n - a.shape[1]) // 2
    canvas[top : top + a.shape[0], left : left + a.shape[1]] = a
    real, imaginary = _parts(_spectrum(canvas))
    power = _power(canvas)
    power_spectrum, nothing = _spectrum(_with_zero(power)), np.zeros((n // 2, n // 2), np.complex64)
    density = float(power.sum()) / area_a * float(np.square(b).sum(dtype=np.float64)) / area_b
    if not density > 0:
        return
    least = np.float32(grid.least_overlap * min(area_a, area_b) * density)
    middle = np.array([b.shape[1] - 1, b.shape[0] - 1]) / 2
    product, products = np.empty((n, n), np.complex64), np.empty((n // 2, n // 2), np.complex64)
    best = np.empty((2, 3))
    rotations = math.ceil(90 / grid.rotation_step - 1e-9)
    for i in range(rotations):
        degrees = i * 90 / rotations
        angle = math.radians(degrees)
        linear = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        into = np.column_stack([linear, middle - linear @ [n / 2, n / 2]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        there = np.asarray(cv2.warpAffine(turned(b, degrees), into, (n, n), flags=flags), np.float32)
        spectrum, powers = _spectrum(there), _spectrum(_with_zero(_power(there)))
        for quarter in (False, True):
            kernels.cross_spectra(real, imaginary, spectrum, quarter, np.float32(-1 if quarter else 1), product)
            kernels.cross_spectra(power_spectrum, nothing, powers, quarter, np.float32(1), products)
            kernels.highest(_inverse(product), _inverse(products), least, best)
            for half in (0, 1):
                score, row, column = best[half].tolist()
                shift = ((column + n // 2) % n - n // 2, (row + n // 2) % n - n // 2)
                at = tuple((n / 2 + d - o + 0.5) / factor - 0.5 for d, o in zip(shift, (left, top), strict=True))
                yield score, degrees + 90 * quarter + 180 * half, scale, (at[0], at[1])


def _averaged(field: F32, factor: float) -> F32:
    """The field `factor` times as large, by area weighting."""
    import cv2

    size = tuple(max(1, round(n * factor)) for n in field.shape[1::-1])
    return np.asarray(cv2.resize(field, size, interpolation=cv2.INTER_AREA), np.float32)


def _power(field: F32) -> F32:
    """The squared length of a field (n, n, 2), summed over 2 x 2 samples."""
    import cv2

    square = field[..., 0] ** 2 + field[..., 1] ** 2
    size = (field.shape[1] // 2, field.shape[0] // 2)
    return np.asarray(4 * cv2.resize(square, size, interpolation=cv2.INTER_AREA), np.float32)


def _with_zero(values: F32) -> F32:
    """Real values as complex ones, (n, n, 2)."""
    return np.stack([values, np.zeros_like(values)], axis=-1)


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
