"""Detectors of kornia, one row of a table each: corners and blobs in scale space, and learned ones.

Names and defaults of the parameters are kornia's, except: `n_features` is the budget; `frame` (kornia's `mr_size`) is
the radius of a feature's support in units of its detection scale; `orientation` is the direction of the strongest
gradient in the support, or "none"; `weights` is a file of trained weights, None for those that kornia downloads.

Departures from kornia: every candidate is looked at before the best are taken, where kornia drops those near the rim
after its own cut; a support that touches an invalid pixel drops its point; and the positions that Key.Net, XFeat and
DeDoDe report shifted by up to half a pixel of their pyramid level are put right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from featreg.interfaces import Detector
from featreg.interop.kornia import COMMON, KorniaPart, Row, import_kornia
from featreg.interop.opencv import grey, on_data
from featreg.interop.torch_arrays import inference, to_tensor
from featreg.registry import register_family
from featreg.runtime.optional import import_torch
from featreg.types import Features, Image
from featreg.types.lafs import to_numpy

BUDGET = 5000
MIN_SIDE = 16
# Side of the patch in which kornia looks for the direction of a feature in its own pipelines.
ORIENTATION_PATCH = 19
# What kornia's pyramids of Key.Net describe: a radius of 22 px on the level of the point.
KEYNET_RADIUS = 22.0
PIXELS_PER_CANDIDATE = 4


@dataclass(frozen=True)
class DetectorRow(Row):
    """A row of the table; `describes`: it returns descriptors with its points."""

    describes: bool = False


class KorniaDetector(KorniaPart, Detector):
    """One detector of kornia: a row of the table by name, and its parameters."""

    @property
    def row(self) -> DetectorRow:
        return TABLE[self.name]

    def detect_features(self, image: Image) -> Features:
        """Return the keypoints of `image`, best first, ties by position; learned ones may come with descriptors.

        Raises
        ------
        PluginUnavailableError
            The trained weights are neither given nor here nor to be had.
        InputError
            The file of weights is not that of this network.

        Notes
        -----
        No support (a disc of radius `scale`) touches an invalid pixel, and no point lies outside the image.
        """
        values = self.parameters
        network = self.network()
        picture = grey(image, values["normalise"])
        if min(image.shape) < MIN_SIDE or not image.mask.any() or picture.min() == picture.max():
            return Features.empty()
        with inference(values["threads"]):
            tensor = to_tensor(image, values["normalise"], values["device"])
            features = (_described if self.row.describes else self._framed)(network, tensor, values)
            features = _best(features.take(on_data(features, image)), values["n_features"])
            if self.row.describes:
                return features if values["describe"] else replace(features, descriptors=None)
            return _oriented(features, tensor, values)

    def _framed(self, network: Any, tensor: Any, values: Mapping[str, Any]) -> Features:
        """Upright frames of every candidate."""
        wanted = max(values["n_features"], tensor.shape[-1] * tensor.shape[-2] // PIXELS_PER_CANDIDATE)
        if self.name == "kornia-keynet":
            network = _with_budget(network, wanted)
            score, lafs = network.detect(tensor)
            features = Features.from_lafs(lafs, score)
            # kornia maps pixel u of a level that is f times smaller to u f, which is (u + 0.5) f - 0.5.
            factor = features.scale / network.mr_size
            features = replace(features, xy=features.xy + 0.5 * (factor - 1)[:, None])
            return replace(features, scale=values["frame"] * factor, level=_octave(factor))
        score, lafs = network.detect(tensor, wanted)
        features = Features.from_lafs(lafs, score)
        return replace(features, level=_octave(features.scale / (values["frame"] * values["init_sigma"])))


def _octave(factor: Any) -> Any:
    """(N,) whole octaves of (N,) scale factors; -1 is that of a doubled image."""
    return np.floor(np.log2(np.maximum(factor, 1e-6)) + 1e-3).astype(np.int64)


def _with_budget(network: Any, count: int) -> Any:
    """A shallow copy that returns so many points: the shared network stays as it is."""
    import copy

    network = copy.copy(network)
    network.num_features = count
    return network


def _best(features: Features, count: int) -> Features:
    """The best `count` features in a fixed order."""
    x, y = features.xy.T
    return features.take(np.lexsort((features.scale, x, y, -features.score))[:count])


def _oriented(features: Features, tensor: Any, values: Mapping[str, Any]) -> Features:
    """The features with the direction of the strongest gradient of their support."""
    if values["orientation"] == "none" or not len(features):
        return features
    orient = import_kornia().LAFOrienter(ORIENTATION_PATCH).to(tensor.device)
    turned = Features.from_lafs(orient(features.to_lafs().to(tensor.device, tensor.dtype), tensor))
    return replace(features, angle=turned.angle)


def _described(network: Any, tensor: Any, values: Mapping[str, Any]) -> Features:
    """Points and descriptors of a network that gives both at once; it knows neither size nor direction."""
    torch = import_torch()
    shape = np.array(tensor.shape[:-3:-1], np.float64)  # (W, H)
    kind = type(network).__name__
    colour = tensor.expand(-1, 3, -1, -1)
    if kind == "DISK":
        found = network(
            colour, window_size=values["window"], score_threshold=values["score_threshold"], pad_if_not_divisible=True
        )[0]
        xy, score, table = found.keypoints, found.detection_scores, found.descriptors
    elif kind == "ALIKED":
        found = network(colour)[0]
        xy, score, table = found.keypoints, found.keypoint_scores, found.descriptors
    elif kind == "XFeat":
        with torch.inference_mode():
            found = network.detectAndCompute(tensor, top_k=tensor.shape[-1] * tensor.shape[-2])[0]
        xy, score, table = found["keypoints"], found["scores"], found["descriptors"]
        # It looks at the image in a size that is a multiple of 32.
        factor = shape / np.maximum(32, shape // 32 * 32)
        xy = to_numpy(xy) + 0.5 * (factor - 1)
    else:
        # Some may lie on invalid pixels. It puts the centre of the first pixel at (0.5, 0.5).
        wanted = min(2 * values["n_features"], tensor.shape[-1] * tensor.shape[-2])
        points, scores, tables = network(colour, n=wanted)
        xy, score, table = np.rint(to_numpy(points[0]) - 0.5), scores[0], tables[0]
    rows = to_numpy(xy).reshape(-1, 2)
    n = len(rows)
    return Features(
        xy=rows,
        scale=np.full(n, values["support"]),
        angle=np.zeros(n),
        score=to_numpy(score).reshape(-1),
        level=np.zeros(n, np.int64),
        descriptors=np.ascontiguousarray(to_numpy(table, np.float32)).reshape(n, -1),
    )


def _scale_space(response: str, values: Mapping[str, Any]) -> Any:
    """kornia's detector of extrema of a response over place and scale."""
    from kornia.geometry.transform import ScalePyramid

    features = import_kornia()
    blobs = response == "BlobDoG"
    keywords = {"k": values["k"]} if "k" in values else {}
    return features.ScaleSpaceDetector(
        mr_size=values["frame"],
        # Two levels more than are searched are the neighbours of the outermost; a difference costs one more.
        scale_pyr_module=ScalePyramid(
            values["n_levels"], values["init_sigma"], values["min_size"], values["double_image"], 3 if blobs else 2
        ),
        resp_module=getattr(features, response)(**keywords),
        minima_are_also_good=blobs,
        scale_space_response=blobs,
    )


