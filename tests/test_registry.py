"""The registry: kinds, names, parameters, errors that suggest, entry points, broken plugins."""

from __future__ import annotations

import importlib
import re
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from annotated_types import Interval

from featreg import registry
from featreg.errors import (
    DuplicatePluginError,
    FeatregError,
    ParameterError,
    PluginError,
    PluginUnavailableError,
    UnknownNameError,
)
from featreg.interfaces import Detector, Filter, FilterContext, Matcher
from featreg.pipeline.assembly import assemble
from featreg.runtime.parameters import Parameter
from featreg.types import BoolArray, Features, Image, Matches

NAMES = {
    "detector": {"sar-ofast", "orb", "sift", "akaze", "fast"},
    "descriptor": {"brief", "orb", "sift"},
    "nearest": {"brute-force"},
    "filter": {"gms", "fsc", "ransac"},
    "model": {"translation", "rigid", "similarity", "affine", "homography", "polynomial2", "polynomial3"},
    "method": {"sar-orb", "sar-orb-paper", "orb", "sift", "akaze"},
}


@pytest.fixture
def scratch(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[tuple[str, str], registry.Entry]]:
    """The registry with a copy of its list, put back afterwards."""
    registry.available("detector")
    copy = dict(registry._entries)
    monkeypatch.setattr(registry, "_entries", copy)
    monkeypatch.setattr(registry, "_broken", dict(registry._broken))
    return copy  # type: ignore[return-value]


class Nothing(Detector):
    """Finds nothing."""

    def __init__(self, count: int = 3) -> None:
        self.count = count

    def detect_features(self, image: Image) -> Features:
        return Features.empty()


@pytest.mark.parametrize("kind", NAMES)
def test_what_the_contract_names_is_there(kind: str) -> None:
    names = registry.available(kind)
    assert NAMES[kind] <= set(names)
    assert names == sorted(names)


def test_own_plugins_are_all_importable() -> None:
    assert not [module for module in registry.broken() if module.startswith("featreg.")]


def test_every_entry_has_a_summary_of_one_line() -> None:
    for kind in registry.KINDS:
        for entry in registry.entries(kind):
            assert entry.summary.strip(), entry.name
            assert "\n" not in entry.summary


def test_a_registered_class_can_be_made_by_name(scratch: Any) -> None:
    registry.register("nothing-at-all")(Nothing)
    made = registry.create("detector", "nothing-at-all", count=5)
    assert isinstance(made, Nothing)
    assert made.count == 5
    found = registry.entry("detector", "nothing-at-all")
    assert (found.parameters, found.summary) == ({"count": 3}, "Finds nothing.")


def test_a_second_plugin_of_one_name_is_an_error_that_names_both_modules(scratch: Any) -> None:
    class Other(Nothing):
        pass

    Other.__module__ = "somewhere.else"
    registry.register("twice")(Nothing)
    registry.register("twice")(Nothing)  # the same class again, as on a reload, is no conflict
    with pytest.raises(PluginError, match=r"somewhere\.else") as caught:
        registry.register("twice")(Other)
    assert Nothing.__module__ in str(caught.value)


def test_one_name_may_serve_two_kinds(scratch: Any) -> None:
    @registry.register("sar-ofast")
    @dataclass(frozen=True)
    class AllPass(Filter):
        """Keeps all."""

        def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
            return np.ones(len(matches), np.bool_)

    assert isinstance(registry.create("filter", "sar-ofast"), AllPass)
    assert isinstance(registry.create("detector", "sar-ofast"), Detector)


def test_parameters_must_be_keywords_with_defaults(scratch: Any) -> None:
    class Positional(Nothing):
        def __init__(self, count: int) -> None: ...

    class Anything(Nothing):
        def __init__(self, **more: int) -> None: ...

    for cls, name in ((Positional, "count"), (Anything, "more")):
        with pytest.raises(PluginError, match=name):
            registry.register("bad-parameters")(cls)


