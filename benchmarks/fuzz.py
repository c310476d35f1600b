"""What damaged files do to the readers: an exception of another kind, a hang, too much memory, a crash.

    python benchmarks/fuzz.py [--trials 300] [--seed 0] [--kinds images,results] [--keep FOLDER]

Sound files of every kind that featreg reads are damaged at random (bits, headers, lengths, numbers, structure) and read
in a process of its own, which is watched: whatever is no result and no `FeatregError`, takes more than 5 s of its
processor's time, more than 1 GB beyond what the process had, or ends the process is a fault. Equal seeds give equal
files; `--keep` writes those of the faults.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import re
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import featreg
from featreg.errors import FeatregError

LONGEST_S, MOST_MB = 5.0, 1024.0
#: So many times that on the clock is a hang that takes no time of the processor; other work on the machine is none.
ON_THE_CLOCK = 12.0
#: Address space of the watched process beyond what it starts with: it ends before the machine does.
SPACE = 6 << 30
NUMBERS = (
    "0", "-1", "1e999", "-1e999", "NaN", "null", "1e-320", "2147483648", "-9223372036854775809", "1" + "0" * 400,
    "0x10", "true", '""', "[]", "{}", "1,5", "١", "--", "4294967295", "99999",
)  # fmt: skip
FIELDS = (b"\x00", b"\xff", b"\x7f", b"\x80", b"\x01")
COLUMNS = (
    "kind",
    "files",
    "trials",
    "read",
    "refused",
    "other errors",
    "hangs",
    "over 1 GB",
    "crashes",
    "slowest s",
    "most MB",
)
Open = Callable[[Path], object]
T = TypeVar("T")


@dataclass(frozen=True)
class Seed:
    """A sound file: what kind it is, where it lies, what reads it, and which file is damaged if not itself."""

    kind: str
    path: Path
    read: Open
    damaged: Path

    @property
    def text(self) -> bool:
        return self.damaged.suffix.lower() in (
            ".json", ".csv", ".txt", ".points", ".pts", ".yaml", ".toml", ".hdr", ".rsc", ".xml",
            ".vrt", ".ers", ".safe", ".asc", ".sgrd",
        )  # fmt: skip


def seeds(folder: Path) -> list[Seed]:
    """Write sound files of every kind, and say how each is read."""
    from fuzz_files import results, scenes, tables

    found: list[Seed] = []
    for kind, path, read, *other in [*scenes(folder), *tables(folder), *results(folder)]:
        found.append(Seed(kind, path, read, other[0] if other else path))
    return found


def damaged(content: bytes, rng: np.random.Generator, *, text: bool) -> bytes:
    """Return a file's content after one to three random damages."""
    for _ in range(int(rng.integers(1, 4))):
        content = _text(content, rng) if text and rng.random() < 0.7 else _bytes(content, rng)
    return content


def _bytes(content: bytes, rng: np.random.Generator) -> bytes:
    if not content:
        return rng.bytes(20)
    data, n = bytearray(content), len(content)
    # Headers decide most, so half of all places lie in them.
    place = int(rng.integers(min(n, 512) if rng.random() < 0.5 else n))
    size = int(rng.integers(1, 65))
    what = int(rng.integers(9))
    if what == 0:
        for at in rng.integers(0, n, int(rng.integers(1, 9))):
            data[at] ^= 1 << int(rng.integers(8))
    elif what in (1, 2):
        width = int(rng.choice([1, 2, 4, 8]))
        field = FIELDS[int(rng.integers(len(FIELDS)))] * width if rng.random() < 0.7 else rng.bytes(width)
        place -= place % width
        data[place : place + width] = field[: max(0, n - place)]
    elif what == 3:
        del data[place:]
    elif what == 4:
        del data[place : place + size]
    elif what == 5:
        data[place:place] = rng.bytes(size)
    elif what == 6:
        data[place:place] = data[place : place + size] * int(rng.integers(1, 50))
    elif what == 7:
        other = int(rng.integers(n))
        data[place : place + size], data[other : other + size] = data[other : other + size], data[place : place + size]
    else:
        data[place : place + size] = rng.bytes(len(data[place : place + size]))
    return bytes(data)


def _text(content: bytes, rng: np.random.Generator) -> bytes:
    def some(items: Sequence[T]) -> T:
        return items[int(rng.integers(len(items)))]

    lines = content.split(b"\n")
    what = int(rng.integers(8))
    if what < 3:
        found = list(re.finditer(rb"-?\d[\d.eE+-]*|\"[^\"\n]{0,40}\"|null|true|false", content[:200_000]))
        if found:
            match = some(found)
            return content[: match.start()] + some(NUMBERS).encode() + content[match.end() :]
    if what == 3:
        del lines[int(rng.integers(len(lines)))]
    elif what == 4:
        lines.insert(int(rng.integers(len(lines))), some(lines) * int(rng.integers(1, 40)))
    elif what == 5:
        at = int(rng.integers(len(content) + 1))
        return (
            content[:at]
            + some(
                [b"[" * 100_000, b'{"a":' * 20_000, b"\x00", b"\xef\xbb\xbf", b"\xe9", b"\r", b"&a [*a]", b'"', b",,"]
            )
            + content[at:]
        )
    elif what == 6:
        words = list(re.finditer(rb"[A-Za-z_]{3,}", content[:200_000]))
        if words:
            match = some(words)
            return (
                content[: match.start()]
                + some([b"", b"x", b"../" * 9, match[0] * 2, match[0].upper()])
                + content[match.end() :]
            )
    else:
        i, j = rng.integers(0, len(lines), 2).tolist()
        lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def trial(seed: Seed, number: int, base: int, folder: Path) -> Path:
    """Write the damaged copy `number` of a seed, beside copies of what lies beside it; returns the file to read."""
    name = seed.path.name
    rng = np.random.default_rng([base, number, *name.encode()])
    shutil.copytree(seed.path.parent, folder, dirs_exist_ok=True)
    (folder / seed.damaged.name).write_bytes(damaged(seed.damaged.read_bytes(), rng, text=seed.text))
    return folder / name


