"""Plugins of other packages: found by entry point, and hidden alone where they break."""

from __future__ import annotations

import importlib
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from featreg import registry
from featreg.errors import (
    DuplicatePluginError,
    UnknownNameError,
)
from made.plugins import Nothing


def test_a_module_that_cannot_be_imported_hides_only_itself(scratch: Any) -> None:
    def broken() -> None:
        raise ImportError("no module named 'dreams'")

    registry._import("plugins.dreams", broken)
    assert "dreams" in registry.broken()["plugins.dreams"]
    assert "sar-ofast" in registry.available("detector")
    with pytest.raises(UnknownNameError, match=r"plugins\.dreams could not be imported"):
        registry.create("detector", "dreams-detector")


def test_a_foreign_plugin_that_breaks_the_rules_hides_only_itself(scratch: Any) -> None:
    def load() -> None:
        class Careless(Nothing):
            def __init__(self, count: int) -> None: ...

        registry.register("careless")(Careless)

    registry._import("foreign.careless", load)
    assert "count" in registry.broken()["foreign.careless"]


PLUGIN = '''
from featreg.interfaces import Detector
from featreg.registry import register
from featreg.types import Features

@register("{name}")
class Found(Detector):
    """Of a package."""
    def detect_features(self, image):
        return Features.empty()
'''


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path; its modules, called outside_..., are forgotten afterwards."""
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("outside_")]:
        del sys.modules[name]


def load(name: str) -> None:
    registry._import(name, lambda: importlib.import_module(name))


def test_an_entry_point_of_a_name_that_is_taken_hides_only_itself(scratch: Any, modules: Path) -> None:
    (modules / "outside_twice.py").write_text(PLUGIN.format(name="sar-ofast"))
    load("outside_twice")
    reason = registry.broken()["outside_twice"]
    assert "two plugins are called detector 'sar-ofast': featreg.detectors.sar_ofast and outside_twice" in reason
    assert registry.entry("detector", "sar-ofast").module == "featreg.detectors.sar_ofast"
    assert registry.create("detector", "sar-ofast")
    with pytest.raises(UnknownNameError, match="outside_twice could not be imported"):
        registry.create("detector", "no-such-thing")


def test_a_name_of_ours_that_the_caller_took_is_the_caller_s_mistake(scratch: Any) -> None:
    class Mine(Nothing):
        """Mine."""

    def again() -> None:
        registry.register("sar-ofast")(Mine)

    with pytest.raises(DuplicatePluginError, match=r"featreg\.detectors\.sar_ofast"):
        registry._import("featreg.detectors.sar_ofast", again, ours=True)
    assert not registry.broken()


def test_a_module_that_fails_after_it_registered_is_all_or_nothing(scratch: Any, modules: Path) -> None:
    (modules / "outside_good.py").write_text(PLUGIN.format(name="stands-alone"))
    (modules / "outside_late.py").write_text(f"import outside_good\n{PLUGIN.format(name='too-early')}\n1 / 0\n")
    (modules / "outside_quits.py").write_text(f"{PLUGIN.format(name='quitter')}\nraise SystemExit(1)\n")
    load("outside_late")
    load("outside_quits")
    load("outside_good")
    names = registry.available("detector")
    assert not {"too-early", "quitter"} & set(names)
    assert "stands-alone" in names  # it was imported whole, by a module that failed later
    assert "division by zero" in registry.broken()["outside_late"]
    assert "SystemExit" in registry.broken()["outside_quits"]


def test_entry_points_of_other_packages_are_found(tmp_path: Path) -> None:
    """A real package on the path, looked up in a fresh interpreter."""
    import subprocess

    (tmp_path / "outside_plugins.py").write_text(
        textwrap.dedent(
            """
            from featreg.interfaces import Detector
            from featreg.registry import register
            from featreg.types import Features

            @register("outside")
            class Outside(Detector):
                '''From another package.'''
                def __init__(self, count: int = 1) -> None:
                    self.count = count
                def detect_features(self, image):
                    return Features.empty()
            """
        )
    )
    info = tmp_path / "outside-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[featreg.plugins]\noutside = outside_plugins\nmissing = no_such_module_at_all\n"
    )
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import featreg; from featreg import registry\n"
        "assert 'outside' in featreg.available('detector'), featreg.available('detector')\n"
        "assert featreg.create('detector', 'outside', count=4).count == 4\n"
        "assert 'no_such_module_at_all' in str(registry.broken()), registry.broken()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
