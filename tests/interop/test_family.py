"""Families of third-party algorithms: a toy library whose rows become plugins, as those of OpenCV and kornia do."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from annotated_types import Ge, Gt, Interval, Le, Lt, MultipleOf
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import DuplicatePluginError, ParameterError, PluginError, PluginUnavailableError
from featreg.interfaces import Descriptor, Detector
from featreg.interop.extraction import extractor
from featreg.interop.family import DESCRIBE, N_FEATURES, File, Member, Row, best_first, option, register_table
from featreg.pipeline.assembly import assemble
from featreg.types import Features, Image

WEIGHTS = File(meaning="file of trained weights")
IMAGE = np.random.default_rng(0).gamma(4.0, size=(64, 64)).astype(np.float32)


@dataclass(frozen=True)
class ToyRow(Row):
    """A row of the toy library, which calls pixels `measure`."""

    measure: Callable[[NDArray[Any], Mapping[str, Any]], NDArray[Any]] = field(kw_only=True)
    missing: str = ""
    weights: bool = False

    @property
    def unavailable(self) -> str:
        return self.missing

    @property
    def on_demand(self) -> bool:
        return self.weights


MARGIN = option(4, Interval(ge=1, lt=30), meaning="pixels of the border that are left out")
TABLE = {
    "toy-bright": ToyRow(
        "bright", "Bright pixels.", {**N_FEATURES, "margin": MARGIN, **DESCRIBE}, measure=lambda pixels, values: pixels
    ),
    "toy-power": ToyRow(
        "power",
        "Pixels by a power.",
        {
            **N_FEATURES,
            "margin": MARGIN,
            "exponent": option(2.0, Gt(0)),
            "sign": option("plus", choices={"plus": 1.0, "minus": -1.0}),
            "weights": WEIGHTS,
        },
        measure=lambda pixels, values: pixels ** values["exponent"],
    ),
    "toy-lost": ToyRow(
        "lost", "Not there.", N_FEATURES, measure=lambda pixels, values: pixels, missing="toys is missing; buy toys"
    ),
    "toy-late": ToyRow(
        "late", "Weights come late.", {**N_FEATURES, "weights": WEIGHTS}, measure=lambda pixels, values: pixels,
        missing="give weights=FILE", weights=True,
    ),
}  # fmt: skip


class ToyDetector(Member, Detector):
    """A detector of the toy library."""

    table = TABLE
    describes = "describe"

    def detect_features(self, image: Image) -> Features:
        values, m = self.parameters, self.parameters.get("margin", 1)
        score = TABLE[self.name].measure(image.amplitude, values)[m:-m, m:-m]
        y, x = np.indices(score.shape).reshape(2, -1) + m
        n = score.size
        table = np.full((n, 3), 7, np.float32) if values.get("describe") else None
        found = Features(np.column_stack([x, y]), np.ones(n), np.zeros(n), score.ravel(), np.zeros(n, np.int64), table)
        return best_first(found, values["n_features"])


@pytest.fixture(autouse=True)
def scratch(monkeypatch: pytest.MonkeyPatch) -> None:
    """The toys in a copy of the registry's list."""
    registry.available("detector")
    monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    register_table(ToyDetector)


def test_every_row_is_a_plugin_with_its_own_parameters() -> None:
    found = registry.entry("detector", "toy-power")
    assert found.parameters == {"n_features": 5000, "margin": 4, "exponent": 2.0, "sign": "plus", "weights": None}
    assert (found.summary, found.module) == ("Pixels by a power.", __name__)
    made = registry.create("detector", "toy-power", margin=np.int64(9), weights=Path("w.pth"), exponent=3)
    values = {name: getattr(made, name) for name in found.parameters}
    assert values == {"n_features": 5000, "margin": 9, "exponent": 3.0, "sign": "plus", "weights": "w.pth"}
    assert (type(values["margin"]), type(values["exponent"])) == (int, float)
    again = pickle.loads(pickle.dumps(made))
    assert again == made
    assert hash(again) == hash(made)
    assert made != registry.create("detector", "toy-power")


