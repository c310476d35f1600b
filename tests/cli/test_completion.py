"""Completion in real shells: what bash, zsh and fish offer for a line, names of plugins and parameters included."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BIN = Path(sys.executable).parent
BASH = """
eval "$(_FEATREG_COMPLETE=source_bash featreg)"
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
_featreg_completion featreg
printf '%s\\n' "${COMPREPLY[@]}"
"""
#: What compinit defines, so far as the script of the completion asks for it.
ZSH = """
compdef() { : }
_arguments() { print -r -- "$@" }
_files() { print FILES }
eval "$(_FEATREG_COMPLETE=source_zsh featreg)"
words=("$@"); CURRENT=$#
_featreg_completion
"""
FISH = """
_FEATREG_COMPLETE=source_fish featreg | source
complete -C "$argv[1]"
"""


def offered(shell: str, script: str, *words: str) -> list[str]:
    found = shutil.which(shell)
    if found is None:
        pytest.skip(f"{shell} is not installed")
    quiet = {"bash": ["--norc", "--noprofile"], "zsh": ["-f"], "fish": ["--no-config"]}[shell]
    separator = [] if shell == "fish" else [shell]
    done = subprocess.run(
        [found, *quiet, "-c", script, *separator, *words],
        env={**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["ma"], {"match", "mark"}),
        (["match", "a", "b", "--see"], {"--seed"}),
        # Bash parts words at "=" and wants what follows it.
        (["match", "a", "b", "--set", "detector", "=", "sar-of"], {"sar-ofast"}),
        (["match", "a", "b", "--method", "rc-obcls", "--set", "matcher.tie_points", "="], {"c", "cc", "rc"}),
        (["compare", "a", "b", "--methods", "orb,sar-sift-"], {"orb,sar-sift-paper"}),
    ],
)
def test_bash(words: list[str], wanted: set[str]) -> None:
    assert set(offered("bash", BASH, "featreg", *words)) == wanted


def test_zsh_says_what_the_names_mean() -> None:
    (line,) = offered("zsh", ZSH, "featreg", "match", "a", "b", "--set", "detector=sar-of")
    assert '"detector=sar-ofast":"FAST corners' in line
    assert offered("zsh", ZSH, "featreg", "warp", "res") == ["FILES"]


def test_fish_says_what_the_names_mean() -> None:
    found = dict(line.partition("\t")[::2] for line in offered("fish", FISH, "featreg match a b --method sar-orb"))
    assert found.keys() == {"sar-orb", "sar-orb-paper"}
    assert found["sar-orb-paper"].startswith("SAR-OFAST, oriented BRIEF")


def test_every_completer_offers_names_that_the_command_takes() -> None:
    from featreg.cli import completion
    from featreg.exports.formats import FORMATS
    from featreg.focusing import METHODS
    from featreg.registry import available
    from featreg.study.metrics import METRICS

    assert {name for name, _ in completion.methods("")} == set(available("method"))
    assert {name for name, _ in completion.models("")} == set(available("model"))
    assert {name for name, _ in completion.focus_methods("")} == set(METHODS)
    assert {name for name, _ in completion.metrics("")} == set(METRICS)
    assert [name for name, _ in completion.metrics("+nm,pre")] == ["+nm,precision"]
    assert {name for name, _ in completion.words(*FORMATS)("")} == set(FORMATS)
    assert "recall" in {name for name, _ in completion.metrics("r")}