def test_a_plugin_has_exactly_one_kind(scratch: Any) -> None:
    class Both(Nothing, Matcher):
        def match(self, reference: Image, secondary: Image) -> Matches:
            return Matches.empty()

    class Neither:
        pass

    for cls in (Both, Neither):
        with pytest.raises(PluginError, match="exactly one"):
            registry.register("no-kind")(cls)


def test_unknown_names_suggest_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'sar-ofast'"):
        registry.create("detector", "sar-ofats")
    with pytest.raises(UnknownNameError, match="detector"):
        registry.available("detectors")
    with pytest.raises(UnknownNameError, match="unknown model"):
        registry.model_class("afine")


def test_unknown_parameters_suggest_the_nearest() -> None:
    with pytest.raises(ParameterError, match="did you mean 'threshold'"):
        registry.create("detector", "sar-ofast", treshold=3)


def test_an_unavailable_plugin_says_why_when_asked_for(scratch: Any) -> None:
    registry.register("needs-more", unavailable="torch is missing; pip install featreg[torch]")(Nothing)
    assert "needs-more" not in registry.available("detector")
    assert "needs-more" in [e.name for e in registry.entries("detector")]
    with pytest.raises(PluginUnavailableError, match=r"pip install featreg\[torch\]"):
        registry.create("detector", "needs-more")


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


def test_a_plugin_that_is_no_dataclass_is_checked_in_both_ways_of_making_it(scratch: Any) -> None:
    @registry.register("some-of-them")
    class Some(Nothing):
        def __init__(self, count: Annotated[int, Interval(ge=1, le=9)] = 3, share: float = 0.5) -> None:
            self.count, self.share = count, share

    makers: list[Callable[..., Any]] = [Some, lambda **given: registry.create("detector", "some-of-them", **given)]
    for make in makers:
        assert make(count=np.int32(9), share=1).count == 9
        with pytest.raises(ParameterError, match=r"'some-of-them\.count' must be a whole number from 1 to 9, got 10"):
            make(count=10)
        with pytest.raises(ParameterError, match=r"'some-of-them\.share' must be a number, got True"):
            make(share=True)


def test_a_family_declares_its_parameters_in_its_table(scratch: Any) -> None:
    registry.register_family(
        "detector",
        "of-a-family",
        lambda **given: Nothing(**given),
        {"count": Parameter.of(Annotated[int, Interval(ge=1)], 4, "how many"), "fast": True},
        summary="One of many",
        module="somewhere",
    )
    found = registry.entry("detector", "of-a-family")
    assert found.parameters == {"count": 4, "fast": True}
    assert found.declared["count"].meaning == "how many"
    wrong: dict[str, Any]
    for wrong in ({"count": 0}, {"fast": 1}):
        with pytest.raises(ParameterError, match=f"'of-a-family\\.{next(iter(wrong))}' must be "):
            registry.create("detector", "of-a-family", **wrong)


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        ("method", "sar-ofast", "unknown method 'sar-ofast': that is a detector, not a method; did you mean "),
        ("detector", "brief", "unknown detector 'brief': that is a descriptor, not a detector; "),
        ("filter", "orb", "unknown filter 'orb': that is a detector and a descriptor and a method, not a filter; "),
        ("method", "sar-obr", "unknown method 'sar-obr', did you mean 'sar-orb'"),
    ],
)
def test_a_name_of_another_kind_is_told_so(kind: str, name: str, words: str) -> None:
    assert str(registry.unknown(kind, name)).startswith(words)
    with pytest.raises(UnknownNameError, match=re.escape(words)):
        assemble(name) if kind == "method" else registry.entry(kind, name)


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


def test_eight_threads_may_look_up_at_once() -> None:
    names: list[list[str]] = []
    threads = [threading.Thread(target=lambda: names.append(registry.available("detector"))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(names) == 8
    assert all(n == names[0] for n in names)


def test_model_names_and_classes_belong_together() -> None:
    for name in registry.available("model"):
        assert registry.model_name(registry.model_class(name)) == name


def test_all_errors_are_of_one_tree() -> None:
    for error in (ParameterError, PluginError, PluginUnavailableError, UnknownNameError):
        assert issubclass(error, FeatregError)
