"""Pairs of SAR images of one made-up landscape, with the exactly known geometry between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.runtime.parameters import checked
from featreg.runtime.watching import Progress, Steps
from featreg.simulate.landscape import Landscape, Surface
from featreg.simulate.speckle_field import RADIUS, Looks, point_field, speckled_intensity
from featreg.types import FloatArray, read_only

#: Thermal noise as intensity relative to an average field (-17 dB).
NOISE = 0.02
#: Outlines are painted on a grid this many times finer than the pixels, then averaged over each pixel.
FINER = 4
#: Rows painted at a time, so that a large image needs little memory.
STRIP = 256


@dataclass(frozen=True, eq=False)
class SimulatedPair:
    """Two images of one landscape and the truth between them.

    Parameters
    ----------
    reference, secondary : (H, W) float32 linear amplitude, about 1 over an average field
    truth : (2, 3) float64 matrix, reference -> secondary in pixel coordinates
    targets : (N, 2) float64 reference positions of the point targets that stand alone and unchanged, at any fraction
        of a pixel, seen by both images
    """

    reference: NDArray[np.float32]
    secondary: NDArray[np.float32]
    truth: FloatArray
    targets: FloatArray


def similarity_matrix(
    shape: tuple[int, int], rotation_deg: float, scale: float, shift: tuple[float, float]
) -> FloatArray:
    """(2, 3) matrix of a turn and a zoom about the image centre, then a shift.

    Parameters
    ----------
    shape : (H, W) of the image whose centre stays in place but for the shift
    rotation_deg : degrees, counter-clockwise on the displayed image (y up)
    scale : size in the secondary of one reference pixel
    shift : (x, y) pixels by which the centre moves
    """
    angle = math.radians(rotation_deg)
    # y points down, which turns the sign of the usual rotation matrix
    linear = scale * np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    centre = (np.array(shape[::-1], dtype=np.float64) - 1) / 2
    return np.column_stack([linear, centre + np.asarray(shift, dtype=np.float64) - linear @ centre])


@checked("sar_pair")
def sar_pair(
    shape: tuple[int, int] = (600, 600),
    *,
    looks: Looks = 4,
    rotation_deg: Annotated[float, Interval(gt=-math.inf, lt=math.inf)] = 6.0,
    scale: Annotated[float, Interval(ge=0.1, le=10)] = 1.02,
    shift: tuple[float, float] = (12.0, -7.0),
    change: Annotated[float, Interval(ge=0, le=1)] = 0.05,
    seed: int = 0,
    progress: Progress | None = None,
) -> SimulatedPair:
    """Simulate two detected SAR images of one landscape, taken on different dates.

    Parameters
    ----------
    shape : (H, W) of both images, at least 64 x 64
    looks : independent looks averaged in intensity; `math.inf` gives both images without speckle and thermal noise
    rotation_deg : degrees by which the secondary is turned about the image centre, counter-clockwise as seen
    scale : size in the secondary of one reference pixel
    shift : (x, y) pixels by which the image centre moves
    change : share of the fields, buildings and point targets that differ between the dates, 0 to 1; ships and cars
        move whenever it is not 0
    seed : the same seed gives the same pair; with equal other arguments the reference does not depend on the rotation
    progress : called with (images made, images in all)

    Returns
    -------
    `SimulatedPair`

    Raises
    ------
    ParameterError
        An argument outside its range.

    Notes
    -----
    The landscape is a list of outlines and points in continuous coordinates. Each image is rendered from that list
    through its own geometry and its own speckle: neither is a resampled copy of the other, and no interpolation blurs
    what a matcher sees. The point response is the same in both, in pixels of the image, as for one sensor that
    passes twice. Shadows and bright walls belong to the landscape (one look direction).

    Examples
    --------
    >>> pair = sar_pair((128, 128), rotation_deg=4.0, seed=1)
    >>> pair.reference.shape, pair.truth.shape
    ((128, 128), (2, 3))
    """
    from featreg.simulate.scenery import countryside

    if len(shape) != 2 or min(shape) < 64:
        raise ParameterError(f"shape must be (H, W) of at least 64 x 64, got {tuple(shape)}")
    if not np.isfinite(shift).all() or len(shift) != 2:
        raise ParameterError(f"shift (x, y) must be finite, got {shift}")
    truth = similarity_matrix(shape, rotation_deg, scale, shift)
    # a disc that holds both images whatever the rotation, in steps, so that a small shift leaves the landscape alone
    diagonal = math.hypot(*shape) / 2
    seen = max(diagonal, (diagonal + math.hypot(*shift)) / scale) + 2 * RADIUS
    layout, ground, first, second = np.random.default_rng(seed).spawn(4)
    reach = 64.0 * math.ceil(seen / 64)
    land = countryside(shape, reach, change, layout)
    textures = Textures.made(shape, reach, ground)
    still = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    steps = Steps(2, progress)
    reference = render(land, textures, still, shape, 0, looks, first)
    steps.advance()
    secondary = render(land, textures, truth, shape, 1, looks, second)
    steps.advance()
    targets = land.xy[land.isolated]
    margin, limit = RADIUS, np.array(shape[::-1]) - 1 - RADIUS
    both = [((xy > margin) & (xy < limit)).all(axis=1) for xy in (targets, _mapped(truth, targets))]
    return SimulatedPair(reference, secondary, read_only(truth), read_only(targets[both[0] & both[1]]))


def _mapped(matrix: FloatArray, xy: FloatArray) -> FloatArray:
    return xy @ matrix[:, :2].T + matrix[:, 2]


@dataclass(frozen=True, eq=False)
class Textures:
    """Two natural textures of the ground as gamma-distributed fields of mean 1 on a lattice of one pixel."""

    origin: FloatArray
    coarse: NDArray[np.float32]
    fine: NDArray[np.float32]

    @classmethod
    def made(cls, shape: tuple[int, int], reach: float, rng: np.random.Generator) -> Textures:
        origin = np.floor((np.array(shape[::-1]) - 1) / 2 - reach)
        side = int(2 * reach) + 2
        return cls(origin, gamma_field(side, 5.0, 3, rng), gamma_field(side, 1.2, 2, rng))

    def at(
        self, xy: tuple[NDArray[np.float64], NDArray[np.float64]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Both textures at the points, exact to any fraction of a pixel, which `cv2.remap` is not."""
        from scipy.ndimage import map_coordinates

        where = [xy[1] - self.origin[1], xy[0] - self.origin[0]]
        coarse, fine = (map_coordinates(t, where, order=1, mode="nearest") for t in (self.coarse, self.fine))
        return coarse, fine


