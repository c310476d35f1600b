"""A detector and a descriptor behind the methods of OpenCV's `Feature2D`, for code written for OpenCV."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError, suggest
from featreg.interfaces import Descriptor, Detector
from featreg.types import Features


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
    known = {
        role: set(registry.entry(role, part).parameters) if isinstance(part, str) else set()
        for role, part in (("detector", detector), ("descriptor", descriptor))
    }
    given: dict[str, dict[str, Any]] = {"detector": {}, "descriptor": {}}
    # A descriptor was asked for, so a detector that could describe its own points must not.
    if descriptor is not None and "describe" in known["detector"]:
        given["detector"]["describe"] = False
    for key, value in parameters.items():
        role, short = _owner(key, known)
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
    in this package it marks pixels that are data, so no feature rests on a pixel outside it. This is no
    `cv2.Feature2D`: a subclass written in Python ends the process when OpenCV calls a method that it lacks.
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
        from featreg.io import as_image

        image = as_image(array, mask=None if mask is None else mask != 0)
        features: Features = self.detector.detect_features(image)
        if features.descriptors is None:
            if self.descriptor is None:
                name = type(self.detector).__name__
                raise ParameterError(f"detector {name} gives no descriptors: choose one, as in descriptor='brief'")
            features = self.descriptor.describe_features(image, features)
        return features.to_keypoints(), features.descriptors


def _owner(key: str, known: dict[str, set[str]]) -> tuple[str, str]:
    """(role, name) of the part to which a parameter belongs."""
    part, _, short = key.rpartition(".")
    owners = [role for role, names in known.items() if short in names and part in ("", role)]
    if len(owners) == 1:
        return owners[0], short
    if owners:
        raise ParameterError(f"'{key}' is ambiguous: write " + " or ".join(f"'{role}.{short}'" for role in owners))
    names = {f"{role}.{name}" if part else name for role, own in known.items() for name in own}
    raise ParameterError(f"neither detector nor descriptor has a parameter '{key}', {suggest(key, names)}")
