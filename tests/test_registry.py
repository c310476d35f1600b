"""The registry: kinds, names, parameters, errors that suggest."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pytest
from annotated_types import Interval

from featreg import registry
from featreg.errors import (
    FeatregError,
    ParameterError,
    PluginError,
    PluginUnavailableError,
    UnknownNameError,
)
from featreg.interfaces import Detector, Filter, FilterContext, Matcher
from featreg.pipeline.assembly import assemble
from featreg.runtime.parameters import Parameter
from featreg.types import BoolArray, Image, Matches
from made.plugins import Nothing

NAMES = {
    "detector": {"sar-ofast", "orb", "sift", "akaze", "fast"},
    "descriptor": {"brief", "orb", "sift"},
    "nearest": {"brute-force"},
    "filter": {"gms", "fsc", "ransac"},
    "model": {"translation", "rigid", "similarity", "affine", "homography", "polynomial2", "polynomial3"},
    "method": {"sar-orb", "sar-orb-paper", "orb", "sift", "akaze"},
}


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