def outcome(read: Open, path: Path) -> str:
    """Read a file: "read", "refused", or what else was raised."""
    try:
        read(path)
    except FeatregError as error:
        return "refused" if str(error).strip() else "FeatregError without a word"
    except MemoryError:
        return "MemoryError"
    except Exception as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
    return "read"


@dataclass(frozen=True)
class Trial:
    """What came of one damaged file: an outcome, a hang or a crash, with seconds of the processor, and memory grown."""

    seed: Seed
    number: int
    said: str
    seconds: float
    megabytes: float

    @property
    def fault(self) -> str:
        if self.said not in ("read", "refused"):
            return self.said
        if self.seconds > LONGEST_S:
            return "hang"
        return "over 1 GB" if self.megabytes > MOST_MB else ""


def watched(jobs: Sequence[tuple[Seed, int]], base: int, folder: Path) -> Iterator[Trial]:
    """Run trials in a forked process, and in another after one that hung, ended or grew it."""
    at = 0
    while at < len(jobs):
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            _work(jobs[at:], base, folder, writing)
        os.close(writing)
        with os.fdopen(reading, "rb", buffering=0) as pipe:
            while at < len(jobs):
                start = time.monotonic()
                ready = _answers(pipe, child)
                line = _line(pipe) if ready else b""
                seconds = time.monotonic() - start
                if not line:
                    yield Trial(*jobs[at], "crash" if ready else "hang", seconds, 0.0)
                    at += 1
                    break
                said, took, grown = json.loads(line)
                yield Trial(*jobs[at], said, took, grown)
                at += 1
                if grown > MOST_MB:
                    break
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def _answers(pipe: Any, child: int) -> bool:
    """Whether a process says something, or ends, before it has used twice the longest time, or waited long."""
    start, used = time.monotonic(), _used(child)
    while time.monotonic() - start < ON_THE_CLOCK * LONGEST_S and _used(child) - used < 2 * LONGEST_S:
        if select.select([pipe], [], [], LONGEST_S / 20)[0]:
            return True
    return False


def _used(process: int) -> float:
    """Seconds of the processor that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _line(pipe: Any) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        got = pipe.read(1)
        if not got:
            return b""
        line += got
    return line


def _work(jobs: Sequence[tuple[Seed, int]], base: int, folder: Path, writing: int) -> None:
    """The watched process: one line a trial, and never back into the code that forked it."""
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + SPACE, size + SPACE))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    try:
        for seed, number in jobs:
            path = trial(seed, number, base, folder)
            start = time.process_time()
            said = outcome(seed.read, path)
            seconds = time.process_time() - start
            grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before
            os.write(writing, (json.dumps([said, seconds, grown]) + "\n").encode())
    finally:
        os._exit(0)


def row(kind: str, trials: Sequence[Trial]) -> list[Any]:
    said = [trial.said for trial in trials]
    other = sum(s not in ("read", "refused", "hang", "crash") for s in said)
    faults = [trial.fault for trial in trials]
    files = len({trial.seed.damaged for trial in trials})
    counts = [said.count("read"), said.count("refused"), other]
    counts += [faults.count("hang"), faults.count("over 1 GB"), said.count("crash")]
    return [
        kind,
        files,
        len(trials),
        *counts,
        f"{max(t.seconds for t in trials):.2f}",
        f"{max(t.megabytes for t in trials):.0f}",
    ]


def main() -> None:
    from measuring import machine, table

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=300, help="of each sound file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default="", help="only these, with commas between them")
    parser.add_argument("--keep", default="", metavar="FOLDER", help="where the files of faults are kept")
    given = parser.parse_args()
    logging.getLogger("featreg").addHandler(logging.NullHandler())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sound = [s for s in seeds(folder) if not given.kinds or s.kind in given.kinds.split(",")]
        wrong = [f"{s.path.name}: {said}" for s in sound if (said := outcome(s.read, s.path)) != "read"]
        if wrong:
            sys.exit(f"a sound file is not read: {'; '.join(wrong)}")
        trials: list[Trial] = []
        for seed in sound:
            trials += watched([(seed, k) for k in range(given.trials)], given.seed, folder / "trial")
            shutil.rmtree(folder / "trial")
        faults = [t for t in trials if t.fault]
        if given.keep:
            for t in faults:
                trial(t.seed, t.number, given.seed, Path(given.keep) / f"{t.seed.damaged.name}-{t.number}")
    kinds = list(dict.fromkeys(t.seed.kind for t in trials))
    rows = [row(kind, [t for t in trials if t.seed.kind == kind]) for kind in kinds]
    print(
        f"## Damaged files\n\n{machine()}; featreg {featreg.__version__}, seed {given.seed}\n\n{table(COLUMNS, rows)}\n"
    )
    for t in faults[:40]:
        print(f"- {t.seed.kind}, {t.seed.damaged.name}, number {t.number}: {t.fault}")
    print(f"{len(faults)} faults in {len(trials)} trials\n")
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
