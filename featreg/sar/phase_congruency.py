"""Phase congruency of an image: where the phases of all scales agree, whatever the contrast there.

References
----------
P. Kovesi, "Phase congruency detects corners and edges", DICTA 2003, 309; P. Kovesi, "Image features from phase
congruency", Videre 1 (1999) 1. J. Li, Q. Hu, M. Ai, "RIFT: multi-modal image matching based on radiation-variation
insensitive feature transform", IEEE TIP 29 (2020) 3296, DOI 10.1109/TIP.2019.2959244.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.sar.log_gabor import LogGabor, responses
from featreg.sar.speckle import mean_amplitude
from featreg.types import BoolArray, Image

F32 = NDArray[np.float32]

# Steps of the index map in half a turn, a multiple of every usual number of orientations.
STEPS = 240
# Pixels along each side at most from which the noise is estimated.
SAMPLE = 160
EPS = 1e-4
# Black: below this share of the mean amplitude, in squares of RIM_SIDE pixels, over RIM_SHARE of the image.
DARK, RIM_SIDE, RIM_SHARE = 0.05, 7, 1e-3


@dataclass(frozen=True)
class Congruency:
    """Parameters of phase congruency beside its filters.

    Parameters
    ----------
    noise : standard deviations above the mean of the noise energy that an energy must exceed
    cut_off : share of the scales' spread below which congruency is damped
    gain : sharpness of that damping
    """

    noise: float = 1.0
    cut_off: float = 0.5
    gain: float = 3.0
    floor: float = 0.3


def congruency_maps(
    image: Image, bank: LogGabor, congruency: Congruency
) -> tuple[F32, F32, NDArray[np.uint8], BoolArray]:
    return image.derive(_maps, bank=bank, congruency=congruency)


def _maps(image: Image, bank: LogGabor, congruency: Congruency) -> tuple[F32, F32, NDArray[np.uint8], BoolArray]:
    from featreg.sar import index_map_kernels

    usable = without_rim(image)
    view = _filled_view(usable, bank.margin)
    height, width = image.shape
    moments = np.zeros((3, height, width), np.float32)
    amplitudes = np.empty((bank.orientations, height, width), np.float32)
    for o, response in enumerate(responses(view, bank)):
        noise = _noise(response[0], usable.mask, bank, congruency.noise)
        angle = math.pi * o / bank.orientations
        index_map_kernels.add_orientation(
            response.view(np.float32), np.float32(noise), np.float32(congruency.floor),
            np.float32(congruency.gain), np.float32(congruency.cut_off),
            np.float32(math.cos(angle)), np.float32(math.sin(angle)), moments, amplitudes[o],
        )  # fmt: skip
    largest, smallest = np.empty((2, height, width), np.float32)
    index_map_kernels.principal_moments(moments, np.float32(2 / bank.orientations), largest, smallest)
    index = np.empty((height, width), np.uint8)
    index_map_kernels.dominant_index(amplitudes, STEPS, index)
    return largest, smallest, index, usable.mask


def without_rim(image: Image) -> Image:
    """Return the image with black areas at its border, such as a warp leaves, counted as invalid."""
    return image.derive(_without_rim) or image


def _without_rim(image: Image) -> Image | None:
    import cv2

    amplitude = image.amplitude
    dark = ~image.mask | (amplitude <= DARK * mean_amplitude(image))
    if np.count_nonzero(dark) < RIM_SHARE * dark.size:
        return None
    kernel = np.ones((RIM_SIDE, RIM_SIDE), np.uint8)
    # Nothing but black in a whole square; the border counts as black, so that thin rims are found too.
    solid = cv2.erode(dark.view(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    _, label, stats, _ = cv2.connectedComponentsWithStats(solid, connectivity=8)
    x, y, w, h, area = stats.T
    touching = (x == 0) | (y == 0) | (x + w == dark.shape[1]) | (y + h == dark.shape[0])
    touching &= area >= RIM_SHARE * dark.size
    touching[0] = False
    if not touching.any():
        return None
    rim = cv2.dilate(touching[label].view(np.uint8), np.ones((RIM_SIDE + 2, RIM_SIDE + 2), np.uint8)).view(np.bool_)
    mask = image.mask & ~rim
    return Image(np.where(mask, amplitude, np.float32(0)), mask, source_dtype=image.source_dtype)


def _filled_view(image: Image, reach: int) -> F32:
    """The log-amplitude with invalid pixels at the mean of the valid ones around them."""
    import cv2

    mean = np.float32(max(mean_amplitude(image), 1e-30))
    view = np.log1p(image.amplitude / mean)
    if image.all_valid:
        return view
    valid = image.mask.astype(np.float32)
    filled, weight = view * valid, valid
    sum_, share = filled, weight
    while True:
        side = 2 * reach + 1
        sum_ = cv2.blur(filled, (side, side), borderType=cv2.BORDER_CONSTANT)
        share = cv2.blur(weight, (side, side), borderType=cv2.BORDER_CONSTANT)
        known = share > 0.02
        view = np.where(image.mask, view, np.where(known, sum_ / np.maximum(share, 0.02), view))
        break
    return np.asarray(view, np.float32)


def _noise(finest: NDArray[np.complex64], mask: BoolArray, bank: LogGabor, deviations: float) -> float:
    step = [max(1, n // SAMPLE) for n in finest.shape]
    seen = np.abs(finest[:: step[0], :: step[1]])[mask[:: step[0], :: step[1]]]
    tau = float(np.median(seen)) / math.sqrt(math.log(4)) if seen.size else 0.0
    total = tau * sum(bank.multiplier**-s for s in range(bank.scales))
    return total * (math.sqrt(math.pi / 2) + deviations * math.sqrt((4 - math.pi) / 2))
