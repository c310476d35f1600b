"""Image pairs as they are given: tuples, dicts, or a folder whose files are named in pairs.

The naming rule of a folder: two images whose names end in the two words of one of `ENDINGS` and agree before it,
``port_1.tif`` and ``port_2.tif`` or ``port-before.png`` and ``port-after.png``. The truth of a pair is a file
``port_truth`` or ``port`` with one of the endings of a truth file.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from featreg.errors import FeatregError, InputError, suggest
from featreg.io.source_names import parse_source
from featreg.study.jobs import HEIGHTS, Pair
from featreg.study.truth import TRUTH_SUFFIXES, Truth, read_truth

ENDINGS = (
    ("1", "2"), ("a", "b"), ("reference", "secondary"), ("ref", "sec"), ("master", "slave"), ("before", "after"),
    ("pre", "post"),
)  # fmt: skip
IMAGE_SUFFIXES = (
    ".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp", ".npy", ".mat", ".jp2", ".img", ".ntf", ".nitf", ".vrt", ".h5",
    ".nc", ".slc", ".dat", ".zip",
)  # fmt: skip
PAIR_KEYS = ("reference", "secondary", "truth", "name", *HEIGHTS)


def resolve(given: Sequence[Any]) -> list[Pair]:
    """Return the pairs with names that differ and their truth read.

    Raises
    ------
    InputError
        A pair that cannot be understood, a truth that cannot be used; nothing has been computed then.
    """
    found: list[Pair] = []
    for i, pair in enumerate(given, start=1):
        reference, secondary, truth, name = parts(pair, f"pair {i}")
        images = [_file_or_name(image) for image in (reference, secondary)]
        paths = [Path(p) for p in (getattr(image, "name", image) for image in images) if isinstance(p, str | Path)]
        usual = " / ".join(p.stem for p in paths) if len(paths) == 2 and paths[0] != paths[1] else f"pair {i}"
        known = None if truth is None else _truth(truth, images, f"pair {i}")
        heights = _heights(pair, f"pair {i}") if isinstance(pair, Mapping) else {}
        found.append(Pair(usual if name is None else name, images[0], images[1], known, heights))
    if not found:
        raise InputError("a comparison needs at least one pair (reference, secondary)")
    if len({pair.name for pair in found}) < len(found):
        return [dataclasses.replace(pair, name=f"{i}: {pair.name}") for i, pair in enumerate(found, start=1)]
    return found


def parts(pair: Any, where: str) -> tuple[Any, Any, Any, str | None]:
    """(reference, secondary, truth, name) of one pair as it is given; the last two may be None."""
    if isinstance(pair, Mapping):
        for key in pair:
            if key not in PAIR_KEYS:
                raise InputError(f"{where}: unknown key '{key}', {suggest(str(key), PAIR_KEYS)}")
        missing = [key for key in PAIR_KEYS[:2] if pair.get(key) is None]
        if missing:
            raise InputError(f"{where} has no {' and no '.join(missing)}")
        name = pair.get("name")
        return pair["reference"], pair["secondary"], pair.get("truth"), None if name is None else str(name)
    if isinstance(pair, str) or not isinstance(pair, Sequence) or not 2 <= len(pair) <= 3:
        raise InputError(f"{where} must be (reference, secondary) or (reference, secondary, truth)")
    return pair[0], pair[1], pair[2] if len(pair) == 3 else None, None


def _heights(pair: Mapping[str, Any], where: str) -> dict[str, Any]:
    given = {name: pair[name] for name in HEIGHTS if pair.get(name) is not None}
    if len(given) > 1:
        raise InputError(f"{where}: heights come from 'dem' or from 'height', not from both")
    dem, height = given.get("dem"), given.get("height")
    if dem is not None and not (isinstance(dem, str | Path) and Path(dem).is_file()):
        raise InputError(f"{where}: no elevation model '{dem}'")
    number = isinstance(height, int | float) and not isinstance(height, bool) and math.isfinite(height)
    if height is not None and not number:
        raise InputError(f"{where}: height must be a number of metres, got {height!r}")
    return given


def pairs_in(folder: str | Path) -> list[dict[str, str]]:
    """Return the pairs of a folder by the names of its files, sorted.

    Raises
    ------
    InputError
        The folder does not exist or holds no pair.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"'{folder}' is not a folder of image pairs")
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    images = [path for path in files if path.suffix.lower() in IMAGE_SUFFIXES]
    found = []
    for first, second in ENDINGS:
        for path in images:
            cut = re.fullmatch(rf"(.*[^a-zA-Z0-9])?({first})", path.stem, re.IGNORECASE)
            if cut is None or cut[1] is None:
                continue
            partners = [p for p in images if p.stem.lower() == f"{cut[1]}{second}".lower()]
            if not partners:
                continue
            # A quick look beside the image has its name: an image goes with one of its own kind where there is one.
            partner = min(partners, key=lambda p: p.suffix.lower() != path.suffix.lower())
            name = re.sub(r"[^a-zA-Z0-9]+$", "", cut[1])
            truth = next((p for p in files if p.stem in (f"{name}_truth", f"{name}-truth", name)
                          and p.suffix.lower() in TRUTH_SUFFIXES and p not in (path, partner)), None)  # fmt: skip
            pair = {"name": name, "reference": str(path), "secondary": str(partner)}
            found.append(pair | ({} if truth is None else {"truth": str(truth)}))
    if not found:
        words = ", ".join(f"*_{a} and *_{b}" for a, b in ENDINGS)
        raise InputError(f"the folder '{folder}' holds no pairs: two images whose names end in {words}")
    return sorted(found, key=lambda pair: pair["name"])


def _truth(truth: Any, images: Sequence[Any], where: str) -> Truth | None:
    try:
        return read_truth(truth, images=(images[0], images[1]))
    except FeatregError as error:
        if not all(opens(image) for image in images):
            # The pair's own row says why it could not be matched.
            return None
        raise InputError(f"{where}: {error}") from error


def _file_or_name(image: Any) -> Any:
    """A file as a path, whose content counts in digests; a dataset inside a file keeps its name."""
    if not isinstance(image, str):
        return image
    named = parse_source(image)
    return named.path if named.path is not None and named.dataset is None and named.gdal is None else image


def opens(image: Any) -> bool:
    """Whether an image can be opened at all; one that is no file is looked at when it is matched."""
    from featreg.io.opening import open_reader

    if not isinstance(image, str | Path):
        return True
    try:
        open_reader(image).close()
    except FeatregError:
        return False
    return True
