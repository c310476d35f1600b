"""Matching by kornia, one row of a table each: nearest neighbours that look at more than the distance, and LoFTR.

Packed bits are compared as vectors of zeros and ones, so that their distance is the root of the Hamming distance.
`weights` is a file of trained weights, or "auto": see `featreg.interop.weights`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from annotated_types import Ge

from featreg.errors import ParameterError
from featreg.interfaces import Matcher, Nearest
from featreg.interop.family import N_FEATURES, option, register_table
from featreg.interop.kornia import COMMON, RUN, KorniaMember, KorniaRow, import_kornia
from featreg.interop.torch_arrays import as_device, inference, to_tensor
from featreg.interop.weights import weights_option
from featreg.runtime.optional import import_torch
from featreg.runtime.timing import stage
from featreg.types import BoolArray, Features, FloatArray, Image, IntArray, Matches, Searched
from featreg.types.lafs import to_numpy


@dataclass(frozen=True)
class NearestRow(KorniaRow):
    """A row of the table; `run`: (network, parameters, descriptors, descriptors, LAFs, LAFs) -> pairs, score."""

    run: Callable[..., tuple[Any, Any]] = field(kw_only=True)


def _smnn(match: Any, values: Mapping[str, Any], a: Any, b: Any, here: Any, there: Any) -> tuple[Any, Any]:
    ratio, pairs = match(a, b, values["threshold"])
    return pairs, 1 - ratio


def _fginn(match: Any, values: Mapping[str, Any], a: Any, b: Any, here: Any, there: Any) -> tuple[Any, Any]:
    ratio, pairs = match(a, b, here, there, values["threshold"], values["spatial_threshold"], values["mutual"])
    return pairs, 1 - ratio


def _adalam(match: Any, values: Mapping[str, Any], a: Any, b: Any, here: Any, there: Any) -> tuple[Any, Any]:
    config = {key: values[key] for key in ADALAM}
    for key in ("orientation_difference_threshold", "scale_rate_threshold"):
        config[key] = config[key] or None  # kornia switches a test off by None
    # The images' sizes set the radius of a neighbourhood; those of the point sets stand for them.
    quality, pairs = match(a, b, here, there, config, _extent(here), _extent(there))
    return pairs, -quality.clamp_min(1e-12).log10()


def _extent(frames: Any) -> tuple[float, float]:
    width, height = np.maximum(np.ptp(to_numpy(frames)[0, :, :, 2], axis=0), 1.0)
    return float(height), float(width)


def _lightglue(network: Any, values: Mapping[str, Any], a: Any, b: Any, here: Any, there: Any) -> tuple[Any, Any]:
    length = network.conf.input_dim
    if a.shape[1] != length:
        raise ParameterError(
            f"kornia-lightglue with features='{values['features']}' needs descriptors of length {length}, "
            f"got {a.shape[1]}: give the features that these weights were trained on"
        )
    sides = [_lightglue_side(table, frames, values["features"]) for table, frames in ((a, here), (b, there))]
    found = network({"image0": sides[0], "image1": sides[1]})
    return found["matches"][0], found["scores"][0]


def _lightglue_side(table: Any, frames: Any, kind: str) -> dict[str, Any]:
    """What LightGlue is told of one image; the size of which is not known, so that of the point set stands for it.

    Its SIFT weights were trained on COLMAP's keypoints: the detection scale, a sixth of kornia's, and clockwise angles.
    """
    torch = import_torch()
    xy = frames[0, :, :, 2]
    scale = torch.sqrt(torch.abs(torch.linalg.det(frames[0, :, :, :2])))
    angle = torch.atan2(frames[0, :, 0, 1], frames[0, :, 0, 0])
    sift = kind == "sift"
    return {
        "keypoints": xy[None],
        "descriptors": table[None],
        "scales": (scale / 6 if sift else scale)[None],
        "oris": (-angle if sift else angle % (2 * np.pi))[None],
        "lafs": frames,
        "image_size": torch.clamp(xy.max(dim=0).values, min=1.0)[None],
    }


def _build_lightglue(creator: str, values: Mapping[str, Any], trained: bool = False) -> Any:
    kind = import_kornia().LightGlue
    if trained:
        return kind(values["features"], filter_threshold=values["filter_threshold"])
    own = {"filter_threshold": values["filter_threshold"], **kind.features[values["features"]], "weights": None}
    return kind(None, **own)


def _lightglue_files(values: Mapping[str, Any]) -> tuple[str, ...]:
    kind = values["features"].replace("dog_affnet_hardnet", "doghardnet")
    if kind == "xfeat":
        return ("xfeat-lighterglue.pt",)
    if kind in ("keynet_affnet_hardnet", "dedodeb", "dedodeg"):
        return (f"{kind}_lightglue.pth",)
    stem = "doghardnet" if kind == "doghardnet" else f"{kind}_lightglue"
    return (f"{stem}_v0-1_arxiv-pth",)


def _build_loftr(creator: str, values: Mapping[str, Any], trained: bool = False) -> Any:
    import copy

    from kornia.feature.loftr.loftr import default_cfg

    config: Any = copy.deepcopy(default_cfg)
    config["match_coarse"]["thr"] = values["threshold"]
    config["coarse"]["temp_bug_fix"] = values["checkpoint"] == "indoor_new"
    return import_kornia().LoFTR(values["checkpoint"] if trained else None, config)


LOFTR_FILES = {"outdoor": "loftr_outdoor.ckpt", "indoor": "loftr_indoor.ckpt", "indoor_new": "loftr_indoor_ds_new.ckpt"}
SWITCHED = "0 switches the test off"
ADALAM = {
    "area_ratio": option(100, Ge(0)),
    "search_expansion": option(4, Ge(0)),
    "ransac_iters": option(128, Ge(0)),
    "min_inliers": option(6, Ge(0)),
    "min_confidence": option(200, Ge(0)),
    "orientation_difference_threshold": option(30.0, Ge(0), meaning=f"of the change of direction, degrees; {SWITCHED}"),
    "scale_rate_threshold": option(1.5, Ge(0), meaning=f"of the change of size; {SWITCHED}"),
    "detected_scale_rate_threshold": option(5.0, Ge(0)),
    "refit": option(True),
    "force_seed_mnn": option(True),
}
LIGHTGLUE = (
    "aliked", "dedodeb", "dedodeg", "disk", "dog_affnet_hardnet", "doghardnet", "keynet_affnet_hardnet", "sift",
    "xfeat",
)  # fmt: skip

TABLE: dict[str, NearestRow] = {
    "kornia-smnn": NearestRow(
        "match_smnn",
        "Mutual nearest neighbours that pass the ratio test both ways, by kornia",
        {"threshold": option(0.95, Ge(0)), **RUN},
        run=_smnn,
    ),
    "kornia-fginn": NearestRow(
        "match_fginn",
        "Nearest neighbours that pass the ratio test against the next one elsewhere, by kornia",
        {"threshold": option(0.85, Ge(0)), "spatial_threshold": option(10.0, Ge(0)), "mutual": option(True), **RUN},
        run=_fginn,
    ),
    "kornia-adalam": NearestRow(
        "match_adalam",
        "AdaLAM: nearest neighbours that agree with a local affine map, by kornia",
        {**ADALAM, **RUN},
        run=_adalam,
    ),
    "kornia-lightglue": NearestRow(
        "LightGlue",
        "LightGlue: learned matching of the features named, by kornia",
        {
            "features": option("disk", choices=LIGHTGLUE),
            "filter_threshold": option(0.1, Ge(0)),
            "weights": weights_option("Apache 2.0"),
            **RUN,
        },
        _build_lightglue,
        _lightglue_files,
        "huggingface.co/kornia/lightglue",
        run=_lightglue,
    ),
}
MATCHERS: dict[str, KorniaRow] = {
    "kornia-loftr": KorniaRow(
        "LoFTR",
        "LoFTR: learned dense matching without keypoints, by kornia",
        {
            **N_FEATURES,
            "checkpoint": option("outdoor", choices=tuple(LOFTR_FILES)),
            "threshold": option(0.2, Ge(0)),
            "max_side": option(840, Ge(1), meaning="longer images are reduced to it, px"),
            "weights": weights_option("Apache 2.0"),
            **COMMON,
        },
        _build_loftr,
        lambda values: (LOFTR_FILES[values["checkpoint"]],),
        "huggingface.co/kornia/loftr",
    )
}


@register_table
class KorniaNearest(KorniaMember, Nearest):
    """One way of kornia to pair descriptors: a row of the table by name, and its parameters."""

    table = TABLE

    def match_features(self, reference: Features, secondary: Features) -> tuple[IntArray, FloatArray]:
        """Return ((M, 2) rows of reference and secondary, (M,) score, higher is better).

        Raises
        ------
        ParameterError
            The two sets have descriptors of different kinds or lengths, none at all, or such as LightGlue's weights
            were not made for.
        PluginUnavailableError
            The trained weights are neither given nor here nor to be had.

        Notes
        -----
        The score is 1 minus the ratio of distances (kornia-smnn, kornia-fginn), the logarithm of the confidence in the
        local map (kornia-adalam), or LightGlue's own.
        """
        network = self.network()
        if not len(reference) or not len(secondary):
            return np.zeros((0, 2), np.int64), np.zeros(0)
        torch = import_torch()
        tables = [_vectors(features, self.name) for features in (reference, secondary)]
        if reference.norm != secondary.norm or tables[0].shape[1] != tables[1].shape[1]:
            kinds = f"{reference.norm} of length {tables[0].shape[1]} and {secondary.norm} of {tables[1].shape[1]}"
            raise ParameterError(f"{self.name} needs descriptors of one kind, got {kinds}")
        device = as_device(self.parameters["device"])
        with inference(self.parameters["threads"]):
            a, b = (torch.from_numpy(table).to(device) for table in tables)
            frames = [features.to_lafs().to(device, torch.float32) for features in (reference, secondary)]
            pairs, score = TABLE[self.name].run(network, self.parameters, a, b, *frames)
        rows = to_numpy(pairs, np.int64).reshape(-1, 2)
        order = np.lexsort((rows[:, 1], rows[:, 0]))
        return rows[order], to_numpy(score).reshape(-1)[order]


@register_table
class KorniaMatcher(KorniaMember, Matcher):
    """One matcher of kornia that needs no keypoints: a row of the table by name, and its parameters."""

    table = MATCHERS

    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return the tie points that LoFTR finds, best first, without those on invalid pixels.

        Raises
        ------
        PluginUnavailableError
            The trained weights are neither given nor here nor to be had.
        InputError
            The file of weights is not that of this network.

        Notes
        -----
        Every 8 x 8 cell of one image is compared with every one of the other, so that memory grows with the fourth
        power of the side. Images longer than `max_side` pixels are reduced to it first.
        """
        values = self.parameters
        network = self.network()
        with stage("match"), inference(values["threads"]):
            images = [
                _reduced(to_tensor(image, values["normalise"], values["device"]), values["max_side"])
                for image in (reference, secondary)
            ]
            found = network({"image0": images[0], "image1": images[1]})
            score = to_numpy(found["confidence"]).reshape(-1)
            ends = []
            for side, small, image in zip("01", images, (reference, secondary), strict=True):
                size = np.array(image.shape[::-1], np.float64) / np.array(small.shape[:-3:-1])
                # kornia's LoFTR puts the centre of the first pixel at (0.5, 0.5).
                ends.append(to_numpy(found[f"keypoints{side}"]).reshape(-1, 2) * size - 0.5)
        keep = _on_data(ends[0], reference) & _on_data(ends[1], secondary)
        rows = np.flatnonzero(keep)
        rows = rows[np.argsort(-score[rows], kind="stable")][: values["n_features"]]
        return Matches(ends[0][rows], ends[1][rows], score[rows])

    def searched_in(self, reference: Image, secondary: Image) -> tuple[Searched, Searched]:
        first, second = (_share(image, self.parameters["max_side"]) for image in (reference, secondary))
        return first, second


