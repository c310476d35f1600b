"""Angle-weighted gradients: a dense description of an image by channels of the direction of its gradients.

References
----------
Z. Fan, L. Zhang, Y. Liu, Q. Wang, S. Zlatanova, "Exploiting high geopositioning accuracy of SAR data to obtain accurate
geometric orientation of optical satellite images", Remote Sensing 13 (2021) 3535, DOI 10.3390/rs13173535. "A
high-precision matching method for heterogeneous SAR images based on ROEWA and angle-weighted gradient", Remote Sensing
17 (2025) 749, DOI 10.3390/rs17050749.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradients.gradient_field import GradientField
from featreg.sar.gradients.ratio import LEAST_EDGE

F32 = NDArray[np.float32]

#: Standard deviations to which the Gaussian that smooths the channels reaches.
REACH = 3.0
# Pixels from which the median length of the gradients is taken.
SAMPLE = 5_000


def smoothing_reach(sigma: float) -> int:
    """How far from a pixel gradients decide on its channels, px."""
    return math.ceil(REACH * sigma)


def median_length(field: GradientField) -> float:
    """The median length of a field's gradients where there are any; 0 where there are only rounding errors."""
    step = max(1, math.isqrt(field.x.size // SAMPLE))
    length = np.hypot(field.x[::step, ::step], field.y[::step, ::step])
    some = length[length > 0]
    return float(np.median(some)) if some.size and float(some.max()) > LEAST_EDGE else 0.0


def angle_weighted_channels(field: GradientField, count: int, sigma: float, weak: float) -> F32:
    """Return the channels of an image's gradients.

    Parameters
    ----------
    field : (H, W) gradients; of a part of an image, the channels within `smoothing_reach` of its rim are not those of
        the whole
    count : K, of the channels; channel k stands for the direction k pi / K, modulo half a turn
    sigma : standard deviation of the Gaussian by which each channel is smoothed, px; 0 for none
    weak : length of a gradient that says little, more than 0

    Returns
    -------
    (K, H, W) float32
        For each pixel a vector whose components sum to 0; all 0 where there is no gradient.

    Notes
    -----
    A gradient whose direction lies between those of two channels is shared between the two in proportion to how near
    it is to either: a direction on a channel's own is that channel's alone. Reversed contrast changes nothing. The
    channels are then smoothed, and those of each pixel divided by their length.

    Departures: to the length that divides, `weak` is added, so that gradients of speckle count less than edges; the
    mean over the channels is taken off, since what all channels share says nothing of a direction. No smoothing from
    channel to channel: sharing does that, and on change pairs and optical-SAR pairs more of it gained nothing.
    """
    import cv2

    from featreg.sar.gradients import angle_weighted_kernels

    height, width = field.x.shape
    channels = np.empty((count, height * width), np.float32)
    length, direction = cv2.cartToPolar(field.x, field.y)
    angle_weighted_kernels.share_out(
        np.asarray(length, np.float32).ravel(), np.asarray(direction, np.float32).ravel(), channels
    )
    if sigma > 0:
        side = 2 * smoothing_reach(sigma) + 1
        for channel in channels.reshape(count, height, width):
            cv2.GaussianBlur(channel, (side, side), sigma, channel, borderType=cv2.BORDER_CONSTANT)
    angle_weighted_kernels.normalise(channels, np.float32(weak))
    return channels.reshape(count, height, width)
