"""How much ground the images of a stack share, by what their files say of where they lie."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from featreg.errors import InputError
from featreg.geolocation import ConstantHeight, Transfer, ground_level, sensor_of
from featreg.geolocation.sensor import Sensor
from featreg.io.raster_source import Source

#: Nodes along each side of the image on which it is looked at.
NODES = 9

logger = logging.getLogger(__name__)


class SharedGround:
    """The share of the ground of one image that another shows, each looked up once."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self.sources = sources
        self._sensors: dict[int, Sensor | None] = {}
        self._known: dict[tuple[int, int], float | None] = {}

    def __call__(self, first: int, second: int) -> float | None:
        """Return the share, 0 to 1, of the smaller one's ground; None where one does not say where it lies."""
        pair = min(first, second), max(first, second)
        if pair not in self._known:
            self._known[pair] = self._shared(*pair)
        return self._known[pair]

    def _sensor(self, image: int) -> Sensor | None:
        if image not in self._sensors:
            source, found = self.sources[image], None
            if source.geolocation is not None:
                try:
                    found = sensor_of(source.geolocation, source.shape, source.name)
                except InputError as error:
                    logger.info("%s: pairs are chosen without its place (%s)", source.name, error)
            self._sensors[image] = found
        return self._sensors[image]

    def _shared(self, first: int, second: int) -> float | None:
        here, there = self._sensor(first), self._sensor(second)
        if here is None or there is None:
            return None
        heights = ConstantHeight(ground_level(here, there)[0])
        shares = []
        for one, other, a, b in ((here, there, first, second), (there, here, second, first)):
            size = np.array(self.sources[a].shape[::-1])
            nodes = np.stack(np.meshgrid(*((np.arange(NODES) + 0.5) / NODES * (n - 1) for n in size)), -1)
            try:
                mapped = Transfer(one, other, heights)(nodes.reshape(-1, 2))
            except InputError:
                return None
            limit = np.array(self.sources[b].shape[::-1]) - 0.5
            # What cannot be mapped lies outside.
            with np.errstate(invalid="ignore"):
                shares.append(float(((mapped >= -0.5) & (mapped <= limit)).all(axis=1).mean()))
        return max(shares)
