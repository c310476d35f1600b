"""Descriptors of kornia, one row of a table each: of patches cut at any detector's features.

A patch covers the square around a feature's support, turned by its angle; `magnification` enlarges it. Where a detector
gives the detection scale itself for the radius, as OpenCV's SIFT does, 6 is what kornia's own detectors use. `weights`
is a file of trained weights, or "auto": see `featreg.interop.weights`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from annotated_types import Ge, Gt

from featreg.interfaces import Descriptor
from featreg.interop.family import option, register_table
from featreg.interop.kornia import COMMON, KorniaMember, KorniaRow, import_kornia
from featreg.interop.opencv import inside
from featreg.interop.torch_arrays import inference, to_tensor
from featreg.interop.weights import weights_option
from featreg.types import Features, Image
from featreg.types.lafs import to_numpy

LEARNED_PATCH = 32
# Patches cut and described at a time, so that memory stays bounded.
BATCH = 2048


def _sift(creator: str, values: Mapping[str, Any]) -> Any:
    names = ("patch_size", "num_ang_bins", "num_spatial_bins", "rootsift", "clipval")
    return import_kornia().SIFTDescriptor(**{name: values[name] for name in names})


def _mkd(creator: str, values: Mapping[str, Any]) -> Any:
    return import_kornia().MKDDescriptor(values["patch_size"], values["kernel_type"], whitening=None)


def _learned(creator: str, values: Mapping[str, Any], trained: bool = False) -> Any:
    return getattr(import_kornia(), creator)(pretrained=trained)


def _network(creator: str, file: str, terms: str) -> KorniaRow:
    """A network that describes patches of 32 x 32 pixels."""
    return KorniaRow(
        creator,
        f"{creator}: learned, of length 128, by kornia",
        {"magnification": MAGNIFICATION, "weights": weights_option(terms), **COMMON},
        _learned,
        lambda values: (file,),
        f"huggingface.co/kornia/{creator.lower().rstrip('8')}",
    )


MAGNIFICATION = option(1.0, Gt(0), meaning="how much larger than a feature's support its patch is")
TABLE: dict[str, KorniaRow] = {
    "kornia-sift": KorniaRow(
        "SIFTDescriptor",
        "SIFT (RootSIFT) histograms of patches, by kornia",
        {
            "patch_size": option(41, Ge(1)),
            "num_ang_bins": option(8, Ge(1)),
            "num_spatial_bins": option(4, Ge(1)),
            "rootsift": option(True),
            "clipval": option(0.2, Gt(0)),
            "magnification": MAGNIFICATION,
            **COMMON,
        },
        _sift,
    ),
    "kornia-mkd": KorniaRow(
        "MKDDescriptor",
        "MKD: kernel embeddings of gradients, without whitening, by kornia",
        {
            "patch_size": option(32, Ge(1)),
            "kernel_type": option("concat", choices=("concat", "polar", "cart")),
            "magnification": MAGNIFICATION,
            **COMMON,
        },
        _mkd,
    ),
    "kornia-hardnet": _network("HardNet", "checkpoint_liberty_with_aug.pth", "MIT"),
    "kornia-hardnet8": _network("HardNet8", "hardnet8v2.pt", "MIT"),
    "kornia-hynet": _network("HyNet", "HyNet_LIB.pth", "MIT"),
    "kornia-sosnet": _network("SOSNet", "sosnet_32x32_liberty.pth", "none stated: ask the authors"),
}


@register_table
class KorniaDescriptor(KorniaMember, Descriptor):
    """One descriptor of kornia: a row of the table by name, and its parameters."""

    table = TABLE

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
