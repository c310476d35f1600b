"""A scene that was killed goes on where it stopped, and ends as if nothing had happened."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.results.registration import Registration
from made.scene_results import BLOCK

COMMAND = [sys.executable, "-m", "featreg", "match"]


@pytest.fixture(scope="module")
def undisturbed(located_pair: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Registration]:
    """A folder with every block file, and the result."""
    folder = tmp_path_factory.mktemp("state")
    result = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, resume=folder)
    return folder, result


def plain(result: Registration) -> str:
    """Everything that must not depend on how the work was interrupted, as text."""
    from featreg.results.json_file import registration_to_dict

    whole = registration_to_dict(result)
    provenance = {k: v for k, v in whole["provenance"].items() if k not in ("blocks", "block_seconds")}
    return json.dumps({**whole, "provenance": provenance, "blocks": None, "timings": None}, sort_keys=True)


def again(located_pair: Any, folder: Path, **keywords: Any) -> Registration:
    return featreg.match(located_pair.reference, located_pair.secondary, **{**BLOCK, **keywords}, resume=folder)


def copied(source: Path, target: Path) -> list[Path]:
    target.mkdir()
    for file in source.iterdir():
        (target / file.name).write_bytes(file.read_bytes())
    return sorted(target.iterdir())


def test_finished_blocks_are_reused(located_pair: Any, undisturbed: tuple[Path, Registration]) -> None:
    folder, result = undisturbed
    total = result.provenance["blocks"]["total"]
    assert len(list(folder.iterdir())) == total
    got = again(located_pair, folder)
    assert got.provenance["blocks"] | {"size": 0, "halo": 0} == {
        "total": total, "computed": 0, "reused": total, "failed": 0, "size": 0, "halo": 0,
        "skipped": result.provenance["blocks"]["skipped"],
    }  # fmt: skip
    assert plain(got) == plain(result)


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
    assert plain(got) == plain(result)
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
    assert plain(got) == plain(undisturbed[1])


def started(located_pair: Any, state: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    command = [*COMMAND, str(located_pair.reference), str(located_pair.secondary), "--block", "150"]
    command += ["--workers", "2", "--resume", str(state), "--json", str(out), *more]
    return subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        # A shell that runs the tests in the background has them ignore what Ctrl-C sends.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def wait_for_files(state: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + 120
    while len(list(state.glob("*.npz"))) < count and process.poll() is None and time.monotonic() < end:
        time.sleep(0.005)


@pytest.mark.slow
def test_killed_at_several_moments_it_ends_as_if_nothing_had_happened(located_pair: Any, tmp_path: Path) -> None:
    wanted = featreg.match(located_pair.reference, located_pair.secondary, block=150, workers=1)
    state, out = tmp_path / "state", tmp_path / "r.json"
    before = 0
    for count in (1, 6, 13):
        process = started(located_pair, state, out)
        wait_for_files(state, count, process)
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        assert len(list(state.glob("*.npz"))) >= before
        before = len(list(state.glob("*.npz")))
    assert before >= 13
    process = started(located_pair, state, out)
    _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said.decode()
    result = Registration.from_json(out)
    counts = result.provenance["blocks"]
    assert counts["reused"] == before
    assert counts["computed"] == counts["total"] - before
    assert result.model
    assert wanted.model
    assert np.array_equal(result.model.parameters["coefficients"], wanted.model.parameters["coefficients"])
    assert np.array_equal(result.matches.secondary_xy, wanted.matches.secondary_xy)
    assert np.array_equal(result.inliers, wanted.inliers)


@pytest.mark.slow
def test_interrupted_by_hand_it_says_how_to_go_on(located_pair: Any, tmp_path: Path) -> None:
    state, out = tmp_path / "state", tmp_path / "r.json"
    process = started(located_pair, state, out)
    wait_for_files(state, 3, process)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130, said.decode()
    assert said.decode().count("\n") == 1
    assert "--resume" in said.decode()
    assert not out.exists()
    assert len(list(state.glob("*.npz"))) >= 3


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--whole", "--block", "300"], "--whole"),
        (["--block", "60"], "block must be"),
        (["--block", "many"], "whole number"),
        (["--dem", "nowhere.tif"], "no such file"),
        (["--height", "5", "--dem", "{reference}"], "--dem and --height"),
        (["--block", "300", "--scheduler", "tcp://127.0.0.1:9"], "no dask scheduler answers"),
        (["--scheduler", "tcp://127.0.0.1:9", "--workers", "2"], "leave --workers out"),
        (["--resume", "{reference}"], "is a file"),
        (["--resume", "/nowhere/at/all"], "does not exist"),
        (["--blok", "300"], "--block"),
    ],
)
def test_the_command_refuses_what_cannot_be(
    options: list[str], text: str, located_pair: Any, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    from featreg.cli.main import main

    monkeypatch.setattr("featreg.runtime.cluster.PATIENCE", 1)
    given = [option.format(reference=located_pair.reference) for option in options]
    code = main(["match", str(located_pair.reference), str(located_pair.secondary), *given])
    said = capsys.readouterr()
    assert code == 2
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert text in said.err


def test_the_command_works_in_blocks(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from featreg.cli.main import main

    images = [str(located_pair.reference), str(located_pair.secondary)]
    options = ["--method", "sar-orb", "--block", "200", "--workers", "1", "--json", str(tmp_path / "r.json")]
    code = main(["match", *images, *options])
    assert code == 0
    assert "blocks      12" in capsys.readouterr().out
    written = json.loads((tmp_path / "r.json").read_text())
    assert written["blocks"]["total"] == 12
    assert plain(Registration.from_json(tmp_path / "r.json")) == plain(undisturbed[1])


def test_a_full_disk_is_said_and_leaves_no_half_file(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, renamed = tmp_path / "state", os.replace

    def full(source: Path, target: Path) -> None:
        if len(list(state.glob("*.npz"))) < 3:
            return renamed(source, target)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(featreg.FeatregError, match="No space left"):
        again(located_pair, state)
    assert len(list(state.iterdir())) == 3
    monkeypatch.undo()
    got = again(located_pair, state)
    assert got.provenance["blocks"]["reused"] == 3
    assert plain(got) == plain(undisturbed[1])


def test_two_runs_on_one_folder_at_once_disturb_each_other_in_nothing(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path
) -> None:
    state = tmp_path / "state"
    command = [*COMMAND, str(located_pair.reference), str(located_pair.secondary), "--block", "200", "--workers", "1"]
    command += ["--method", "sar-orb", "--resume", str(state)]
    running = [
        subprocess.Popen(
            [*command, "--json", str(tmp_path / f"{k}.json")], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        for k in range(2)
    ]
    for k, process in enumerate(running):
        _, said = process.communicate(timeout=300)
        assert process.returncode == 0, said.decode()
        assert said == b""
        assert plain(Registration.from_json(tmp_path / f"{k}.json")) == plain(undisturbed[1])
    total = undisturbed[1].provenance["blocks"]["total"]
    assert len(list(state.iterdir())) == total
    assert again(located_pair, state).provenance["blocks"]["reused"] == total


@pytest.mark.parametrize("which", ["folder", "parent", "file"])
def test_a_folder_that_cannot_be_written_is_said_before_the_work(
    which: str, located_pair: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from featreg.cli.main import main

    state = tmp_path / "state"
    if which == "file":
        state.write_text("mine")
    else:
        made, allowed, place = Path.mkdir, os.access, state if which == "folder" else tmp_path

        # The superuser may write anywhere, so the system's answers are put in its mouth.
        def mkdir(path: Path, *args: Any, **keywords: Any) -> None:
            if which == "parent" and path == state:
                raise PermissionError(errno.EROFS, os.strerror(errno.EROFS))
            made(path, *args, **keywords)

        def access(path: Any, mode: int, **keywords: Any) -> bool:
            return not (Path(path) == place and mode & os.W_OK) and allowed(path, mode, **keywords)

        monkeypatch.setattr(Path, "mkdir", mkdir)
        monkeypatch.setattr(os, "access", access)
    monkeypatch.setattr("featreg.scene.run.run_block", None)  # no block may be worked on
    images = [str(located_pair.reference), str(located_pair.secondary)]
    assert main(["match", *images, "--block", "200", "--workers", "1", "--resume", str(state)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(state) in said
    assert re.search("may not be written to|Read-only file system|is a file", said)


def test_a_disk_that_is_full_for_real(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file system of a few kilobytes, or, where none can be made, the device that is always full."""
    from featreg.cli.main import main

    small, state = tmp_path / "small", tmp_path / "state"
    small.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=160k", "tmpfs", str(small)], capture_output=True, check=False
    )
    images = [str(located_pair.reference), str(located_pair.secondary)]
    try:
        if made.returncode == 0:
            state = small / "state"
            assert main(["match", *images, "--block", "200", "--workers", "1", "--resume", str(state)]) == 2
            assert "No space left on device" in capsys.readouterr().err
            assert not list(state.glob(".*.tmp"))
            whole = copied(state, tmp_path / "kept")
            assert again(located_pair, tmp_path / "kept").provenance["blocks"]["reused"] == len(whole)
        if Path("/dev/full").exists():
            command = ["match", *images, "--block", "200", "--workers", "1", "--resume", str(undisturbed[0])]
            assert main([*command, "--json", "/dev/full"]) == 2
            said = capsys.readouterr().err
            assert said.count("\n") == 1
            assert "No space left on device" in said
    finally:
        if made.returncode == 0:
            subprocess.run(["umount", str(small)], check=True)


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


def test_the_picture_of_a_large_scene_is_made_from_overviews(
    located_pair: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import cv2

    from featreg.cli.main import main

    command = ["match", str(located_pair.reference), str(located_pair.secondary), "--block", "200", "--workers", "1"]
    assert main([*command, "--plot", str(tmp_path / "whole.png")]) == 0
    monkeypatch.setattr("featreg.matching.MOST_PIXELS", 100_000)
    monkeypatch.setattr("featreg.cli.block_options.DRAWN", 400)
    for place in ("featreg.io", "featreg.io.images"):
        monkeypatch.setattr(f"{place}.as_image", None)
    assert main([*command, "--plot", str(tmp_path / "reduced.png")]) == 0
    whole, reduced = (cv2.imread(str(tmp_path / name), cv2.IMREAD_GRAYSCALE) for name in ("whole.png", "reduced.png"))
    assert whole is not None
    assert reduced is not None
    # The panels hold the same ground at the same places, and the tie points lie on it.
    size = (400, 400)
    a, b = (cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(float) for picture in (whole, reduced))
    assert np.corrcoef(a[40:].ravel(), b[40:].ravel())[0, 1] > 0.9
