"""The corrected RPC of a result whose model is an `rpc-bias`: GDAL's ``NAME_RPC.TXT`` or ``NAME.RPB``."""

from __future__ import annotations

from pathlib import Path

from featreg.errors import InputError
from featreg.exports.content import Content
from featreg.geolocation import RpcBias


def write(content: Content, path: Path) -> None:
    """Write the secondary's RPC, corrected so that it agrees with the reference's sensor at the tie points."""
    if not isinstance(content.model, RpcBias):
        raise InputError(
            f"{path.name}: a corrected RPC needs a result of the model rpc-bias; match with --model rpc-bias"
        )
    content.model.write_corrected_rpc(path)