def _keynet(values: Mapping[str, Any], trained: bool = False) -> Any:
    return import_kornia().KeyNetDetector(trained)


def _disk(values: Mapping[str, Any], trained: bool = False) -> Any:
    disk = import_kornia().DISK
    return disk.from_pretrained(values["checkpoint"]) if trained else disk()


def _aliked(values: Mapping[str, Any], trained: bool = False) -> Any:
    aliked = import_kornia().ALIKED
    settings = {"detection_threshold": values["detection_threshold"], "nms_radius": values["nms_radius"]}
    return (aliked.from_pretrained if trained else aliked)(values["model"], **settings)


def _xfeat(values: Mapping[str, Any], trained: bool = False) -> Any:
    xfeat = import_kornia().XFeat
    return (xfeat.from_pretrained if trained else xfeat)(detection_threshold=values["detection_threshold"])


def _dedode(values: Mapping[str, Any], trained: bool = False) -> Any:
    dedode, torch = import_kornia().DeDoDe, import_torch()
    if trained:
        return dedode.from_pretrained(values["detector"], values["descriptor"], torch.float32)
    return dedode(values["detector"][0], values["descriptor"][0], torch.float32)


def _dedode_files(values: Mapping[str, Any]) -> tuple[str, ...]:
    detector = {"L-upright": "detector_L", "L-C4": "detector_C4", "L-SO2": "detector_SO2"}
    name = detector.get(values["detector"], "detector_L_v2")
    kind, _, way = values["descriptor"].partition("-")
    steered = {"C4": f"{kind}_C4_Perm", "SO2": f"{kind}_SO2_Spread"}
    last = f"{steered[way]}_descriptor_setting_C" if way in steered else f"dedode_descriptor_{kind}"
    return f"dedode_{name}.pth", f"{last}.pth"


