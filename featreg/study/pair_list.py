"""A list of image pairs in a file: CSV with a line for each pair, and columns that say what belongs to it."""

from __future__ import annotations

import csv
import dataclasses
import io
import logging
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from featreg.errors import InputError, suggest
from featreg.io.source_names import parse_source
from featreg.study.image_pairs import pairs_in

#: Columns in the order in which they stand where the file has no line of titles.
COLUMNS = ("reference", "secondary", "output", "name", "mask_reference", "mask_secondary", "initial")

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ListedPair:
    """One pair of a list; paths lead to their files from the working folder.

    Parameters
    ----------
    name : no other pair of the list has it, and it can be that of a file
    reference, secondary : the images
    output : where the result shall be written; "" leaves it to the command
    mask_reference, mask_secondary, initial : as the keywords of `featreg.match`; "" where there is none
    """

    name: str
    reference: str
    secondary: str
    output: str = ""
    mask_reference: str = ""
    mask_secondary: str = ""
    initial: str = ""


def read_pair_list(source: str | Path) -> list[ListedPair]:
    """Read a list of pairs.

    Parameters
    ----------
    source : a CSV file with the columns `COLUMNS`, of which the first two must be there: by a line of titles in any
        order, without one in this order; or a folder of images named in pairs (`featreg.study.image_pairs`).
        Relative paths of images count from the folder of the file. Lines that are empty or begin with # are left out

    Raises
    ------
    InputError
        The file cannot be read, its first line is neither a pair nor titles of these columns, a line lacks an image,
        or two pairs have one name or one output.
    """
    path = Path(source)
    if path.is_dir():
        # NAME.json beside images is the truth of the pair, which no result may replace or stand for.
        return [
            dataclasses.replace(pair, output=f"{pair.name}.result.json")
            for pair in _named_apart(
                [ListedPair(p["name"], p["reference"], p["secondary"]) for p in pairs_in(path)], path
            )
        ]
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"'{path}' is no list of pairs: it is no text in UTF-8") from error
    kept = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    separator = ";" if kept and kept[0].count(";") > kept[0].count(",") else ","
    try:
        reader = csv.reader(io.StringIO("\n".join(kept)), delimiter=separator, skipinitialspace=True)
        rows = [[cell.strip() for cell in row] for row in reader]
    except csv.Error as error:
        raise InputError(f"'{path}' is no list of pairs: {error}") from error
    titles, rows = _titles(rows, path)
    for i, row in enumerate(rows, start=1):
        if any(row[len(titles) :]):
            # A comma in a name without quotes: what stands where is not known then.
            raise InputError(
                f"'{path}': pair {i} has {len(row)} cells for {len(titles)} columns; quote names with '{separator}'"
            )
    found = [_pair(dict(zip(titles, row, strict=False)), path, i) for i, row in enumerate(rows, start=1)]
    if not found:
        raise InputError(f"'{path}' lists no pair: a line is REFERENCE,SECONDARY[,OUTPUT]")
    return _named_apart(found, path)


def _titles(rows: Sequence[list[str]], path: Path) -> tuple[list[str], list[list[str]]]:
    """The columns, and the rows below their titles."""
    first = [cell.lower() for cell in rows[0]] if rows else []
    if "reference" not in first and "secondary" not in first:
        longest = max(map(len, rows), default=0)
        if longest > len(COLUMNS):
            raise InputError(f"'{path}' has lines of {longest} columns and no titles; the columns are {_list()}")
        if len(rows) > 1 and _names_no_file(rows[0], path) and not any(_names_no_file(row, path) for row in rows[1:]):
            raise InputError(
                f"'{path}': the first line, '{', '.join(rows[0])}', names neither images nor columns; "
                f"the columns are {_list()}, and a list without titles begins with its first pair"
            )
        return list(COLUMNS), list(rows)
    for name in COLUMNS[:2]:
        if name not in first:
            raise InputError(f"'{path}' has no column '{name}', {suggest(name, first)}; the columns are {_list()}")
    for name in first:
        if first.count(name) > 1:
            raise InputError(f"'{path}' has the column '{name}' twice")
        if name not in COLUMNS:
            logger.warning("%s: the column '%s' is not used; known are %s", path, name, _list())
    return first, list(rows[1:])


def _names_no_file(row: Sequence[str], path: Path) -> bool:
    """Whether all cells are bare words, of which none is there as a file or folder."""
    return not any(re.search(r"[./\\:]", cell) or os.path.exists(path.parent / cell) for cell in row if cell)


def _list() -> str:
    return ", ".join(COLUMNS)


def _pair(cells: dict[str, str], path: Path, line: int) -> ListedPair:
    given = {name: cells.get(name, "") for name in COLUMNS}
    missing = [name for name in COLUMNS[:2] if not given[name]]
    if missing:
        raise InputError(f"'{path}': pair {line} has no {' and no '.join(missing)}")
    for name in ("reference", "secondary", "mask_reference", "mask_secondary", "initial"):
        if given[name]:
            given[name] = _from_folder(given[name], path.parent)
    usual = "_".join(_stem(given[name]) for name in COLUMNS[:2])
    return ListedPair(**{**given, "name": _file_name(given["name"] or usual)})


def _from_folder(name: str, folder: Path) -> str:
    """The name of an image as seen from here: its file, also where a dataset or a driver stands beside it."""
    name = re.sub(r"^(\./)+", "", name)
    path = parse_source(name).path
    if path is None or path.is_absolute():
        return name
    return name.replace(str(path), str(folder / path), 1)


def _stem(name: str) -> str:
    path = parse_source(name).path
    return name if path is None else path.stem or path.name


def _file_name(text: str) -> str:
    return re.sub(r"[^\w.+-]+", "-", text).strip("-.") or "pair"


def _named_apart(pairs: list[ListedPair], path: Path) -> list[ListedPair]:
    """The pairs, those of one name numbered; whoever gave two pairs one output meant something else."""
    outputs = [pair.output for pair in pairs if pair.output]
    for output in outputs:
        if outputs.count(output) > 1:
            raise InputError(f"'{path}' gives the output '{output}' to two pairs")
    names = [pair.name for pair in pairs]
    twice = {name for name in names if names.count(name) > 1}
    width = len(str(len(pairs)))
    return [
        ListedPair(**{**vars(pair), "name": f"{i:0{width}d}-{pair.name}" if pair.name in twice else pair.name})
        for i, pair in enumerate(pairs, start=1)
    ]
