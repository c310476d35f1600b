"""RPC files beside an image: GDAL's ``_RPC.TXT`` and DigitalGlobe's ``.RPB``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from featreg.errors import ParameterError
from featreg.io.writers import replacing

#: rasterio's name -> name in .RPB, unit in _RPC.TXT.
FIELDS: Mapping[str, tuple[str, str]] = {
    "line_off": ("lineOffset", "pixels"),
    "samp_off": ("sampOffset", "pixels"),
    "lat_off": ("latOffset", "degrees"),
    "long_off": ("longOffset", "degrees"),
    "height_off": ("heightOffset", "meters"),
    "line_scale": ("lineScale", "pixels"),
    "samp_scale": ("sampScale", "pixels"),
    "lat_scale": ("latScale", "degrees"),
    "long_scale": ("longScale", "degrees"),
    "height_scale": ("heightScale", "meters"),
}
TABLES: Mapping[str, str] = {
    "line_num_coeff": "lineNumCoef",
    "line_den_coeff": "lineDenCoef",
    "samp_num_coeff": "sampNumCoef",
    "samp_den_coeff": "sampDenCoef",
}


def write_rpc(path: str | Path, rpcs: Mapping[str, Any]) -> None:
    """Write an RPC as a file that GDAL finds beside ``NAME.tif``; it appears whole or not at all.

    Parameters
    ----------
    path : ``NAME_RPC.TXT`` or ``NAME.RPB`` (in any case)
    rpcs : under rasterio's names

    Raises
    ------
    ParameterError
        Another name.
    InputError
        The file cannot be written.

    Notes
    -----
    Both formats count sample and line from the centre of the first pixel, as this package does.
    """
    path = Path(path)
    name = path.name.lower()
    if name.endswith("_rpc.txt"):
        text = as_txt(rpcs)
    elif name.endswith(".rpb"):
        text = as_rpb(rpcs)
    else:
        raise ParameterError(f"{path}: an RPC file is called NAME_RPC.TXT or NAME.RPB")
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="ascii")


def as_txt(rpcs: Mapping[str, Any]) -> str:
    """The text of an ``_RPC.TXT`` file."""
    lines = [f"{name.upper()}: {rpcs[name]!r} {unit}" for name, (_, unit) in FIELDS.items()]
    lines += [
        f"{name.upper()}: {rpcs[name]!r} meters" for name in ("err_bias", "err_rand") if rpcs.get(name) is not None
    ]
    for name in TABLES:
        lines += [f"{name.upper()}_{i}: {value!r}" for i, value in enumerate(rpcs[name], start=1)]
    return "\n".join(lines) + "\n"


def as_rpb(rpcs: Mapping[str, Any]) -> str:
    """The text of an ``.RPB`` file."""
    lines = ['satId = "????";', 'bandId = "P";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE"]
    lines += [f"\terrBias = {rpcs.get('err_bias') or 0.0!r};", f"\terrRand = {rpcs.get('err_rand') or 0.0!r};"]
    lines += [f"\t{name} = {rpcs[key]!r};" for key, (name, _) in FIELDS.items()]
    for key, name in TABLES.items():
        values = ",\n".join(f"\t\t\t{value!r}" for value in rpcs[key])
        lines.append(f"\t{name} = (\n{values});")
    return "\n".join([*lines, "END_GROUP = IMAGE", "END;"]) + "\n"
