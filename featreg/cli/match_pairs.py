"""`featreg match` of a list of pairs: one process, a result and a row for each, whatever becomes of the others."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from featreg.cli.checking import STDOUT, check_folder
from featreg.cli.match_summary import figures, one_line
from featreg.cli.progress import announce_compiling, saying_when_interrupted
from featreg.cli.terminal import print_styled
from featreg.errors import FeatregError, InputError, ParameterError

if TYPE_CHECKING:
    from featreg.cli.match import MatchRequest
    from featreg.results.registration import Registration
    from featreg.study.pair_list import ListedPair

#: Columns of the summary. `key` is a digest of all that decides a result; a pair whose key is as before is not matched
#: again.
COLUMNS = (
    "name", "reference", "secondary", "status", "reason", "method", "model", "rotation_deg", "scale", "dx", "dy",
    "putative", "inliers", "rmse_px", "seconds", "result", "key",
)  # fmt: skip
FAILED = "failed"
COLOURS = {"ok": "", "unreliable": "yellow", FAILED: "red"}


def is_list(source: str) -> bool:
    """Whether a path names a list of pairs rather than an image."""
    path = Path(source)
    if path.is_dir():
        from featreg.study.image_pairs import opens

        return not opens(path)
    return path.suffix.lower() == ".csv"


def match_pairs(source: str, output: str | None, plot: str | None, request: MatchRequest) -> int:
    """Match every pair of a list and return the exit code.

    Parameters
    ----------
    source : a CSV file or a folder, see `featreg.study.pair_list`
    output : folder of the results; None for that of the list
    plot : folder of the pictures; None for no pictures
    request : how every pair is matched

    Raises
    ------
    FeatregError
        The list, a folder or an option cannot be used; what is wrong with a single pair is its row.
    """
    path = Path(source)
    folder = _folder(output, "--output") or (path if path.is_dir() else path.parent)
    pictures = _folder(plot, "--plot")
    with request.running([]):
        from featreg.matching import check_keywords
        from featreg.study.pair_list import read_pair_list

        pairs = read_pair_list(path)
        request.check_radius([pair.initial for pair in pairs])
        check_keywords(request.keywords())
        batch = _Batch(folder, folder / f"{path.resolve().stem}.summary.csv", pictures, request)
        batch.keep_rows_of(pairs)
        targets = [batch.target(pair) for pair in pairs]
        _check_targets(path, pairs, targets, batch)
        announce_compiling()
        with saying_when_interrupted(f"the finished pairs are kept in '{folder}': the same command goes on from there"):
            for i, (pair, target) in enumerate(zip(pairs, targets, strict=True), start=1):
                row = batch.take(pair, target)
                count = f"[{i:>{len(str(len(pairs)))}}/{len(pairs)}] "
                print_styled([[(count, "dim"), (one_line(row), COLOURS[row["status"]])]])
    counts = {status: sum(row["status"] == status for row in batch.rows) for status in ("ok", "unreliable", FAILED)}
    reused = f" ({batch.reused} from before)" if batch.reused else ""
    typer.echo(f"{', '.join(f'{n} {status}' for status, n in counts.items())}{reused}; written: {batch.summary}")
    return 4 if counts[FAILED] else 3 if counts["unreliable"] else 0


def _folder(given: str | None, option: str) -> Path | None:
    if given is None:
        return None
    if given == STDOUT:
        raise ParameterError(f"{option} - is for one pair; for a list of pairs give a folder")
    folder = Path(given)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{option} '{given}' is a file, for a list of pairs a folder is needed")
    check_folder(folder if folder.is_dir() else folder.absolute().parent, f"{option} '{given}'")
    return folder


def _check_targets(source: Path, pairs: Sequence[ListedPair], targets: Sequence[Path], batch: _Batch) -> None:
    """Raise where a result or a picture would replace an input, the list, its summary or the result of another pair."""
    files = {source, *(Path(file) for file in batch.request.files if file)}
    for pair in pairs:
        read = (pair.reference, pair.secondary, pair.mask_reference, pair.mask_secondary, pair.initial)
        files |= {Path(file) for file in read if file}
    inputs = {file.resolve() for file in files}
    seen: set[Path] = {batch.summary.resolve()}
    for pair, target in zip(pairs, targets, strict=True):
        place = target.resolve()
        if place in inputs:
            raise InputError(f"the output '{target}' of pair {pair.name} would replace an input, give another name")
        if place in seen:
            raise InputError(f"the output '{target}' of pair {pair.name} is written already, give another name")
        seen.add(place)
        picture = batch.picture(pair)
        if picture is not None and picture.resolve() in inputs:
            raise InputError(f"the picture '{picture}' of pair {pair.name} would replace an input, give another folder")


@dataclass
class _Batch:
    """The rows so far, and what earlier runs left.

    Parameters
    ----------
    folder : of the results
    summary : the file of the rows, written anew after each pair
    pictures : folder of pictures, or None
    request : how every pair is matched
    """

    folder: Path
    summary: Path
    pictures: Path | None
    request: MatchRequest
    rows: list[dict[str, Any]] = field(default_factory=list)
    reused: int = 0

    def __post_init__(self) -> None:
        from featreg.study.prediction_cache import PredictionCache

        self._before = _rows_of(self.summary)
        self._keys = PredictionCache(self.folder)

    def keep_rows_of(self, pairs: Sequence[ListedPair]) -> None:
        """Leave aside rows of earlier runs whose pair is no longer in the list."""
        names = {pair.name for pair in pairs}
        self._before = {name: row for name, row in self._before.items() if name in names}

    def target(self, pair: ListedPair) -> Path:
        """Where the result of a pair is written."""
        return self.folder / (pair.output or f"{pair.name}.json")

    def picture(self, pair: ListedPair) -> Path | None:
        """Where the picture of a pair is written, if there shall be any."""
        return None if self.pictures is None else self.pictures / f"{pair.name}.png"

    def take(self, pair: ListedPair, target: Path) -> dict[str, Any]:
        """Match a pair, or take its row from an earlier run; the row is also in the summary then."""
        start = time.perf_counter()
        row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
        row |= {"name": pair.name, "reference": pair.reference, "secondary": pair.secondary, "result": str(target)}
        try:
            keywords = self.request.keywords(pair.initial or None) | _masks(pair)
            key = self._keys.key(pair.name, (Path(pair.reference), Path(pair.secondary)), keywords) or ""
            kept = self._before.get(pair.name, {})
            picture = self.picture(pair)
            drawn = picture is None or picture.is_file()
            if key and drawn and kept.get("key") == key and kept.get("result") == str(target) and target.is_file():
                self.reused += 1
                row = dict(kept)
            else:
                row |= self._matched(pair, target, keywords)
                row |= {"seconds": round(time.perf_counter() - start, 3), "key": key}
        except FeatregError as error:
            row |= {"status": FAILED, "reason": " ".join(str(error).split()), "result": ""}
        except MemoryError:
            row |= {"status": FAILED, "reason": "there is too little memory for this pair", "result": ""}
        except Exception as error:
            # A fault of a plugin or of this program in one pair is not one of the others.
            row |= {"status": FAILED, "reason": f"internal error: {type(error).__name__}: {error}", "result": ""}
        self.rows.append(row)
        self._write()
        return row

    def _matched(self, pair: ListedPair, target: Path, keywords: Mapping[str, Any]) -> dict[str, Any]:
        more = dict(keywords)
        if self.request.blocks.resume is not None:
            more["resume"] = str(Path(self.request.blocks.resume, pair.name))
            Path(self.request.blocks.resume).mkdir(exist_ok=True)
        result: Registration = self.request.match(pair.reference, pair.secondary, **more)
        target.parent.mkdir(parents=True, exist_ok=True)
        result.to_json(target)
        picture = self.picture(pair)
        if picture is not None:
            picture.parent.mkdir(exist_ok=True)
            masks = {f"{role}_mask": more[f"{role}_mask"] for role in ("reference", "secondary")}
            self.request.draw(pair.reference, pair.secondary, result, str(picture), masks)
        return figures(result)

    def _write(self) -> None:
        """Write the summary: the rows of this run, and those of pairs that it has not reached."""
        from featreg.runtime.files import write_atomic

        done = {row["name"] for row in self.rows}
        out = io.StringIO()
        writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        writer.writerows(row for name, row in self._before.items() if name not in done)
        self.summary.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(self.summary, out.getvalue().encode(errors="backslashreplace"), sync=False)


def _masks(pair: ListedPair) -> dict[str, Any]:
    given = {"reference_mask": pair.mask_reference, "secondary_mask": pair.mask_secondary}
    return {name: file for name, file in given.items() if file}


def _rows_of(summary: Path) -> dict[str, dict[str, str]]:
    """Name -> row of an earlier run; nothing where there is none that can be read."""
    try:
        rows = list(csv.DictReader(io.StringIO(summary.read_text(encoding="utf-8"))))
    except (OSError, UnicodeDecodeError, csv.Error):
        return {}
    return {row["name"]: row for row in rows if set(row) == set(COLUMNS) and row["status"] != FAILED}
