"""A matcher without features: windows on a grid, sought nearby."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from featreg import Image, Matcher, Matches, register


@register("outside-windows")
@dataclass(frozen=True)
class OutsideWindows(Matcher):
    """Normalised correlation of square windows on a regular grid.

    Parameters
    ----------
    half : half the side of a window, px
    search : how far it is sought, px
    step : of the grid, px
    """

    half: int = 20
    search: int = 12
    step: int = 24

    def match(self, reference: Image, secondary: Image) -> Matches:
        import cv2

        here, there = (np.log1p(image.amplitude).astype(np.float32) for image in (reference, secondary))
        height, width = (min(a, b) for a, b in zip(reference.shape, secondary.shape, strict=True))
        margin = self.half + self.search
        rows: list[tuple[float, float, float, float, float]] = []
        for y in range(margin, height - margin, self.step):
            for x in range(margin, width - margin, self.step):
                window = here[y - self.half : y + self.half + 1, x - self.half : x + self.half + 1]
                area = there[y - margin : y + margin + 1, x - margin : x + margin + 1]
                _, score, _, (dx, dy) = cv2.minMaxLoc(cv2.matchTemplate(area, window, cv2.TM_CCOEFF_NORMED))
                rows.append((x, y, x + dx - self.search, y + dy - self.search, score))
        table = np.array(rows, np.float64).reshape(-1, 5)
        return Matches(table[:, :2], table[:, 2:4], table[:, 4])

    @property
    def reach(self) -> float:
        return float(self.half + self.search)
