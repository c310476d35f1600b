"""Where a square image that was turned within its own frame lies: its black corners tell the angle.

In public optical-SAR sets the second image is often the first one's place after a turn about the centre of the frame,
cut off by the frame, with black corners. Where the published turn is wrong, that outline is right: it is what one
sees. A square looks the same after a quarter turn, so that the angle is known up to that; the sets at hand turn by
less.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from featreg.types import BoolArray

#: Brightest value of the fill, of 255: lossy files blur it. And least size, px, of a black piece at the rim.
FILL, LEAST_PIECE = 12, 40
#: Steps of the search for the angle, degrees: first all of a quarter turn, then around the best.
STEPS = (1.0, 0.1, 0.02)
#: Least agreement of the data with a turned square, as intersection over union, and pixels left out along its rim.
LEAST_AGREEMENT, RIM = 0.97, 3.0


@dataclass(frozen=True, eq=False)
class Outline:
    """A turned square.

    Parameters
    ----------
    turn_deg : counter-clockwise as seen, 0 to 90
    agreement : intersection over union of the square and of what is not black
    mask : (N, N) bool, inside the square and away from its rim
    """

    turn_deg: float
    agreement: float
    mask: BoolArray

    @property
    def clear(self) -> bool:
        """Whether the black corners are those of a turned square."""
        return self.agreement >= LEAST_AGREEMENT


def outline_of(image: NDArray[np.uint8]) -> Outline:
    """Find the turned square in an (N, N) 8-bit image."""
    side = len(image)
    data = ~_black_rim(image)
    middle = (side - 1) / 2
    y, x = np.mgrid[:side, :side] - middle

    def distance(angle: float) -> NDArray[np.float64]:
        """How far each pixel lies from the centre of a square turned by so much, in the largest of both directions."""
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        return np.asarray(np.maximum(np.abs(c * x - s * y), np.abs(s * x + c * y)))

    def agreement(angle: float) -> float:
        square = distance(angle) <= side / 2
        return float((square & data).sum() / (square | data).sum())

    best, reach = 45.0, 45.0
    for step in STEPS:
        # Ends included, so that a best one at the end of a coarse range can move on in the next, finer one.
        angles = best + np.arange(-reach, reach + step / 2, step)
        best = float(max(angles, key=agreement))
        reach = step
    return Outline(best % 90, agreement(best), distance(best) <= side / 2 - RIM)


def _black_rim(image: NDArray[np.uint8]) -> BoolArray:
    """The black pieces that touch the rim of the image."""
    bright = cv2.morphologyEx((image > FILL).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(1 - bright)
    rim = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    large = [k for k in rim if 0 < k < count and statistics[k, cv2.CC_STAT_AREA] >= LEAST_PIECE]
    return np.asarray(np.isin(labels, large), np.bool_)


def turned_about_centres(shape: tuple[int, int], side: int, turn_deg: float) -> NDArray[np.float64]:
    """(2, 3) map from a square reference to the turned, scaled square in a frame of `side` pixels, centre to centre.

    `turn_deg` is counter-clockwise as seen.
    """
    scale = side / shape[1]
    c, s = scale * np.cos(np.radians(turn_deg)), scale * np.sin(np.radians(turn_deg))
    linear = np.array([[c, s], [-s, c]])
    centre = (np.array(shape[::-1]) - 1) / 2
    return np.column_stack([linear, (side - 1) / 2 - linear @ centre])
