"""A scene whose files cannot be written: full disks, folders of others."""

from __future__ import annotations

import errno
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

import featreg
from featreg.results.registration import Registration
from made.scene_results import again, copied, undisturbed_text


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
    assert undisturbed_text(got) == undisturbed_text(undisturbed[1])


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
