"""Files that appear whole or not at all, whatever stands where they are to appear."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from featreg.cli.checking import check_output
from featreg.errors import InputError
from featreg.io.writers import replacing, write_geotiff
from featreg.results.json_file import write_registration
from featreg.runtime.files import check_ending, folder_of, is_stream, write_atomic

CONTENT = b"new" * 100_000


def by_path(path: Path) -> None:
    with replacing(path) as temporary:
        temporary.write_bytes(CONTENT)


def by_content(path: Path) -> None:
    write_atomic(path, CONTENT)


def unsynced(path: Path) -> None:
    write_atomic(path, memoryview(CONTENT), sync=False)


Write = Callable[[Path], None]
ways = pytest.mark.parametrize("write", [by_path, by_content, unsynced])


@ways
def test_the_target_of_a_link_is_replaced_not_the_link(write: Write, tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    target, link, chain = tmp_path / "far" / "target", tmp_path / "link", tmp_path / "chain"
    link.symlink_to("far/target")
    chain.symlink_to(link)
    for old in (None, b"old"):  # without a target yet, and with one
        if old is not None:
            target.write_bytes(old)
        write(chain)
        assert chain.is_symlink()
        assert link.is_symlink()
        assert not target.is_symlink()
        assert target.read_bytes() == CONTENT
        target.unlink()
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["chain", "far", "link"]


@ways
def test_what_is_replaced_keeps_its_permissions(write: Write, tmp_path: Path) -> None:
    path = tmp_path / "a"
    before = os.umask(0o027)
    try:
        write(path)
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
        for mode in (0o600, 0o664, 0o755):
            path.chmod(mode)
            write(path)
            assert stat.S_IMODE(path.stat().st_mode) == mode
    finally:
        os.umask(before)
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        os.chown(path, 12345, 54321)
        write(path)
        assert (path.stat().st_uid, path.stat().st_gid) == (12345, 54321)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@ways
def test_a_pipe_is_written_into(write: Write, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    link = tmp_path / "link"
    link.symlink_to(pipe)
    for path in (pipe, link):
        read: list[bytes] = []
        reader = threading.Thread(target=lambda read=read: read.append(pipe.read_bytes()), daemon=True)
        reader.start()
        write(path)
        reader.join(20)
        assert read == [CONTENT]
    assert stat.S_ISFIFO(pipe.lstat().st_mode)
    assert link.is_symlink()
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="this system has no /dev")
@ways
def test_a_device_is_written_into(write: Write) -> None:
    write(Path("/dev/null"))
    assert stat.S_ISCHR(os.lstat("/dev/null").st_mode)
    with pytest.raises(InputError, match=r"/dev/full.*No space left"):
        write(Path("/dev/full"))


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="this system has no /dev")
@pytest.mark.parametrize("piped", [True, False])
def test_standard_output_is_written_into(piped: bool, tmp_path: Path) -> None:
    """Also where it goes to a file, of which the shell and others hold the old one."""
    code = "from featreg.runtime.files import write_atomic\nprint('before', flush=True)\n"
    code += "write_atomic('/dev/stdout', b'content\\n')\nprint('after', flush=True)"
    right = b"before\ncontent\nafter\n"
    if piped:
        assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True).stdout == right
        return
    with open(tmp_path / "out", "ab") as out:
        subprocess.run([sys.executable, "-c", code], stdout=out, check=True)
    assert (tmp_path / "out").read_bytes() == right


def test_what_is_a_stream(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "lost").symlink_to("nowhere")
    for name in ("", "file", "link", "lost", "nothing"):
        assert not is_stream(tmp_path / name)


def test_a_command_looks_at_the_folder_that_is_written(tmp_path: Path) -> None:
    """That of a link's target; none for what is written into."""
    (tmp_path / "link").symlink_to("missing/target")
    assert folder_of(tmp_path / "link") == (tmp_path / "missing").resolve()
    assert folder_of("a/b") == Path("a")
    with pytest.raises(InputError, match="missing' does not exist"):
        check_output(str(tmp_path / "link"), "--json")
    if Path("/dev/null").exists():
        check_output("/dev/null", "--json")


@ways
def test_a_failure_leaves_the_old_file_and_names_the_path_given(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "target").write_bytes(b"old")
    (tmp_path / "link").symlink_to("target")

    def full(source: object, target: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match=r"link\b.*No space left"):
        write(tmp_path / "link")
    assert (tmp_path / "target").read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 2
    for wrong in (tmp_path / "no" / "a", tmp_path / "target" / "a", tmp_path):
        with pytest.raises(InputError, match=str(wrong)):
            write(wrong)
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="loop"):
        write(tmp_path / "loop")


def test_a_picture_through_a_link(tmp_path: Path) -> None:
    """GDAL chooses the form by the name the user gave."""
    (tmp_path / "a.tif").symlink_to("data")
    write_geotiff(tmp_path / "a.tif", np.ones((20, 20), np.uint8))
    assert (tmp_path / "a.tif").is_symlink()
    assert (tmp_path / "data").read_bytes()[:4] in (b"II*\0", b"MM\0*")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_large_result_into_a_pipe_holds_its_tie_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import json

    import featreg

    xy = np.random.default_rng(0).uniform(0, 100, (40, 2))
    result = featreg.fit(np.hstack([xy, xy + 1.0]), model="translation", filters=[])
    monkeypatch.setattr("featreg.results.json_file.MAX_ROWS", 30)
    os.mkfifo(tmp_path / "pipe")
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append((tmp_path / "pipe").read_text()), daemon=True)
    reader.start()
    write_registration(result, tmp_path / "pipe")
    reader.join(20)
    assert len(json.loads(read[0])["tie_points"]["rows"]) == len(result.matches) > 30
    assert [p.name for p in tmp_path.iterdir()] == ["pipe"]


@pytest.mark.parametrize(
    ("name", "endings", "refused"),
    [
        ("a.json", (".json",), False),
        ("a.TIF", (".tif", ".tiff"), False),
        ("a.result", (".json",), False),
        ("a", (".json",), False),
        ("a.tif", (".json",), True),
        ("a.CSV", (".json",), True),
        ("a.nc", (".tif", ".tiff"), True),
    ],
)
def test_a_name_that_says_another_kind_of_file_is_refused(name: str, endings: tuple[str, ...], refused: bool) -> None:
    if not refused:
        check_ending(name, *endings)
        return
    with pytest.raises(
        InputError, match=rf"'{name}' would be no {Path(name).suffix.lower()} file; give a name that ends"
    ):
        check_ending(name, *endings)
