"""`featreg list`: a line a name, what one takes, the nearest name; and readers that leave early, of any command."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from featreg import registry
from featreg.cli import listing
from featreg.cli.listed import KINDS
from featreg.cli.main import main
from featreg.presets import PRESETS

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command where nothing says how wide the terminal is; return exit code, stdout, stderr."""
    monkeypatch.delenv("COLUMNS", raising=False)

    def call(*arguments: str) -> tuple[int, str, str]:
        code = main(arguments)
        return code, *capsys.readouterr()

    return call


def test_list_is_one_line_a_name_by_kind(run: Run) -> None:
    code, out, err = run("list")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert [line for line in lines if not line.startswith(" ")][:7] == list(KINDS)
    names = [(kind, e.name, e.summary) for kind in registry.KINDS for e in registry.entries(kind)]
    names += [("method", name, preset.summary) for name, preset in PRESETS.items()]
    assert len(lines) == len(KINDS) + len(names)
    assert all(
        re.search(rf"^  {name} +{re.escape(summary.rstrip('.'))}", out, re.MULTILINE) for _, name, summary in names
    )
    assert len(run("list", "method")[1].splitlines()) == 1 + len(PRESETS) < 90


def test_list_says_why_a_name_cannot_be_used(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = registry.entry("detector", "sar-ofast")
    monkeypatch.setitem(registry._entries, ("detector", "sar-ofast"), replace(entry, unavailable="needs x; install x"))
    assert "position; unavailable: needs x; install x\n" in run("list", "detector")[1]
    assert re.search(
        r"  sar-orb +.*FSC; unavailable: detector sar-ofast: needs x; install x\n", run("list", "method")[1]
    )
    assert "    unavailable: needs x; install x\n" in run("list", "sar-ofast")[1]


def test_list_of_a_name_shows_defaults_ranges_and_meanings(run: Run) -> None:
    code, out, err = run("list", "sar-ofast")
    assert (code, err) == (0, "")
    assert out.startswith("detector\n  sar-ofast\n    FAST corners")
    assert (
        "    levels = 8 (a whole number of at least 1)\n    factor = 1.2 (a number above 1 and finite)\n        pyramid"
        in out
    )
    assert "    edge = log ('log' or 'eq5')\n" in out
    assert "    threshold = 3.0 (a number above 0 and finite)\n" in run("list", "filter", "--verbose")[1]


def test_list_of_a_name_of_several_kinds_shows_all(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    assert re.findall(r"^\w+$", run("list", "orb")[1], re.MULTILINE) == ["detector", "descriptor", "method"]
    entry = registry.entry("filter", "fsc")
    monkeypatch.setitem(registry._entries, ("filter", "model"), replace(entry, name="model"))
    out = run("list", "model")[1]
    assert "  affine  " in out
    assert "filter\n  model\n" in out


def test_list_of_a_method_shows_its_parts(run: Run) -> None:
    out = run("list", "rc-obcls")[1]
    parts = re.findall(r"^    (\w+(?:: [\w-]+)?)$", out, re.MULTILINE)
    assert parts == ["matcher: target-centroids", "filter: mad", "trust"]
    assert "      tie_points = rc ('c', 'cc' or 'rc')\n" in out
    assert "      start = consensus ('all' or 'consensus')\n" in out  # the preset's, not the plugin's own
    assert "      half = 24 (a whole number of at least 4)\n" in run("list", "sar-orb")[1]


def test_list_wraps_at_the_width_of_the_terminal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    for arguments in (["method"], ["rc-obcls"], ["--verbose"]):
        lines = run("list", *arguments)[1].splitlines()
        assert all(len(line) <= 60 for line in lines if " " in line.strip().removeprefix("unavailable: "))


def test_list_as_json(run: Run) -> None:
    code, out, _ = run("list", "--json")
    items = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert code == 0
    assert {item["kind"] for item in items} >= {"detector", "descriptor", "nearest", "filter", "model", "method"}
    assert all(item["available"] == (not item["unavailable"]) for item in items)
    fsc = next(item for item in json.loads(run("list", "filter", "--json")[1]) if item["name"] == "fsc")
    assert fsc["parameters"]["threshold"] == 3.0
    assert fsc["range"]["threshold"] == {"gt": 0, "finite": True}
    assert fsc["meaning"]["iterations"] == "most hypotheses"
    assert fsc["summary"]
    (method,) = json.loads(run("list", "rc-obcls", "--json")[1])
    assert method["parameters"]["matcher"]["name"] == "target-centroids"
    assert method["choices"]["matcher.tie_points"] == ["c", "cc", "rc"]
    assert method["range"]["matcher.median"] == {"ge": 1, "odd": True}


def test_an_unknown_name_is_told_the_nearest_of_all_kinds(run: Run) -> None:
    for given, words in (
        ("methd", "error: unknown kind or name 'methd', did you mean 'method'"),
        ("sar-ofats", "'sar-ofast'"),
        ("quite-unlike", "known: descriptor, detector, filter"),
    ):
        code, out, err = run("list", given)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err


def test_list_starts_quickly_and_without_the_compiler() -> None:
    code = """
import sys
from featreg.cli.main import main
for name in ([], ["method"], ["sar-ofast"], ["rc-obcls"], ["--json"]):
    main(["list", *name])
sys.exit(str({"numba", "scipy", "rasterio", "torch", "matplotlib", "pandas"} & set(sys.modules) or "") or 0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_hidden_plugins_are_listed_with_the_reason(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry._broken, "featreg.detectors.odd", "ImportError: no odd")
    assert "featreg.detectors.odd: ImportError: no odd" in run("list", "nearest")[1]
    hidden = [item for item in json.loads(run("list", "nearest", "--json")[1]) if item["kind"] is None]
    assert [(item["name"], item["unavailable"]) for item in hidden] == [
        ("featreg.detectors.odd", "ImportError: no odd")
    ]
    assert "ImportError: no odd" in run("doctor")[1]


@pytest.mark.parametrize("arguments", [["list"], ["list", "--json"], ["doctor"], ["match", "--help"], ["nonsense"]])
def test_a_reader_that_leaves_changes_nothing(arguments: list[str]) -> None:
    """As of `| head -1`: the exit code is that of the work, and nobody hears of it."""
    command = [sys.executable, "-m", "featreg", *arguments]
    whole = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == whole.stderr
    assert process.returncode == whole.returncode


def test_a_broken_connection_is_still_an_error(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*arguments: Any) -> None:
        raise BrokenPipeError(32, "connection lost")

    monkeypatch.setattr(listing, "_items", lost)
    code, _, err = run("list")
    assert code == 1
    assert "BrokenPipeError" in err
