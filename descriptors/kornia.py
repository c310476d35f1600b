"""Descriptors of kornia, one row of a table each: of patches cut at any detector's features.

A patch covers the square around a feature's support, turned by its angle; `magnification` enlarges it. Where a detector
gives the detection scale itself for the radius, as OpenCV's SIFT does, 6 is what kornia's own detectors use. `weights`
is a file of trained weights, None for those that kornia downloads.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from featreg.interfaces import Descriptor
from featreg.interop.kornia import COMMON, KorniaPart, Row, import_kornia
from featreg.interop.opencv import inside
from featreg.interop.torch_arrays import inference, to_tensor
from featreg.registry import register_family
from featreg.types import Features, Image
from featreg.types.lafs import to_numpy

LEARNED_PATCH = 32
# Patches cut and described at a time, so that memory stays bounded.
BATCH = 2048


class KorniaDescriptor(KorniaPart, Descriptor):
    """One descriptor of kornia: a row of the table by name, and its parameters."""

    @property
    def row(self) -> Row:
        return TABLE[self.name]

    def describe_features(self, image: Image, features: Features) -> Features:
        """Return the features with (N, D) float32 descriptors of norm "l2", without those outside the image.

        Raises
        ------
        PluginUnavailableError
            The trained weights are neither given nor here nor to be had.
        InputError
            The file of weights is not that of this network.
        """
        values = self.parameters
        network = self.network()
        rows = np.flatnonzero(inside(features.xy, image.shape))
        kept = features.take(rows)
        index = None if len(rows) == len(features) else rows
        if not len(rows):
            return replace(kept, descriptors=None, index=rows if len(features) else None)
        side = values.get("patch_size", LEARNED_PATCH)
        library = import_kornia()
        with inference(values["threads"]):
            tensor = to_tensor(image, values["normalise"], values["device"])
            enlarged = replace(kept, scale=kept.scale * values["magnification"])
            lafs = enlarged.to_lafs().to(tensor.device, tensor.dtype)
            parts = [
                to_numpy(library.get_laf_descriptors(tensor, lafs[:, i : i + BATCH], network, side)[0], np.float32)
                for i in range(0, len(rows), BATCH)
            ]
        return replace(kept, descriptors=np.concatenate(parts), norm="l2", index=index)


def _sift(values: Mapping[str, Any]) -> Any:
    names = ("patch_size", "num_ang_bins", "num_spatial_bins", "rootsift", "clipval")
    return import_kornia().SIFTDescriptor(**{name: values[name] for name in names})


def _mkd(values: Mapping[str, Any]) -> Any:
    return import_kornia().MKDDescriptor(values["patch_size"], values["kernel_type"], whitening=None)


def _learned(kind: str, values: Mapping[str, Any], trained: bool = False) -> Any:
    return getattr(import_kornia(), kind)(pretrained=trained)


def _row(kind: str, summary: str, file: str) -> Row:
    """A network that describes patches of 32 x 32 pixels."""
    return Row(
        f"{summary}, by kornia",
        {"magnification": 1.0, "weights": None, **COMMON},
        partial(_learned, kind),
        {},
        lambda values: (file,),
        f"huggingface.co/kornia/{kind.lower().rstrip('8')}",
        partial(_learned, kind, trained=True),
    )


TABLE: dict[str, Row] = {
    "kornia-sift": Row(
        "SIFT (RootSIFT) histograms of patches, by kornia",
        {
            "patch_size": 41,
            "num_ang_bins": 8,
            "num_spatial_bins": 4,
            "rootsift": True,
            "clipval": 0.2,
            "magnification": 1.0,
            **COMMON,
        },
        _sift,
    ),
    "kornia-mkd": Row(
        "MKD: kernel embeddings of gradients, without whitening, by kornia",
        {"patch_size": 32, "kernel_type": "concat", "magnification": 1.0, **COMMON},
        _mkd,
        {"kernel_type": ("concat", "polar", "cart")},
    ),
    "kornia-hardnet": _row("HardNet", "HardNet: learned, of length 128", "checkpoint_liberty_with_aug.pth"),
    "kornia-hardnet8": _row("HardNet8", "HardNet8: learned, of length 128", "hardnet8v2.pt"),
    "kornia-hynet": _row("HyNet", "HyNet: learned, of length 128", "HyNet_LIB.pth"),
    "kornia-sosnet": _row("SOSNet", "SOSNet: learned, of length 128", "sosnet_32x32_liberty.pth"),
}


def _create(name: str, **parameters: Any) -> KorniaDescriptor:
    return KorniaDescriptor(name, parameters)


for _name, _entry in TABLE.items():
    register_family(
        "descriptor",
        _name,
        partial(_create, _name),
        _entry.parameters,
        summary=_entry.summary,
        module=__name__,
        unavailable=_entry.unavailable,
        on_demand=_entry.on_demand,
    )