def test_a_member_works_like_any_other_plugin() -> None:
    keypoints, descriptors = extractor("toy-bright", n_features=20).detectAndCompute(IMAGE)
    assert descriptors is not None
    assert descriptors.shape == (20, 3)
    assert keypoints[0].pt == tuple(np.argwhere(IMAGE[4:-4, 4:-4] == IMAGE[4:-4, 4:-4].max())[0, ::-1] + 4)
    assert len(featreg.create("detector", "toy-power").detect(IMAGE)) == 56 * 56


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"margin": 0}, r"'toy-power.margin' must be a whole number of at least 1 and below 30, got 0"),
        ({"margin": 30}, r"'toy-power.margin' must be a whole number of at least 1 and below 30, got 30"),
        ({"margin": 3.5}, "a whole number"),
        ({"margin": True}, "a whole number"),
        ({"exponent": 0.0}, "above 0"),
        ({"exponent": float("nan")}, "above 0"),
        ({"n_features": 0}, "at least 1"),
        ({"sign": "times"}, "must be 'plus' or 'minus', got 'times'"),
        ({"weights": 3}, "the path of a file or None, got 3"),
        ({"margins": 3}, "did you mean 'margin'"),
    ],
)
def test_what_is_not_declared_is_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ParameterError, match=text):
        registry.create("detector", "toy-power", **given)
    with pytest.raises(ParameterError, match=text):
        ToyDetector("toy-power", given)


@pytest.mark.parametrize(
    ("limit", "good", "bad"),
    [(Ge(2), 2, 1), (Gt(2), 3, 2), (Le(2), 2, 3), (Lt(2), 1, 2), (MultipleOf(3), 6, 7), (Interval(gt=1, le=3), 3, 1)],
)
def test_every_kind_of_range_is_kept(limit: Any, good: int, bad: int) -> None:
    parameter = option(good, limit)
    parameter.check("n", good)
    with pytest.raises(ParameterError, match=f"'n' must be .* got {bad}"):
        parameter.check("n", bad)


def test_what_is_missing_is_named_and_weights_may_come_late() -> None:
    assert "toy-lost" not in registry.available("detector")
    with pytest.raises(PluginUnavailableError, match="toys is missing; buy toys"):
        registry.create("detector", "toy-lost")
    assert "toy-late" not in registry.available("detector")
    assert registry.create("detector", "toy-late", weights="w.pth").weights == "w.pth"  # type: ignore[attr-defined]


def test_a_detector_that_describes_is_told_not_to_where_a_descriptor_is_asked_for() -> None:
    assert registry.entry("detector", "toy-bright").describes == "describe"
    assert registry.entry("detector", "toy-power").describes is None
    made: Any = extractor("toy-bright", "brief")
    assert made.detector.describe is False
    assert extractor("toy-bright").detector.describe is True  # type: ignore[attr-defined]
    for name in ("orb", "sift", "akaze", "kaze", "brisk"):
        assert registry.entry("detector", name).describes == "describe"
    assert registry.entry("detector", "fast").describes is None


def test_a_parameter_called_describe_belongs_to_its_detector() -> None:
    @registry.register("toy-chatty")
    @dataclass(frozen=True)
    class Chatty(Detector):
        """A detector that describes its work in words."""

        describe: bool = True

        def detect_features(self, image: Image) -> Features:
            return Features.empty()

    every: list[dict[str, Any]] = [{}, {"describe": True}, {"describe": False}]
    for given in every:
        made: Any = extractor("toy-chatty", "brief", **given)
        assert made.detector.describe is given.get("describe", True)
        matcher: Any = assemble("sar-orb", detector="toy-chatty", **given).matcher
        assert matcher.detector.describe is given.get("describe", True)


def test_a_class_names_its_own_parameter() -> None:
    @registry.register("toy-mute")
    @dataclass(frozen=True)
    class Mute(Detector):
        """A detector whose descriptors are switched off by a name of its own."""

        describes = "with_descriptors"
        with_descriptors: bool = True

        def detect_features(self, image: Image) -> Features:
            return Features.empty()

    made: Any = extractor("toy-mute", "brief")
    assert made.detector.with_descriptors is False
    matcher: Any = assemble("sar-orb", detector="toy-mute").matcher
    assert matcher.detector.with_descriptors is False


def test_a_name_that_is_taken_and_a_class_without_a_kind_are_refused() -> None:
    class Other(ToyDetector):
        pass

    Other.__module__ = "elsewhere"
    with pytest.raises(DuplicatePluginError, match="toy-bright"):
        register_table(Other)

    class Both(Member, Detector, Descriptor):
        table = TABLE

    class Nothing(Member):
        table = TABLE

    for cls in (Both, Nothing):
        with pytest.raises(PluginError, match="must extend exactly one of"):
            register_table(cls)


def test_a_row_changes_without_the_class() -> None:
    doubled = replace(TABLE["toy-bright"], measure=lambda pixels, values: 2 * pixels)
    assert doubled.parameters == TABLE["toy-bright"].parameters
    assert doubled.defaults == {"n_features": 5000, "margin": 4, "describe": True}
