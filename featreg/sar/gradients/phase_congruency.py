"""Phase congruency of a SAR image: where the phases of all scales agree, whatever the contrast there.

Notes
-----
With a_so the response amplitude of scale s and orientation o, E_o the energy (the sum of the responses projected on
their mean direction, less their deviation from it), T_o the noise and w_o the weight of the spread over scales:
``PC_o = w_o max(E_o - T_o, 0) / (sum_s a_so + floor)``. Its principal moments over the orientations are RIFT's corner
map (minimum) and edge map (maximum); the orientation of the largest ``sum_s a_so`` is the maximum index.

Departures from both, each measured on real pairs. The view is log(1 + amplitude / mean) by default: the logarithm
alone turns dark speckle into the strongest structure of all, and the amplitude lets a few scatterers rule; points of
the minimum moment were found again (within 1.5 px) in 0.43 of the cases instead of 0.30. `floor` is of the order of
the noise, where Kovesi has 1e-4: structure weaker than that is no more a corner than none. The index has a fraction:
the vertex of the parabola through the largest amplitude and its two neighbours, so that it can be turned by any angle.
One noise threshold, from some places and all orientations, holds for each of these: speckle hardly has a direction,
but estimates from few samples do; with `exact` every orientation has its own, from all pixels, as Kovesi has it.

References
----------
P. Kovesi, "Phase congruency detects corners and edges", DICTA 2003, 309; P. Kovesi, "Image features from phase
congruency", Videre 1 (1999) 1. J. Li, Q. Hu, M. Ai, "RIFT: multi-modal image matching based on radiation-variation
insensitive feature transform", IEEE TIP 29 (2020) 3296, DOI 10.1109/TIP.2019.2959244.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.runtime.parameters import Positive, checked
from featreg.sar.gradients.log_gabor import LogGabor, finest_amplitude, pieces
from featreg.sar.speckle import mean_amplitude
from featreg.types import BoolArray, FloatArray, Image, read_only

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

#: What the parameters of `Congruency` may be, wherever they stand.
Noise = Annotated[float, Interval(gt=-math.inf, lt=math.inf)]
View = Literal["soft-log", "amplitude"]
# Steps of the index map in half a turn.
STEPS = 240
# Samples along each side, about, from which a quantile and the noise are estimated.
SAMPLE, NOISE_SAMPLE = 70, 24
# Black: below this share of the mean amplitude, all over squares of RIM_SIDE pixels, over RIM_SHARE of the image.
DARK, RIM_SIDE, RIM_SHARE = 0.05, 7, 1e-3
# What a share of valid pixels must exceed for their mean to be used.
LEAST_SHARE = 0.02


@checked("Congruency")
@dataclass(frozen=True)
class Congruency:
    """Parameters of phase congruency beside its filters.

    Parameters
    ----------
    noise : standard deviations above the mean of the noise energy that an energy must exceed
    floor : added to the sum of amplitudes, in units of the view
    view : "soft-log", log(1 + amplitude / mean), or "amplitude", amplitude / mean
    cut_off, gain : centre and steepness of the logistic weight of the spread over scales
    exact : take the noise threshold of each orientation from all valid pixels, instead of one for all from some
    """

    noise: Noise = 0.0
    floor: Positive = 0.1
    view: View = "soft-log"
    cut_off: float = 0.5
    gain: float = 3.0
    exact: bool = False


def congruency_maps(image: Image, bank: LogGabor, congruency: Congruency) -> tuple[F32, F32, U8, BoolArray]:
    """Return the maps of phase congruency, computed once per image and parameters.

    Parameters
    ----------
    image : the image; invalid pixels, and black rims (see `without_rim`), count as the mean of what lies around them
    bank : the filters
    congruency : the rest

    Returns
    -------
    largest, smallest : (H, W) float32 principal moments, the edge map and the corner map
    index : (H, W) uint8 in steps of 1/240 of half a turn: the normal of the strongest orientation, from x towards y
    valid : (H, W) bool, pixels of the image that are data and no black rim
    """
    return image.derive(_maps, bank=bank, congruency=congruency)


def without_rim(image: Image) -> Image:
    """Return the image with black areas at its border, such as a warp leaves in 8-bit images, counted as invalid.

    Black is what is nowhere above 5 % of the mean amplitude in a 7 x 7 square, in areas of at least 0.1 % of the image
    that touch its border: even calm water under speckle hardly ever is.
    """
    return image.derive(_without_rim) or image


def bytes_of(strength: F32, valid: BoolArray, quantile: float = 0.99, *, whole: bool = False) -> U8:
    """Return a map in (H, W) uint8, 255 standing for a quantile of its valid pixels and all above; zero if that is.

    Of about 5000 of them, unless `whole`.
    """
    import cv2

    step = 1 if whole else max(1, min(strength.shape) // SAMPLE)
    sample = strength[::step, ::step][valid[::step, ::step]]
    top = float(np.quantile(sample, quantile)) if sample.size else 0.0
    if not top > 0:
        return np.zeros(strength.shape, np.uint8)
    return np.asarray(cv2.convertScaleAbs(strength, alpha=255 / top), np.uint8)


def _maps(image: Image, bank: LogGabor, congruency: Congruency) -> tuple[F32, F32, U8, BoolArray]:
    from featreg.sar.gradients import congruency_kernels

    usable = without_rim(image)
    view = _view(usable, congruency.view, bank.margin)
    noise = _noise(view, usable.mask, bank, congruency).astype(np.float32)
    floor, gain, cut_off = (np.float32(v) for v in (congruency.floor, congruency.gain, congruency.cut_off))
    angles = [math.pi * o / bank.orientations for o in range(bank.orientations)]
    directions = [(np.float32(math.cos(angle)), np.float32(math.sin(angle))) for angle in angles]
    largest, smallest = np.empty((2, *image.shape), np.float32)
    index = np.empty(image.shape, np.uint8)
    room: F32 | None = None
    for piece in pieces(view, bank):
        top, left = piece.rows.start, piece.columns.start
        height, width = piece.rows.stop - top, piece.columns.stop - left
        # New memory costs more than what is done with it, and no piece is larger than the first.
        room = np.empty((3 + len(angles)) * height * width, np.float32) if room is None else room
        planes = room[: (3 + len(angles)) * height * width].reshape(-1, height, width)
        moments, amplitudes = planes[:3], planes[3:]
        moments[:] = 0
        for o, (cosine, sine) in enumerate(directions):
            responses = piece.responses(o)
            flat = responses.view(np.float32).reshape(len(responses), -1)
            _add_orientation(
                flat, responses.shape[2], piece.margin, piece.margin, noise[o], floor, gain, cut_off, cosine, sine,
                moments, amplitudes[o],
            )  # fmt: skip
        norm = np.float32(2 / len(angles))
        congruency_kernels.principal_moments(moments, norm, top, left, largest, smallest)
        _dominant_index(amplitudes.reshape(len(angles), -1), width, STEPS, top, left, index)
    return largest, smallest, index, usable.mask


def _add_orientation(parts: F32, *rest: Any) -> None:
    """The kernel for so many scales; the numbers in use are prepared, others compile at their first call."""
    from featreg.sar.gradients import congruency_kernels

    usual = {2: congruency_kernels.add_orientation_of_two, 4: congruency_kernels.add_orientation_of_four}
    if len(parts) in usual:
        usual[len(parts)](parts, *rest)
    else:
        congruency_kernels.add_orientation(tuple(parts), *rest)


def _dominant_index(amplitudes: F32, *rest: Any) -> None:
    """The kernel for so many orientations, likewise."""
    from featreg.sar.gradients import congruency_kernels

    usual = {4: congruency_kernels.dominant_index_of_four, 6: congruency_kernels.dominant_index_of_six}
    if len(amplitudes) in usual:
        usual[len(amplitudes)](amplitudes, *rest)
    else:
        congruency_kernels.dominant_index(tuple(amplitudes), *rest)


def _view(image: Image, name: str, reach: int) -> F32:
    """The view to be filtered, invalid pixels at the local mean of the valid ones, or at the mean of all."""
    import cv2

    view = image.amplitude / np.float32(max(mean_amplitude(image), 1e-30))
    if name == "soft-log":
        view += 1
        cv2.log(view, view)
    if image.all_valid:
        return np.asarray(view, np.float32)
    valid = image.mask.astype(np.float32)
    side = (2 * reach + 1, 2 * reach + 1)
    total = cv2.blur(view * valid, side, borderType=cv2.BORDER_CONSTANT)
    share = np.asarray(cv2.blur(valid, side, borderType=cv2.BORDER_CONSTANT))
    everywhere = float(view[image.mask].mean(dtype=np.float64)) if image.mask.any() else 0.0
    around = np.where(share > LEAST_SHARE, total / np.maximum(share, LEAST_SHARE), np.float32(everywhere))
    return np.asarray(np.where(image.mask, view, around), np.float32)


def _noise(view: F32, mask: BoolArray, bank: LogGabor, congruency: Congruency) -> FloatArray:
    """Kovesi's noise threshold of each orientation.

    Amplitudes are Rayleigh's, of the median that they have at the finest scale, and fall with the bandwidth.
    """
    middle = np.zeros(bank.orientations)
    if congruency.exact and mask.any():
        finest = np.empty(view.shape, np.float32)
        for o in range(bank.orientations):
            for piece in pieces(view, bank):
                near = (slice(piece.margin, piece.margin + s.stop - s.start) for s in (piece.rows, piece.columns))
                finest[piece.rows, piece.columns] = np.abs(piece.responses(o)[0][tuple(near)])
            middle[o] = np.median(finest[mask])
    elif mask.any():
        rows, columns = (slice(None, None, max(1, n // NOISE_SAMPLE)) for n in view.shape)
        seen = finest_amplitude(view, rows, columns, bank)[:, mask[rows, columns]]
        middle[:] = float(np.median(seen)) if seen.size else 0.0
    total = middle / math.sqrt(math.log(4)) * sum(bank.multiplier**-s for s in range(bank.scales))
    return np.asarray(total * (math.sqrt(math.pi / 2) + congruency.noise * math.sqrt((4 - math.pi) / 2)))


def _without_rim(image: Image) -> Image | None:
    """The image itself is not returned: kept among its own maps it would keep itself alive."""
    import cv2

    amplitude = image.amplitude
    dark = ~image.mask | (amplitude <= DARK * mean_amplitude(image))
    least = RIM_SHARE * dark.size
    if np.count_nonzero(dark) < least:
        return None
    # The border counts as black, so that rims thinner than the square are found too.
    square = np.ones((RIM_SIDE, RIM_SIDE), np.uint8)
    solid = cv2.erode(dark.view(np.uint8), square, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    _, label, stats, _ = cv2.connectedComponentsWithStats(solid, connectivity=8)
    x, y, wide, high, area = stats.T
    touching = (x == 0) | (y == 0) | (x + wide == dark.shape[1]) | (y + high == dark.shape[0])
    touching &= area >= least
    touching[0] = False
    if not touching.any():
        return None
    # One pixel more than was eroded: half-black pixels of an interpolated rim.
    grown = cv2.dilate(touching[label].view(np.uint8), np.ones((RIM_SIDE + 2, RIM_SIDE + 2), np.uint8))
    mask = image.mask & (grown == 0)
    return Image(read_only(np.where(mask, amplitude, np.float32(0))), read_only(mask), source_dtype=image.source_dtype)
