"""The point response of a SAR system and the fully developed speckle that it makes."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Predicate
from numpy.typing import ArrayLike, NDArray

from featreg.runtime.parameters import checked
from featreg.types import FloatArray

#: Processed band over sampling rate, and the pedestal of the raised-cosine weighting: 3 dB width 1.3 px, side lobes
#: 31 dB down, as detected products have them.
BAND = 0.9
PEDESTAL = 0.6
#: Pixels on each side of a point beyond which its response is left out.
RADIUS = 8


def point_response(distance: ArrayLike) -> FloatArray:
    """Amplitude of the system's response at `distance` pixels along one axis, 1 at 0.

    The response is band-limited below the sampling rate, so that a point target may stand at any fraction of a pixel.
    """
    t = BAND * np.asarray(distance, dtype=np.float64)
    side = 0.5 * (1 - PEDESTAL)
    return np.asarray((PEDESTAL * np.sinc(t) + side * (np.sinc(t - 1) + np.sinc(t + 1))) / PEDESTAL, dtype=np.float64)


def response_kernel() -> NDArray[np.float32]:
    """(2 RADIUS + 1,) float32 samples of the response along one axis, of unit energy."""
    kernel = point_response(np.arange(-RADIUS, RADIUS + 1))
    return np.asarray(kernel / np.sqrt((kernel**2).sum()), dtype=np.float32)


def whole_or_infinite(looks: float) -> bool:
    """Whether a number of looks is one."""
    return looks == math.inf or looks == int(looks)


Looks = Annotated[float, Ge(1), Predicate(whole_or_infinite)]


def speckle_field(shape: tuple[int, int], looks: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Intensity of multi-look speckle over a scene of backscatter 1.

    Parameters
    ----------
    shape : (H, W)
    looks : L, independent looks averaged in intensity; `math.inf` for none at all
    rng : source of the randomness

    Returns
    -------
    (H, W) float32 intensity of mean 1 and variance 1 / L, correlated as the point response has it

    Raises
    ------
    ParameterError
        `looks` is no whole number of at least 1.
    """
    return speckled_intensity(np.ones(shape, np.float32), None, looks, rng)


@checked("")
def speckled_intensity(
    backscatter: NDArray[np.float32],
    coherent: NDArray[np.complex64] | None,
    looks: Looks,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Intensity image that the system makes of a rough surface and of point targets.

    Parameters
    ----------
    backscatter : (H, W) float32 mean intensity of the surface in each pixel
    coherent : (H, W) complex64 field of the point targets as imaged, the same in every look; None where there are none
    looks : L, independent looks averaged in intensity; `math.inf` gives the expected image
    rng : source of the randomness

    Returns
    -------
    (H, W) float32 intensity

    Notes
    -----
    Every look is a circular complex Gaussian field of the surface's local power, filtered by the point response. So
    edges are blurred by the system, and speckle is correlated over about one resolution cell, not from pixel to pixel
    as a gamma law drawn per pixel would have it.
    """
    import cv2

    kernel = response_kernel()

    def imaged(field: NDArray[np.float32], taps: NDArray[np.float32]) -> Any:
        blurred = cv2.sepFilter2D(field, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_CONSTANT)
        return blurred[RADIUS:-RADIUS, RADIUS:-RADIUS]

    padded = np.pad(backscatter.astype(np.float32, copy=False), RADIUS, mode="edge")
    targets = np.zeros(backscatter.shape, np.complex64) if coherent is None else coherent
    if looks == math.inf:
        expected: NDArray[np.float32] = imaged(padded, kernel**2) + np.abs(targets) ** 2
        return expected
    amplitude = np.sqrt(0.5 * padded)[..., None]
    steady = np.stack([targets.real, targets.imag], axis=-1)
    intensity = np.zeros(backscatter.shape, np.float32)
    for _ in range(int(looks)):
        surface = imaged(amplitude * rng.standard_normal((*padded.shape, 2), dtype=np.float32), kernel)
        intensity += np.square(surface + steady).sum(axis=-1)
    return intensity / np.float32(looks)


def point_field(xy: FloatArray, amplitude: NDArray[np.complex128], shape: tuple[int, int]) -> NDArray[np.complex64]:
    """(H, W) complex64 image of point targets at (N, 2) pixel positions, each with its complex peak amplitude."""
    height, width = shape
    field = np.zeros((height + 4 * RADIUS, width + 4 * RADIUS), np.complex64)
    inside = ((xy > -RADIUS) & (xy < np.array([width, height]) - 1 + RADIUS)).all(axis=1)
    xy, amplitude = xy[inside], amplitude[inside]
    nearest = np.floor(xy + 0.5).astype(np.int64)
    steps = np.arange(-RADIUS, RADIUS + 1)
    along_x = point_response(steps - (xy - nearest)[:, :1])
    along_y = point_response(steps - (xy - nearest)[:, 1:])
    patches = amplitude[:, None, None] * along_y[:, :, None] * along_x[:, None, :]
    rows = nearest[:, 1, None, None] + steps[:, None] + 2 * RADIUS
    columns = nearest[:, 0, None, None] + steps + 2 * RADIUS
    np.add.at(field, (rows, columns), patches.astype(np.complex64))
    return field[2 * RADIUS : 2 * RADIUS + height, 2 * RADIUS : 2 * RADIUS + width]