PYRAMID = {
    "n_features": BUDGET,
    "frame": 6.0,
    "n_levels": 3,
    "init_sigma": 1.6,
    "min_size": 32,
    "double_image": True,
    "orientation": "gradient",
    **COMMON,
}
ORIENTATION = {"orientation": ("gradient", "none")}
# The size that their descriptors see is not in the interface of these networks: a nominal radius in pixels.
LEARNED = {"n_features": BUDGET, "describe": True, "support": 8.0, "weights": None, **COMMON}
ALIKED_MODELS = ("aliked-t16", "aliked-n16", "aliked-n16rot", "aliked-n32")
TABLE: dict[str, DetectorRow] = {
    "kornia-harris": DetectorRow(
        "Harris corners in scale space, by kornia",
        {"k": 0.04, **PYRAMID},
        partial(_scale_space, "CornerHarris"),
        ORIENTATION,
    ),
    "kornia-gftt": DetectorRow(
        "Shi-Tomasi corners in scale space, by kornia", PYRAMID, partial(_scale_space, "CornerGFTT"), ORIENTATION
    ),
    "kornia-hessian": DetectorRow(
        "Blobs: maxima of the determinant of the Hessian, by kornia",
        PYRAMID,
        partial(_scale_space, "BlobHessian"),
        ORIENTATION,
    ),
    "kornia-dog": DetectorRow(
        "Blobs: extrema of the difference of Gaussians, by kornia",
        PYRAMID,
        partial(_scale_space, "BlobDoG"),
        ORIENTATION,
    ),
    "kornia-keynet": DetectorRow(
        "Key.Net: learned corners in a pyramid, by kornia",
        {"n_features": BUDGET, "frame": KEYNET_RADIUS, "orientation": "gradient", "weights": None, **COMMON},
        _keynet,
        ORIENTATION,
        lambda values: ("keynet_pytorch.pth",),
        "huggingface.co/kornia/keynet",
        partial(_keynet, trained=True),
    ),
    "kornia-disk": DetectorRow(
        "DISK: learned points with descriptors of length 128, by kornia",
        {"checkpoint": "depth", "window": 5, "score_threshold": 0.0, **LEARNED},
        _disk,
        {"checkpoint": ("depth", "epipolar")},
        lambda values: (f"{values['checkpoint']}-save.pth",),
        "huggingface.co/kornia/disk",
        partial(_disk, trained=True),
        describes=True,
    ),
    "kornia-aliked": DetectorRow(
        "ALIKED: learned sub-pixel points with descriptors of length 128 (64: aliked-t16), by kornia",
        {"model": "aliked-n16", "detection_threshold": 0.2, "nms_radius": 2, **LEARNED},
        _aliked,
        {"model": ALIKED_MODELS},
        lambda values: (f"{values['model']}.pth",),
        "huggingface.co/kornia/aliked",
        partial(_aliked, trained=True),
        describes=True,
    ),
    "kornia-xfeat": DetectorRow(
        "XFeat: fast learned points with descriptors of length 64, by kornia",
        {"detection_threshold": 0.05, **LEARNED},
        _xfeat,
        {},
        lambda values: ("xfeat.pt",),
        "github.com/verlab/accelerated_features",
        partial(_xfeat, trained=True),
        describes=True,
    ),
    "kornia-dedode": DetectorRow(
        "DeDoDe: learned points with descriptors of length 256, by kornia",
        {"detector": "L-C4-v2", "descriptor": "B-upright", "descriptor_weights": None, **LEARNED},
        _dedode,
        {
            "detector": ("L-upright", "L-C4", "L-SO2", "L-C4-v2"),
            "descriptor": ("B-upright", "B-C4", "B-SO2", "G-upright", "G-C4", "G-SO2"),
        },
        _dedode_files,
        "huggingface.co/kornia/dedode",
        partial(_dedode, trained=True),
        describes=True,
    ),
}


def _create(name: str, **parameters: Any) -> KorniaDetector:
    return KorniaDetector(name, parameters)


for _name, _row in TABLE.items():
    register_family(
        "detector",
        _name,
        partial(_create, _name),
        _row.parameters,
        summary=_row.summary,
        module=__name__,
        unavailable=_row.unavailable,
        on_demand=_row.on_demand,
    )
