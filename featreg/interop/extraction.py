"""A detector and a descriptor behind the methods of OpenCV's `Feature2D`, for code written for OpenCV."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.interfaces import Descriptor, Detector
from featreg.io.images import as_image, image_or_none
from featreg.runtime.parameters import owner_of
from featreg.types import Features, Image

#: OpenCV's NORM_... and CV_... of our norms: NORM_L2 and CV_32F, NORM_HAMMING and CV_8U.
NORMS = {"l2": (4, 5), "hamming": (6, 0)}
#: Side of the image of noise, px: room for the largest support of a point of scale 8.
PROBE = 256


def extractor(detector: str | Detector, descriptor: str | Descriptor | None = None, **parameters: Any) -> Extractor:
    """Make an object that detects and describes as OpenCV's feature classes do.

    Parameters
    ----------
    detector : name or object
    descriptor : name or object; None where the detector describes its own points (``"orb"``, ``"sift"``, ...)
    parameters : of the detector or the descriptor given by name; where both have one of that name, write it as
        ``**{"detector.sigma": 2.0}``

    Returns
    -------
    `Extractor`

    Raises
    ------
    UnknownNameError, PluginUnavailableError
        No such detector or descriptor, or one that cannot be used here.
    ParameterError
        A parameter that neither has, or both; neither a name nor a plugin.

    Examples
    --------
    >>> import numpy as np
    >>> finder = extractor("sar-ofast", "brief", n_features=100)
    >>> image = np.random.default_rng(0).gamma(4, size=(128, 128)).astype(np.float32)
    >>> keypoints, descriptors = finder.detectAndCompute(image)
    >>> len(keypoints) == len(descriptors)
    True
    """
    parts = {"detector": detector, "descriptor": descriptor}
    entries = {role: registry.entry(role, part) for role, part in parts.items() if isinstance(part, str)}
    known = {role: set(entry.parameters) for role, entry in entries.items()}
    given: dict[str, dict[str, Any]] = {"detector": {}, "descriptor": {}}
    # A descriptor was asked for, so a detector that could describe its own points must not.
    if descriptor is not None and "detector" in entries and entries["detector"].describes:
        given["detector"][entries["detector"].describes] = False
    for key, value in parameters.items():
        role, short = owner_of(key, known, "neither detector nor descriptor")
        given[role][short] = value
    if isinstance(detector, str):
        detector = registry.create("detector", detector, **given["detector"])
    if isinstance(descriptor, str):
        descriptor = registry.create("descriptor", descriptor, **given["descriptor"])
    if not isinstance(detector, Detector):
        raise ParameterError(f"detector must be a name or a Detector, got {type(detector).__name__}")
    if descriptor is not None and not isinstance(descriptor, Descriptor):
        raise ParameterError(f"descriptor must be a name, a Descriptor or None, got {type(descriptor).__name__}")
    return Extractor(detector, descriptor)


@dataclass(frozen=True)
class Extractor:
    """What `extractor` makes: arrays and `cv2.KeyPoint` in, `cv2.KeyPoint` and descriptors out.

    Arrays are (H, W), real or complex, of any depth. A mask is (H, W), non-zero where features may lie; as everywhere
    in this package it marks pixels that are data, so no feature rests on a pixel outside it. Each image is looked at by
    itself, at full size: where a detector leaves scales out of large images (`skip` of sar-ofast, `thin` and `coarse`
    of sar-harris, `thin` of bf-sift), it may do so in one of two images and not in the other, which `featreg.match`
    sees to. For images of different sizes set these parameters, as in ``extractor("sar-harris", thin=False)``, or give
    the detector that ``detector.for_pair(reference, secondary)`` returns. This is no `cv2.Feature2D`: a subclass
    written in Python ends the process when OpenCV calls a method that it lacks.
    """

    detector: Detector
    descriptor: Descriptor | None = None

    def detect(self, array: NDArray[Any], mask: NDArray[Any] | None = None) -> list[Any]:
        """Return the keypoints, best first."""
        return self.detector.detect(array, mask)

    def compute(self, array: NDArray[Any], keypoints: Any) -> tuple[list[Any], NDArray[Any] | None]:
        """Return (the keypoints that could be described, their (N, D) float32 or packed uint8 descriptors)."""
        if self.descriptor is None:
            name = type(self.detector).__name__
            raise ParameterError(f"detector {name} cannot describe given keypoints: choose a descriptor, as in 'brief'")
        return self.descriptor.compute(array, keypoints)

    def detectAndCompute(  # noqa: N802 - the name is OpenCV's
        self, array: NDArray[Any], mask: NDArray[Any] | None = None
    ) -> tuple[list[Any], NDArray[Any] | None]:
        """Return (keypoints, descriptors); positions stay in float64 between the two steps."""
        image = image_or_none(array, mask)
        if image is None:
            return [], None
        features = self._described(image, self.detector.detect_features(image))
        return features.to_keypoints(), features.descriptors if len(features) else None

    def defaultNorm(self) -> int:  # noqa: N802
        """Return the norm by which descriptors are compared: ``cv2.NORM_HAMMING`` or ``cv2.NORM_L2``."""
        return NORMS[self._form[0]][0]

    def descriptorSize(self) -> int:  # noqa: N802
        """Return the length of a descriptor: bytes of packed bits, or numbers."""
        return self._form[1]

    def descriptorType(self) -> int:  # noqa: N802
        """Return the type of descriptors: ``cv2.CV_8U`` or ``cv2.CV_32F``."""
        return NORMS[self._form[0]][1]

    @cached_property
    def _form(self) -> tuple[str, int]:
        """Norm and length of the descriptors: told by the part that makes them, else seen on an image of noise."""
        told = self.detector.form() or (self.descriptor and self.descriptor.form())
        if told:
            return told
        image = as_image(np.random.default_rng(0).gamma(4.0, size=(PROBE, PROBE)))
        points = Features(np.full((1, 2), PROBE / 2), np.full(1, 8.0), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
        seen = self._described(image, points if self.descriptor else self.detector.detect_features(image))
        if seen.descriptors is None:
            raise ParameterError(f"{type(self.descriptor or self.detector).__name__} describes nothing on a test image")
        return seen.norm, seen.descriptors.shape[1]

    def _described(self, image: Image, features: Features) -> Features:
        if not len(features) or (self.descriptor is None and features.descriptors is not None):
            return features
        if self.descriptor is None:
            name = type(self.detector).__name__
            raise ParameterError(f"detector {name} gives no descriptors: choose one, as in descriptor='brief'")
        return self.descriptor.describe_features(image, features)
