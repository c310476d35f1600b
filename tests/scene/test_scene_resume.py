"""Finished blocks of a scene are used again, and only those of the same work."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.results.registration import Registration
from made.scene_results import BLOCK, again, copied, undisturbed_text


def test_finished_blocks_are_reused(located_pair: Any, undisturbed: tuple[Path, Registration]) -> None:
    folder, result = undisturbed
    total = result.provenance["blocks"]["total"]
    assert len(list(folder.iterdir())) == total
    got = again(located_pair, folder)
    assert got.provenance["blocks"] | {"size": 0, "halo": 0} == {
        "total": total, "computed": 0, "reused": total, "failed": 0, "size": 0, "halo": 0,
        "skipped": result.provenance["blocks"]["skipped"],
    }  # fmt: skip
    assert undisturbed_text(got) == undisturbed_text(result)


@pytest.mark.parametrize("harm", ["missing", "cut", "emptied", "flipped", "foreign", "swapped", "stray", "old"])
def test_spoiled_files_are_found_out(
    harm: str, located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path
) -> None:
    folder, result = undisturbed
    files = copied(folder, tmp_path / "state")
    lost = 1
    victim = max(files, key=lambda f: f.stat().st_size)
    content = victim.read_bytes()
    if harm == "missing":
        victim.unlink()
    elif harm == "cut":
        victim.write_bytes(content[: len(content) // 2])
    elif harm == "emptied":
        victim.write_bytes(b"")
    elif harm == "flipped":
        # In the middle of an array, beyond what a zip's directory tells.
        k = len(content) // 3
        victim.write_bytes(content[:k] + bytes([content[k] ^ 255]) + content[k + 1 :])
    elif harm == "foreign":
        np.savez(victim, index=np.array(3))
    elif harm == "swapped":
        other = next(f for f in files if f != victim)
        victim.write_bytes(other.read_bytes())
    elif harm == "stray":
        (victim.parent / "block_9999_9999.npz").write_bytes(os.urandom(4096))
        (victim.parent / "notes.txt").write_text("mine")
        lost = 0
    else:
        # What a killed run left half written.
        (victim.parent / f".{victim.stem}_abc.tmp").write_bytes(content[:100])
        lost = 0
    got = again(located_pair, tmp_path / "state")
    assert got.provenance["blocks"]["computed"] == lost
    assert undisturbed_text(got) == undisturbed_text(result)
    assert not list((tmp_path / "state").glob(".*.tmp"))
    assert again(located_pair, tmp_path / "state").provenance["blocks"]["computed"] == 0


@pytest.mark.parametrize("change", [{"seed": 1}, {"n_features": 800}, {"threshold": 12}, {"refine": False}])
def test_another_run_uses_none_of_the_files(
    change: dict[str, Any], located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path
) -> None:
    copied(undisturbed[0], tmp_path / "state")
    change = {"detector.threshold" if k == "threshold" else k: v for k, v in change.items()}
    assert again(located_pair, tmp_path / "state", **change).provenance["blocks"]["reused"] == 0


def test_a_changed_image_uses_none_of_the_files(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path
) -> None:
    copied(undisturbed[0], tmp_path / "state")
    image = tmp_path / "reference.tif"
    image.write_bytes(located_pair.reference.read_bytes())
    got = featreg.match(image, located_pair.secondary, **BLOCK, resume=tmp_path / "state")
    assert got.provenance["blocks"]["reused"] == 0


def test_a_run_that_was_cancelled_goes_on(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path
) -> None:
    class AfterFive:
        done = 0

        def is_set(self) -> bool:
            return len(list((tmp_path / "state").glob("*.npz"))) >= 5 if (tmp_path / "state").exists() else False

    with pytest.raises(featreg.FeatregError, match="cancelled"):
        again(located_pair, tmp_path / "state", cancel=AfterFive())
    got = again(located_pair, tmp_path / "state")
    assert got.provenance["blocks"]["reused"] == 5
    assert undisturbed_text(got) == undisturbed_text(undisturbed[1])


def test_blocks_of_another_method_are_left_alone(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path
) -> None:
    copied(undisturbed[0], tmp_path / "state")
    before = {path.name: path.read_bytes() for path in (tmp_path / "state").iterdir()}
    other = featreg.match(
        located_pair.reference, located_pair.secondary, **BLOCK, method="orb", resume=tmp_path / "state"
    )
    assert other.provenance["blocks"]["reused"] == 0
    assert all((tmp_path / "state" / name).read_bytes() == content for name, content in before.items())
    assert again(located_pair, tmp_path / "state").provenance["blocks"]["computed"] == 0
