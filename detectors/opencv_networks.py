"""ALIKED and DISK as OpenCV 5 runs them itself, from files in the format ONNX: without PyTorch.

Names and defaults of the parameters are OpenCV's; `weights` is the ONNX file, `width` and `height` are the size in
which the network sees the image. OpenCV gives neither size nor direction: `support` is a nominal radius.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from annotated_types import Gt, MultipleOf

from featreg.interfaces import Detector
from featreg.interop.family import DESCRIBE, N_FEATURES, Member, best_first, option, register_table
from featreg.interop.opencv import MIN_SIDE, NetworkRow, clear_errors, grey, on_data, onnx_weights
from featreg.types import Features, Image


def _aliked(create: Any, path: str, values: Mapping[str, Any]) -> Any:
    import cv2

    made: Any = cv2
    settings = made.ALIKED.Params()
    settings.inputSize = (values["width"], values["height"])
    settings.normalizeDescriptors = values["normalize_descriptors"]
    return create(path, settings)


def _disk(create: Any, path: str, values: Mapping[str, Any]) -> Any:
    size = (values["width"], values["height"])
    return create(path, scoreThreshold=values["score_threshold"], imageSize=size)


def _side(default: int, step: int) -> dict[str, Any]:
    limit = MultipleOf(step)
    return {
        "width": option(default, limit, meaning="of the image as the network sees it, px"),
        "height": option(default, limit, meaning="of the image as the network sees it, px"),
    }


SHARED = {
    **DESCRIBE,
    "support": option(8.0, Gt(0), meaning="nominal radius of the support, px"),
    "weights": onnx_weights(),
}
TABLE: dict[str, NetworkRow] = {
    "opencv-aliked": NetworkRow(
        "ALIKED",
        "ALIKED: learned points with descriptors of length 128, by OpenCV 5 from an ONNX file",
        {**N_FEATURES, **_side(640, 32), "normalize_descriptors": option(True), **SHARED},
        build=_aliked,
    ),
    "opencv-disk": NetworkRow(
        "DISK",
        "DISK: learned points with descriptors of length 128, by OpenCV 5 from an ONNX file",
        {**N_FEATURES, **_side(1024, 16), "score_threshold": option(0.0), **SHARED},
        build=_disk,
    ),
}


@register_table
class OpenCVNetwork(Member, Detector):
    """One network of OpenCV: a row of the table by name, and its parameters."""

    table = TABLE
    compiled = False
    describes = "describe"

    def detect_features(self, image: Image) -> Features:
        """Return the keypoints of `image` with descriptors, best first, ties by position.

        Raises
        ------
        PluginUnavailableError
            This OpenCV has no such network, or no file of weights is given.
        InputError
            OpenCV cannot read the file, or refuses the image.
        """
        values = self.parameters
        network = TABLE[self.name].network(self.name, values)
        picture = grey(image, values["normalise"])
        if min(image.shape) < MIN_SIDE or not image.mask.any() or picture.min() == picture.max():
            return Features.empty()
        with clear_errors(self.row.creator):
            keypoints, table = network.detectAndCompute(np.repeat(picture[:, :, None], 3, axis=2), None)
        if not len(keypoints):
            return Features.empty()
        found = Features.from_keypoints(keypoints, np.asarray(table, np.float32))
        found = replace(found, scale=np.full(len(found), values["support"]), angle=np.zeros(len(found)))
        found = best_first(found.take(on_data(found, image)), values["n_features"])
        return found if values["describe"] else replace(found, descriptors=None)
