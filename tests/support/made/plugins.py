"""A plugin to register."""

from __future__ import annotations

from featreg.interfaces import Detector
from featreg.types import Features, Image


class Nothing(Detector):
    """Finds nothing."""

    def __init__(self, count: int = 3) -> None:
        self.count = count

    def detect_features(self, image: Image) -> Features:
        return Features.empty()
