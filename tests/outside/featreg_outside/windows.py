"""A matcher without features: windows on a grid, sought nearby."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge

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

    # A block's two windows begin apart by the reach and by how far the prior may be off.
    block_parameters: ClassVar[Mapping[str, Any]] = MappingProxyType({"search": 64})

    half: Annotated[int, Ge(4)] = 20
    search: Annotated[int, Ge(1)] = 12
    step: Annotated[int, Ge(1)] = 12

    def match(self, reference: Image, secondary: Image) -> Matches:
        import cv2

        here, there = (np.log1p(image.amplitude).astype(np.float32) for image in (reference, secondary))
        height, width = (min(a, b) for a, b in zip(reference.shape, secondary.shape, strict=True))
        margin = self.half + self.search
        rows: list[tuple[float, float, float, float, float]] = []
        for y in range(margin, height - margin, self.step):
            for x in range(margin, width - margin, self.step):
                small = np.s_[y - self.half : y + self.half + 1, x - self.half : x + self.half + 1]
                large = np.s_[y - margin : y + margin + 1, x - margin : x + margin + 1]
                if not reference.mask[small].all():
                    continue
                scores = cv2.matchTemplate(there[large], here[small], cv2.TM_CCOEFF_NORMED)
                # Flat ground, as beyond the image, correlates with nothing.
                whole = cv2.erode(secondary.mask[large].view(np.uint8), np.ones((2 * self.half + 1,) * 2, np.uint8))
                scores[whole[self.half : -self.half, self.half : -self.half] == 0] = -1
                _, score, _, (dx, dy) = cv2.minMaxLoc(scores)
                if score < 0.3:
                    continue
                rows.append((x, y, x + dx - self.search, y + dy - self.search, score))
        table = np.array(rows, np.float64).reshape(-1, 5)
        return Matches(table[:, :2], table[:, 2:4], table[:, 4])

    @property
    def reach(self) -> float:
        return float(self.half)
