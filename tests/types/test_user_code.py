"""Code that a user writes after the pages passes a strict type checker."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/plugins.md", "docs/methods.md", "docs/rotation.md")


def python_of(page: str) -> str:
    """The blocks of Python of a page as one module; of a session what stands behind the prompts."""
    lines: list[str] = []
    for block in re.findall(r"^```python\n(.*?)^```", page, re.M | re.S):
        session = block.startswith(">>> ")
        lines += [line[4:] for line in block.splitlines() if line[:4] in (">>> ", "... ")] if session else [block]
    return "\n".join(lines) + "\n"


def test_lines_behind_prompts_and_whole_blocks_are_code() -> None:
    page = "```python\n>>> a = [1,\n... 2]\n>>> a\n[1, 2]\n```\ntext\n```shell\n$ ls\n```\n```python\nb = 1\n```\n"
    assert python_of(page) == "a = [1,\n2]\na\nb = 1\n\n"


@pytest.mark.slow
@pytest.mark.xdist_group("mypy")
def test_the_code_of_pages_passes_mypy_strict(tmp_path: Path) -> None:
    files = []
    for page in PAGES:
        files.append(tmp_path / f"page_{Path(page).stem}.py")
        files[-1].write_text(python_of((ROOT / page).read_text(encoding="utf-8")), encoding="utf-8")
    # The settings, and so the cache, are those of the whole project, which `make lint` has filled.
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *map(str, files)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