def gamma_field(side: int, smoothness: float, order: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """(side, side) smooth field whose values follow a gamma law of mean 1 and variance 1 / order."""
    import cv2

    radius = math.ceil(4 * smoothness)
    taps = cv2.getGaussianKernel(2 * radius + 1, smoothness, cv2.CV_32F)
    taps = taps / np.sqrt((taps**2).sum())
    total = np.zeros((side, side), np.float32)
    for _ in range(2 * order):  # a sum of squared Gaussian fields is gamma-distributed
        white = rng.standard_normal((side, side), dtype=np.float32)
        total += np.square(cv2.sepFilter2D(white, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_REFLECT))
    return total / np.float32(2 * order)


def render(
    land: Landscape,
    textures: Textures,
    matrix: FloatArray,
    shape: tuple[int, int],
    date: int,
    looks: float,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """(H, W) float32 amplitude of the landscape as the image with `matrix` (landscape -> pixel) sees it."""
    height, width = shape
    inverse = np.linalg.inv(matrix[:, :2])
    surfaces = [(_mapped(matrix, s.outline), s) for s in land.surfaces if not math.isnan(s.backscatter[date])]
    backscatter = np.empty(shape, np.float32)
    for top in range(0, height, STRIP):
        rows = min(STRIP, height - top)
        strip = painted([(outline - [0, top], s) for outline, s in surfaces], (rows, width), date)
        x, y = np.meshgrid(np.arange(width) - matrix[0, 2], np.arange(top, top + rows) - matrix[1, 2])
        coarse, fine = textures.at((inverse[0, 0] * x + inverse[0, 1] * y, inverse[1, 0] * x + inverse[1, 1] * y))
        grain = (1 + strip[..., 1] * (coarse - 1)) * (1 + strip[..., 2] * (fine - 1))
        backscatter[top : top + rows] = strip[..., 0] * grain
    there = land.amplitude[:, date] > 0
    complex_amplitude = land.amplitude[there, date] * np.exp(1j * land.phase[there])
    targets = point_field(_mapped(matrix, land.xy[there]), complex_amplitude, shape)
    noise = np.float32(0 if looks == math.inf else NOISE)
    return np.sqrt(speckled_intensity(backscatter + noise, targets, looks, rng))


def painted(surfaces: list[tuple[FloatArray, Surface]], shape: tuple[int, int], date: int) -> NDArray[np.float32]:
    """(H, W, 3) float32 backscatter and shares of the coarse and fine texture, averaged over each pixel."""
    import cv2

    from featreg.simulate.paint_kernels import paint_outlines

    height, width = shape
    canvas = np.zeros((height * FINER, width * FINER, 3), np.float32)
    corners = np.concatenate([outline for outline, _ in surfaces])
    ends = np.cumsum([len(outline) for outline, _ in surfaces])
    colours = np.array([(s.backscatter[date], s.coarse, s.fine) for _, s in surfaces])
    paint_outlines(canvas, (corners + 0.5) * FINER - 0.5, ends, colours)
    return np.asarray(cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)
