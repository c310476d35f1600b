"""What a person sees in a terminal: aligned tables with colours, one line a name, a clean line after Ctrl-C."""

from __future__ import annotations

import os
import re
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from featreg.simulate import sar_pair
from featreg.study.table import Table

pty = pytest.importorskip("pty", reason="no pseudo-terminals here")

COLOUR = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def in_terminal(folder: Path, *arguments: str, interrupt_at: str | None = None, **environment: str) -> tuple[int, str]:
    """(exit code, what was shown) of a command in a terminal of 90 columns; Ctrl-C when it has shown a text."""
    child, master = pty.fork()
    if child == 0:
        try:
            os.chdir(folder)
            # A shell that runs the tests in the background has them ignore what Ctrl-C sends.
            with suppress(ValueError):
                signal.signal(signal.SIGINT, signal.SIG_DFL)
            variables = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "COLUMNS")}
            variables |= {"TERM": "xterm-256color", "COLUMNS": "90", **environment}
            os.execve(sys.executable, [sys.executable, "-m", "featreg", *arguments], variables)
        finally:
            os._exit(127)
    shown, sent, end = b"", False, time.monotonic() + 120
    while time.monotonic() < end:
        if not select.select([master], [], [], 1)[0]:
            continue
        try:
            part = os.read(master, 65536)
        except OSError:
            break
        if not part:
            break
        shown += part
        if interrupt_at is not None and not sent and interrupt_at.encode() in shown:
            os.write(master, b"\x03")
            sent = True
    else:
        os.kill(child, signal.SIGKILL)
    os.close(master)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), shown.decode().replace("\r\n", "\n")


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pairs of images, of which the second shows two places."""
    home = tmp_path_factory.mktemp("pairs")
    pair, other = (sar_pair((160, 160), rotation_deg=2.0, scale=1.0, shift=(3.0, -2.0), seed=s) for s in (1, 2))
    for name, image in (("a_1", pair.reference), ("a_2", pair.secondary), ("b_1", pair.reference)):
        np.save(home / f"{name}.npy", image)
    np.save(home / "b_2.npy", other.secondary)
    return home


def test_a_comparison_is_aligned_and_coloured_and_plain_without_colours(pairs: Path, tmp_path: Path) -> None:
    command = ["compare", str(pairs), "--methods", "orb,akaze", "--no-refine", "--no-times", "--no-isolate"]
    command += ["--resume", str(tmp_path / "kept"), "--truth", "identity"]
    code, coloured = in_terminal(tmp_path, *command)
    assert code == 0
    assert "\x1b[1mMethod\x1b[0m" in coloured
    assert re.search(r"\x1b\[33munreliable \(1\)\x1b\[0m", coloured)
    code, plain = in_terminal(tmp_path, *command, NO_COLOR="1")
    table = plain[plain.index("Method") :]
    assert not COLOUR.search(table)
    lines = table.splitlines()
    assert all(len(line) <= 90 for line in lines)
    assert table == COLOUR.sub("", coloured[coloured.index("\x1b[1mMethod") :])
    rows = [line for line in lines if line.startswith(("orb ", "akaze "))]
    assert len({line.index("ok") for line in rows if " ok" in line and "/" not in line}) == 1
    assert any(re.match(r"\(1\) (orb|akaze): ", line) for line in lines)


def table_of(count: int) -> Table:
    rows = [
        {"pair": f"pair {p}", "method": method, "status": "ok", "ncm": 10 + p + 5 * k, "rmse": 0.5 + 0.25 * k,
         "precision": 0.5, "reason": ""}
        for p in range(count)
        for k, method in enumerate(("first", "second"))
    ]  # fmt: skip
    rows[1] |= {"status": "unreliable", "reason": "too few tie points"}
    return Table(rows, ["seed 0"])


def test_text_of_a_table_says_what_markdown_says() -> None:
    table = table_of(6)
    text, marked = table.to_text(width=100), table.to_markdown()
    assert "unreliable (1)" in text
    assert "(1) second: too few tie points" in text
    assert "n = 6 pairs; studentised bootstrap" in text
    numbers = re.findall(r"\d+\.\d+ \[[^]]+\]", marked)
    assert numbers
    assert all(number in text for number in numbers)
    assert "n = 2 pairs: too few for an interval" in table_of(2).to_text()


def test_a_table_too_wide_for_the_terminal_goes_on_below() -> None:
    narrow = table_of(2).to_text(width=40).splitlines()
    assert max(map(len, narrow)) <= 44  # words of the protocol are not broken
    assert [line.split() for line in narrow if line.startswith("Method")] == [
        ["Method", "Status", "NCM", "RMSE"],
        ["Method", "Status", "Precision"],
    ]


def test_best_values_are_marked_among_the_trusted() -> None:
    styled = [part for line in table_of(2).styled_lines(None, 100) for part in line]
    best = [text for text, style in styled if style == "bold green"]
    assert "15" not in best  # of the refused one
    assert "16" in best


def test_names_are_one_line_each_in_a_terminal(tmp_path: Path) -> None:
    from featreg.presets import PRESETS

    code, shown = in_terminal(tmp_path, "list", "method")
    lines = COLOUR.sub("", shown).splitlines()
    assert (code, len(lines)) == (0, 1 + len(PRESETS))
    assert max(map(len, lines)) <= 90


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "at", "said"),
    [
        (["match", ".", "--method", "orb"], "[1/2]", "interrupted; the finished pairs are kept in '.'"),
        (["compare", ".", "--methods", "orb,akaze", "--resume", "kept"], "comparing", "--resume 'kept' goes on"),
        (["offsets", "a_1.npy", "a_2.npy", "--block", "64", "-o", "o.tif"], "blocks", "interrupted\n"),
        (["simulate", "scene", "-o", "made", "--size", "1024"], "painting", "interrupted\n"),
    ],
)
def test_ctrl_c_leaves_a_clean_line(pairs: Path, tmp_path: Path, arguments: list[str], at: str, said: str) -> None:
    for image in pairs.glob("*.npy"):
        (tmp_path / image.name).write_bytes(image.read_bytes())
    code, shown = in_terminal(tmp_path, *arguments, interrupt_at=at)
    assert code == 130
    last = COLOUR.sub("", shown[shown.index("^C") :])
    assert said in last
    assert re.search(r"^interrupted", last, re.MULTILINE)
    assert "Traceback" not in shown
    assert not list(tmp_path.glob(".*"))
