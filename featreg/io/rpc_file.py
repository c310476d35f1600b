"""RPC files beside an image, read and written: GDAL's ``_RPC.TXT`` and DigitalGlobe's ``.RPB``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from featreg.errors import InputError, ParameterError
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


#: Bytes of an RPC file at most; real ones have 5 kB.
LARGEST = 1 << 20


def rpc_beside(image: str | Path) -> dict[str, Any] | None:
    """Return the RPC of the file beside an image, ``NAME_RPC.TXT`` or ``NAME.RPB`` in any case, under rasterio's names.

    None where there is none. GDAL itself looks for them beside some formats only.

    Raises
    ------
    InputError
        The file is there and cannot be read.
    """
    image = Path(image)
    for ending in ("_rpc.txt", ".rpb"):
        wanted = f"{image.stem}{ending}".lower()
        for name in (f"{image.stem}{ending}", f"{image.stem}{ending.upper()}"):
            beside = image.with_name(name)
            if beside.name.lower() == wanted and beside.is_file():
                return read_rpc(beside)
    return None


def read_rpc(path: str | Path) -> dict[str, Any]:
    """Return the RPC of a file ``NAME_RPC.TXT`` or ``NAME.RPB``, under rasterio's names.

    Raises
    ------
    InputError
        The file cannot be read, or lacks a number.
    """
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: is larger than {LARGEST >> 20} MB, no RPC file is")
        text = path.read_text(encoding="ascii", errors="replace")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        return _of_rpb(text) if path.suffix.lower() == ".rpb" else _of_txt(text)
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: is no whole RPC file ({type(error).__name__}: {error})") from error


def _of_txt(text: str) -> dict[str, Any]:
    """The RPC of an ``_RPC.TXT``: lines of name, colon, number and unit."""
    found = {key.lower(): float(value) for key, value in re.findall(r"(?m)^\s*([A-Za-z]\w*)\s*:\s*(\S+)", text)}
    made: dict[str, Any] = {name: found[name] for name in FIELDS}
    made |= {name: [found[f"{name}_{i}"] for i in range(1, 21)] for name in TABLES}
    return made | {name: found.get(name) for name in ("err_bias", "err_rand")}


def _of_rpb(text: str) -> dict[str, Any]:
    """The RPC of an ``.RPB``: name, equals sign, and a number or twenty in brackets."""
    found = {name: value.strip(" \t\r\n()") for name, value in re.findall(r"(\w+)\s*=\s*([^;=]+);", text)}
    made: dict[str, Any] = {key: float(found[name]) for key, (name, _) in FIELDS.items()}
    for key, name in TABLES.items():
        made[key] = [float(word) for word in found[name].replace(",", " ").split()]
        if len(made[key]) != 20:
            raise ValueError(f"{name} has {len(made[key])} numbers, 20 are needed")
    # Zero is how the files say that an error is unknown.
    errors = {"err_bias": "errBias", "err_rand": "errRand"}
    return made | {key: float(found.get(name, "0")) or None for key, name in errors.items()}


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
