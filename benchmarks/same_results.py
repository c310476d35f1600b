"""Whether two commits give the same bits: every method on three pairs of different kinds, whole and in blocks.

    python benchmarks/same_results.py COMMIT [COMMIT]     the second is what is checked out
    python benchmarks/same_results.py --record FOLDER     the results of the featreg that is installed

A commit is installed without its dependencies into a folder of its own, so that both run on the same libraries. What a
result's JSON says is compared key by key, times apart; a key that differs is named with the runs in which it does.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import featreg
from featreg.simulate import sar_pair
from featreg.simulate.circle import circular_phase_history, parking_lot

ROOT = Path(__file__).parents[1]
BLOCK = 260
#: Keys that differ between two runs of one commit.
NEVER_EQUAL = ("timings", "provenance.block_seconds", "provenance.versions")


def pairs() -> dict[str, tuple[Any, Any]]:
    """Two images of 4 looks, two of one look with a wedge without data, two complex apertures of a parking lot."""
    four = sar_pair((520, 540), seed=11)
    one = sar_pair((520, 540), rotation_deg=-14.0, scale=0.97, shift=(9.0, 5.0), looks=1.0, seed=12)
    wedge = one.secondary.copy()
    wedge[np.add.outer(np.arange(wedge.shape[0]), np.arange(wedge.shape[1])) < 260] = np.nan
    lot = parking_lot(seed=4)
    apertures = [featreg.back_project(circular_phase_history(lot, i, i + 2)).pixels for i in (30, 32)]
    turned = np.ascontiguousarray(np.rot90(apertures[1]))
    return {
        "four looks": (four.reference, four.secondary),
        "one look, nodata": (one.reference, wedge),
        "complex": (apertures[0], turned),
    }


def methods() -> list[str]:
    """Every preset that runs here without weights to download."""
    from featreg.presets import PRESETS

    learned = ("disk", "aliked", "xfeat", "dedode", "loftr", "hardnet", "keynet")
    return [name for name in PRESETS if not any(word in name for word in learned)]


def record(folder: Path) -> None:
    """Write the result of every run as JSON into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind, (reference, secondary) in pairs().items():
        for method in methods():
            for mode, block in (("whole", False), ("blocks", BLOCK)):
                path = folder / f"{kind}, {method}, {mode}.json"
                try:
                    made = featreg.match(
                        reference,
                        secondary,
                        method=method,
                        n_features=800,
                        seed=5,
                        block=block,
                        workers=None if block is False else 1,
                    )
                    made.to_json(path)
                except featreg.FeatregError as error:
                    path.write_text(json.dumps({"error": f"{type(error).__name__}: {error}"}))
                print(path.stem, file=sys.stderr)


def differences(before: Path, after: Path) -> tuple[int, dict[str, list[str]]]:
    """How many runs were compared, and key -> the runs in which it differs."""
    names = sorted({p.name for folder in (before, after) for p in folder.glob("*.json")})
    found: dict[str, list[str]] = defaultdict(list)
    for name in names:
        sides = [dict(_flat(_read(folder / name))) for folder in (before, after)]
        for key in sorted(set().union(*sides)):
            if not key.startswith(NEVER_EQUAL) and sides[0].get(key, "absent") != sides[1].get(key, "absent"):
                # What one side lacks as a whole is named once.
                lacking = [_lacking(key, side) for side in sides if key not in side]
                runs = found[f"{lacking[0]} (one side only)" if lacking else key]
                if name.removesuffix(".json") not in runs:
                    runs.append(name.removesuffix(".json"))
    return len(names), dict(found)


def _lacking(key: str, side: dict[str, str]) -> str:
    """The shortest beginning of a dotted key that no key of a side has."""
    parts = key.split(".")
    heads = (".".join(parts[: end + 1]) for end in range(len(parts)))
    return next(head for head in heads if not any(f"{other}.".startswith(f"{head}.") for other in side))


def _read(path: Path) -> Any:
    return json.loads(path.read_text()) if path.exists() else {"missing": True}


def _flat(value: Any, at: str = "") -> Iterator[tuple[str, str]]:
    """(dotted key, value as text) of every leaf; lists are leaves."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{at}.{key}" if at else key)
    else:
        yield at, json.dumps(value)


def installed(commit: str | None, folder: Path) -> Path:
    """A folder that holds the package of a commit, or of what is checked out."""
    tree = ROOT
    if commit is not None:
        tree = folder / "tree"
        subprocess.run(["git", "-C", str(ROOT), "worktree", "add", "--detach", str(tree), commit], check=True)
    target = folder / "package"
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--no-deps",
            "--no-build-isolation",
            "--target",
            str(target),
            str(tree),
        ],
        check=True,
    )
    return target


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commits", nargs="*", metavar="COMMIT")
    parser.add_argument("--record", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    if given.record is not None:
        record(given.record)
        return 0
    if not 1 <= len(given.commits) <= 2:
        parser.error("one or two commits are needed")
    with tempfile.TemporaryDirectory() as temporary:
        folders = []
        for side, commit in enumerate([*given.commits, None][:2]):
            work = Path(temporary) / str(side)
            work.mkdir()
            package = installed(commit, work)
            environment = {**os.environ, "PYTHONPATH": str(package)}
            command = [sys.executable, str(Path(__file__)), "--record", str(work / "results")]
            subprocess.run(command, check=True, env=environment, cwd=work)
            folders.append(work / "results")
            if commit is not None:
                subprocess.run(
                    ["git", "-C", str(ROOT), "worktree", "remove", "--force", str(work / "tree")], check=True
                )
        count, found = differences(*folders)
    print(f"{count} runs of {len(methods())} methods compared")
    for key, runs in found.items():
        print(f"{key} differs in {len(runs)}: {'; '.join(runs[:3])}{' ...' if len(runs) > 3 else ''}")
    print("every other key is the same to the last bit" if found else "the same to the last bit")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
