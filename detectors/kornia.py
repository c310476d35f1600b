"""Detectors of kornia, one row of a table each: corners and blobs in scale space, and learned ones.

Names and defaults of the parameters are kornia's, except: `n_features` is the budget; `frame` (kornia's `mr_size`) is
the radius of a feature's support in units of its detection scale; `orientation` is the direction of the strongest
gradient in the support, or "none"; `weights` is a file of trained weights, or "auto": see `featreg.interop.weights`.
Networks that describe look at images longer than `tile` pixels by parts that overlap, `batch` at a time.

Departures from kornia: every candidate is looked at before the best are taken, where kornia drops those near the rim
after its own cut; a support that touches an invalid pixel drops its point; and the positions that Key.Net, XFeat and
DeDoDe report shifted by up to half a pixel of their pyramid level are put right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from annotated_types import Ge, Gt

from featreg.interfaces import Detector
from featreg.interop.family import DESCRIBE, N_FEATURES, best_first, option, register_table
from featreg.interop.kornia import COMMON, KorniaMember, KorniaRow, import_kornia
from featreg.interop.opencv import MIN_SIDE, grey, on_data
from featreg.interop.torch_arrays import inference, to_tensor
from featreg.interop.weights import weights_option
from featreg.runtime.optional import import_torch
from featreg.types import Features, Image
from featreg.types.lafs import to_numpy

# Side of the patch in which kornia looks for the direction of a feature in its own pipelines.
ORIENTATION_PATCH = 19
# What kornia's pyramids of Key.Net describe: a radius of 22 px on the level of the point.
KEYNET_RADIUS = 22.0
PIXELS_PER_CANDIDATE = 4
# Of the coarsest cells of the learned networks, and how far beyond its part a network looks, px.
GRID = 32
RIM = 96


def _octave(factor: Any) -> Any:
    """(N,) whole octaves of (N,) scale factors; -1 is that of a doubled image."""
    return np.floor(np.log2(np.maximum(factor, 1e-6)) + 1e-3).astype(np.int64)


def _with_budget(network: Any, count: int) -> Any:
    """A shallow copy that returns so many points: the shared network stays as it is."""
    import copy

    network = copy.copy(network)
    network.num_features = count
    return network


def _oriented(features: Features, tensor: Any, values: Mapping[str, Any]) -> Features:
    """The features with the direction of the strongest gradient of their support."""
    if values["orientation"] == "none" or not len(features):
        return features
    orient = import_kornia().LAFOrienter(ORIENTATION_PATCH).to(tensor.device)
    turned = Features.from_lafs(orient(features.to_lafs().to(tensor.device, tensor.dtype), tensor))
    return replace(features, angle=turned.angle)


def _described(network: Any, tensor: Any, values: Mapping[str, Any]) -> Features:
    """Points and descriptors of a network that gives both at once; it knows neither size nor direction."""
    height, width = tensor.shape[-2:]
    groups: dict[tuple[int, int], list[tuple[Any, Any]]] = {}
    for rows in parts(height, values["tile"]):
        for columns in parts(width, values["tile"]):
            size = (rows[1].stop - rows[1].start, columns[1].stop - columns[1].start)
            groups.setdefault(size, []).append((rows, columns))
    found = []
    for same in groups.values():
        for i in range(0, len(same), values["batch"]):
            some = same[i : i + values["batch"]]
            stack = import_torch().cat([tensor[..., rows[1], columns[1]] for rows, columns in some])
            for (rows, columns), features in zip(some, _seen(network, stack, values), strict=True):
                xy = features.xy + np.array([columns[1].start, rows[1].start])
                own = (xy >= [columns[0].start - 0.5, rows[0].start - 0.5]).all(axis=1)
                own &= (xy < [columns[0].stop - 0.5, rows[0].stop - 0.5]).all(axis=1)
                found.append(replace(features, xy=xy).take(own))
    if len(found) == 1:
        return found[0]
    names = ("xy", "scale", "angle", "score", "level", "descriptors")
    joined: dict[str, Any] = {name: np.concatenate([getattr(f, name) for f in found]) for name in names}
    return Features(**joined)


def parts(length: int, side: int) -> list[tuple[slice, slice]]:
    """(own, seen) ranges along an axis: as equal as steps of 32 allow, none longer than about `side`, seen with a rim.

    Steps of 32 keep the networks' coarsest cells where they are in the whole image.
    """
    if length <= side:
        return [(slice(0, length), slice(0, length))]
    count = -(-length // side)
    step = -(-length // (count * GRID)) * GRID
    return [
        (slice(start, min(start + step, length)), slice(max(start - RIM, 0), min(start + step + RIM, length)))
        for start in range(0, length, step)
    ]


def _seen(network: Any, stack: Any, values: Mapping[str, Any]) -> list[Features]:
    """What a network finds in each picture of a stack (B, 1, H, W)."""
    torch = import_torch()
    shape = np.array(stack.shape[:-3:-1], np.float64)  # (W, H)
    pixels = stack.shape[-1] * stack.shape[-2]
    kind = type(network).__name__
    colour = stack.expand(-1, 3, -1, -1)
    if kind == "DISK":
        all_found = network(
            colour, window_size=values["window"], score_threshold=values["score_threshold"], pad_if_not_divisible=True
        )
        tables = [(found.keypoints, found.detection_scores, found.descriptors) for found in all_found]
    elif kind == "ALIKED":
        # With the channels innermost its many small layers take half the time.
        all_found = network(colour.contiguous(memory_format=torch.channels_last))
        tables = [(found.keypoints, found.keypoint_scores, found.descriptors) for found in all_found]
    elif kind == "XFeat":
        with torch.inference_mode():
            all_found = network.detectAndCompute(stack, top_k=pixels)
        # It looks at the image in a size that is a multiple of 32.
        shift = 0.5 * (shape / np.maximum(GRID, shape // GRID * GRID) - 1)
        tables = [(to_numpy(f["keypoints"]).reshape(-1, 2) + shift, f["scores"], f["descriptors"]) for f in all_found]
    else:
        # Some may lie on invalid pixels. It puts the centre of the first pixel at (0.5, 0.5).
        xy, score, table = network(colour, n=min(2 * values["n_features"], pixels))
        tables = [(np.rint(to_numpy(a) - 0.5), b, c) for a, b, c in zip(xy, score, table, strict=True)]
    return [_features(*one, values["support"]) for one in tables]


def _features(xy: Any, score: Any, table: Any, support: float) -> Features:
    rows = to_numpy(xy).reshape(-1, 2)
    n = len(rows)
    return Features(
        xy=rows,
        scale=np.full(n, support),
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


def _keynet(creator: str, values: Mapping[str, Any], trained: bool = False) -> Any:
    return import_kornia().KeyNetDetector(trained)


def _disk(creator: str, values: Mapping[str, Any], trained: bool = False) -> Any:
    disk = import_kornia().DISK
    return disk.from_pretrained(values["checkpoint"]) if trained else disk()


def _aliked(creator: str, values: Mapping[str, Any], trained: bool = False) -> Any:
    aliked = import_kornia().ALIKED
    settings = {"detection_threshold": values["detection_threshold"], "nms_radius": values["nms_radius"]}
    network = (aliked.from_pretrained if trained else aliked)(values["model"], **settings)
    return network.to(memory_format=import_torch().channels_last)


def _xfeat(creator: str, values: Mapping[str, Any], trained: bool = False) -> Any:
    xfeat = import_kornia().XFeat
    return (xfeat.from_pretrained if trained else xfeat)(detection_threshold=values["detection_threshold"])


def _dedode(creator: str, values: Mapping[str, Any], trained: bool = False) -> Any:
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


ORIENTATION = option("gradient", choices=("gradient", "none"), meaning="direction of the strongest gradient, or none")
PYRAMID = {
    **N_FEATURES,
    "frame": option(6.0, Gt(0), meaning="radius of the support in units of the detection scale"),
    "n_levels": option(3, Ge(1)),
    "init_sigma": option(1.6, Gt(0)),
    "min_size": option(32, Ge(0)),
    "double_image": option(True),
    "orientation": ORIENTATION,
    **COMMON,
}
DEDODE_TERMS = "MIT; the G- descriptors hold DINOv2, which has terms of its own"
# The size that their descriptors see is not in the interface of these networks: a nominal radius in pixels.
SUPPORT = option(8.0, Gt(0), meaning="nominal radius of the support, px")
LEARNED = {
    **N_FEATURES,
    **DESCRIBE,
    "support": SUPPORT,
    "tile": option(1024, Ge(128), meaning="longer images are looked at by parts of this side, px"),
    "batch": option(1, Ge(1), meaning="so many parts go through the network at once"),
    **COMMON,
}
# What each takes for a pixel was measured as the peak of a process over that of a small image, on images of 792 and
# 1192 px a side, or of parts of them; DeDoDe's on 448 px, Harris' taken from the like of it.
TABLE: dict[str, KorniaRow] = {
    "kornia-harris": KorniaRow(
        "CornerHarris",
        "Harris corners in scale space, by kornia",
        {"k": option(0.04, Ge(0)), **PYRAMID},
        _scale_space,
        pixel_bytes=1900,
    ),
    "kornia-gftt": KorniaRow(
        "CornerGFTT", "Shi-Tomasi corners in scale space, by kornia", PYRAMID, _scale_space, pixel_bytes=1900
    ),
    "kornia-hessian": KorniaRow(
        "BlobHessian",
        "Blobs: maxima of the determinant of the Hessian, by kornia",
        PYRAMID,
        _scale_space,
        pixel_bytes=1900,
    ),
    "kornia-dog": KorniaRow(
        "BlobDoG",
        "Blobs: extrema of the difference of Gaussians, by kornia",
        PYRAMID,
        _scale_space,
        pixel_bytes=1200,
    ),
    "kornia-keynet": KorniaRow(
        "KeyNetDetector",
        "Key.Net: learned corners in a pyramid, by kornia",
        {
            **N_FEATURES,
            "frame": replace(PYRAMID["frame"], default=KEYNET_RADIUS),
            "orientation": ORIENTATION,
            "weights": weights_option("none stated: ask the authors"),
            **COMMON,
        },
        _keynet,
        lambda values: ("keynet_pytorch.pth",),
        "huggingface.co/kornia/keynet",
        pixel_bytes=700,
    ),
    "kornia-disk": KorniaRow(
        "DISK",
        "DISK: learned points with descriptors of length 128, by kornia",
        {
            "checkpoint": option("depth", choices=("depth", "epipolar")),
            "window": option(5, Ge(1)),
            "score_threshold": option(0.0, Ge(0)),
            "weights": weights_option("Apache 2.0"),
            **LEARNED,
        },
        _disk,
        lambda values: (f"{values['checkpoint']}-save.pth",),
        "huggingface.co/kornia/disk",
        pixel_bytes=2500,
    ),
    "kornia-aliked": KorniaRow(
        "ALIKED",
        "ALIKED: learned sub-pixel points with descriptors of length 128 (64: aliked-t16), by kornia",
        {
            "model": option("aliked-n16", choices=("aliked-t16", "aliked-n16", "aliked-n16rot", "aliked-n32")),
            "detection_threshold": option(0.2, Ge(0)),
            "nms_radius": option(2, Ge(1)),
            "weights": weights_option("BSD 3-clause"),
            **LEARNED,
        },
        _aliked,
        lambda values: (f"{values['model']}.pth",),
        "huggingface.co/kornia/aliked",
        pixel_bytes=2000,
    ),
    "kornia-xfeat": KorniaRow(
        "XFeat",
        "XFeat: fast learned points with descriptors of length 64, by kornia",
        {"detection_threshold": option(0.05, Ge(0)), "weights": weights_option("Apache 2.0"), **LEARNED},
        _xfeat,
        lambda values: ("xfeat.pt",),
        "github.com/verlab/accelerated_features",
        pixel_bytes=200,
    ),
    "kornia-dedode": KorniaRow(
        "DeDoDe",
        "DeDoDe: learned points with descriptors of length 256, by kornia",
        {
            "detector": option("L-C4-v2", choices=("L-upright", "L-C4", "L-SO2", "L-C4-v2")),
            "descriptor": option("B-upright", choices=("B-upright", "B-C4", "B-SO2", "G-upright", "G-C4", "G-SO2")),
            "descriptor_weights": weights_option(DEDODE_TERMS),
            "weights": weights_option(DEDODE_TERMS),
            **LEARNED,
        },
        _dedode,
        _dedode_files,
        "huggingface.co/kornia/dedode",
        pixel_bytes=4000,
    ),
}


@register_table
class KorniaDetector(KorniaMember, Detector):
    """One detector of kornia: a row of the table by name, and its parameters."""

    table = TABLE
    describes = "describe"

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
        smallest = GRID + 1 if "tile" in values else MIN_SIDE  # of a network two of its coarsest cells
        if min(image.shape) < smallest or not image.mask.any() or picture.min() == picture.max():
            return Features.empty()
        with inference(values["threads"]):
            tensor = to_tensor(image, values["normalise"], values["device"])
            features = (_described if "describe" in values else self._framed)(network, tensor, values)
            features = best_first(features.take(on_data(features, image)), values["n_features"])
            if "describe" in values:
                return features if values["describe"] else replace(features, descriptors=None)
            return _oriented(features, tensor, values)

    def window_bytes(self, shape: tuple[int, int]) -> float:
        """For all pixels of the image, or of the parts that go through a network together."""
        values = self.parameters
        height, width = shape
        if "tile" in values:
            tall, wide = ([part[1].stop - part[1].start for part in parts(n, values["tile"])] for n in shape)
            height, width = max(tall), max(wide) * min(values["batch"], len(tall) * len(wide))
        doubled = 1.0 if values.get("double_image", True) else 0.25
        return self.table[self.name].pixel_bytes * height * width * doubled

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