def _share(image: Image, side: int) -> Searched:
    longest = max(image.shape)
    return Searched(side / longest, "matcher.max_side") if longest > side else Searched()


def _vectors(features: Features, name: str) -> Any:
    """(N, D) float32 descriptors; bits become zeros and ones."""
    if features.descriptors is None:
        raise ParameterError(f"{name} needs descriptors, got features without: choose a descriptor")
    if features.norm == "hamming":
        return np.unpackbits(np.asarray(features.descriptors, np.uint8), axis=1).astype(np.float32)
    return np.array(features.descriptors, np.float32)


def _reduced(tensor: Any, side: int) -> Any:
    longest = max(tensor.shape[-2:])
    if longest <= side:
        return tensor
    from kornia.geometry.transform import resize

    size = tuple(max(16, round(n * side / longest)) for n in tensor.shape[-2:])
    return resize(tensor, size, interpolation="bilinear", align_corners=False, antialias=True)


def _on_data(xy: FloatArray, image: Image) -> BoolArray:
    """(M,) bool: the point lies on a valid pixel."""
    at = np.rint(xy).astype(np.int64)
    inside = ((at >= 0) & (at < np.array(image.shape[::-1]))).all(axis=1)
    at = np.clip(at, 0, np.array(image.shape[::-1]) - 1)
    return np.asarray(inside & image.mask[at[:, 1], at[:, 0]])
