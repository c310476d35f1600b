"""What README and docs/ show is run: every block of Python, and every shell line that starts with `$ featreg`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
#: Pages whose commands match and compare for more than a few seconds.
SLOW = ("README.md", "comparisons.md")

# What a page's script needs beside its own blocks.
HELPERS = """\
import doctest
import subprocess


def shell(command):
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert done.returncode == 0, f"$ {command}\\nexit code {done.returncode}\\n{done.stdout}{done.stderr}"


def session(text, line, names):
    test = doctest.DocTestParser().get_doctest(text, names, "session", None, line)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    runner.run(test, clear_globs=False)
    names.update(test.globs)
    assert runner.summarize().failed == 0
"""


def script(text: str) -> str:
    """Return a page as one Python script whose lines keep their numbers: text is left out, shell lines are called.

    A block of `>>>` lines must print what stands under them (`...` for any text); other Python must run.
    """
    lines = text.splitlines()
    out = [""] * (len(lines) + 1)
    out[0] = "from _helpers import session, shell"
    start, language = 0, ""
    for number, line in enumerate(lines):
        fence = re.match(r"```+\s*(\w*)", line)
        if fence and not start:
            start, language = number + 1, fence[1] or "text"
        elif fence:
            _fill(out, lines, start, number, language)
            start = 0
    assert not start, f"line {start}: this block does not end"
    return "\n".join(out) + "\n"


def _fill(out: list[str], lines: list[str], start: int, stop: int, language: str) -> None:
    block = lines[start:stop]
    if block and block[0].startswith(">>>"):
        out[start] = f"session({chr(10).join(block)!r}, {start}, globals())"
    elif language == "python":
        assert start > 0, "the first line of a page is its title"
        out[start:stop] = block
    else:
        for number, line in enumerate(block):
            if line.startswith("$ featreg"):
                command = line[2:]
                for more in block[number + 1 :]:
                    if not command.endswith("\\"):
                        break
                    command = command[:-1] + more
                out[start + number] = f"shell({command!r})"


@pytest.mark.parametrize(
    "page", [pytest.param(p, id=p.name, marks=pytest.mark.slow if p.name in SLOW else ()) for p in PAGES]
)
def test_what_the_page_shows_works(page: Path, tmp_path: Path) -> None:
    (tmp_path / "_helpers.py").write_text(HELPERS, encoding="utf-8")
    (tmp_path / page.with_suffix(".py").name).write_text(script(page.read_text(encoding="utf-8")), encoding="utf-8")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    done = subprocess.run(
        [sys.executable, page.with_suffix(".py").name],
        cwd=tmp_path,
        env={**os.environ, "PATH": path, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{page.name}\n{done.stdout}{done.stderr}"


def test_blocks_keep_their_line_numbers_and_shell_lines_are_called() -> None:
    page = (
        "# Title\n\n```python\nx = 1\n```\n\n```console\n$ featreg list \\\n    detector\nsar-ofast\n$ rm -rf /\n```\n"
    )
    assert script(page).splitlines() == [
        "from _helpers import session, shell",
        *["", ""],
        "x = 1",
        *["", "", ""],
        "shell('featreg list     detector')",
        *[""] * 5,
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_within_the_repository_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert missing == []
