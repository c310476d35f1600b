"""Where features were looked for: what a result records of it, and that it is what the detectors do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import ParameterError
from featreg.interfaces import Detector
from featreg.io import as_image
from featreg.pipeline.assembly import assemble
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.results.registration import Registration
from featreg.results.searching import searched_words, to_search_all
from featreg.sar.pyramid import valid_width
from featreg.simulate import SimulatedPair
from featreg.types import Image, Searched

Texture = Callable[..., NDArray[np.float32]]

DETECTORS = [
    ("sar-ofast", {"levels": 3, "factor": 1.3, "skip": 2}, 1.02, {50: "skip", 3000: ""}),
    ("sar-harris", {"subscale": False}, 1.02, {100: "coarse", 600: "thin", 3000: ""}),
    ("bf-sift", {}, 1.02, {300: "thin", 3000: ""}),
    ("phase-congruency", {}, 1.0, {300: ""}),
]


@pytest.mark.parametrize(
    ("name", "parameters", "slack", "count", "by"),
    [(name, parameters, slack, n, by) for name, parameters, slack, cases in DETECTORS for n, by in cases.items()],
)
def test_detectors_find_keypoints_of_the_radii_that_they_tell_and_no_others(
    sar_texture: Texture, name: str, parameters: dict[str, Any], slack: float, count: int, by: str
) -> None:
    image = as_image(sar_texture(220, 220, looks=1.0))
    detector: Detector = registry.create("detector", name, n_features=count, **parameters)
    told, found = detector.searched(image), detector.detect_features(image)
    assert len(found)
    nearest = np.min(np.abs(np.log(np.array(told.radii)[:, None] / found.scale)), axis=0)
    assert nearest.max() <= np.log(slack) + 1e-9
    assert (by in told.left_out) == bool(by)
    for radii in told.left_out.values():
        away = np.abs(np.log(np.array(radii)[:, None] / found.scale))
        assert away.min() > np.log(slack)
    # Nothing is called left out where whoever wants everything finds nothing more.
    everything = registry.create("detector", name, n_features=10**6, **parameters).searched(image)
    assert everything.whole
    assert set(everything.radii) <= {*told.radii, *(radius for radii in told.left_out.values() for radius in radii)}


def searched(reg: Registration) -> dict[str, Any]:
    [one] = reg.provenance["searched"]
    return {role: dict(one[role]) for role in ("reference", "secondary")}


def test_a_result_says_what_was_left_out_and_who_asked(turned_pair: SimulatedPair, tmp_path: Path) -> None:
    reg = featreg.match(turned_pair.reference, turned_pair.secondary, n_features=300)
    assert searched(reg)["reference"] == searched(reg)["secondary"]
    told = searched(reg)["reference"]
    assert told["share"] == 1
    assert told["left_out_px"] == {"detector.skip": [20.0, 26.0]}
    assert told["radii_px"] == pytest.approx([20 * 1.3**n for n in (2, 3, 4)], abs=0.06)
    line = "keypoints of 33.8 to 57.1 px radius, without those of 20 to 26 px radius (detector.skip=2)"
    assert f"searched: {line}" in " ".join(reg.explain().split())
    assert line in " ".join(reg.summary().split())
    reg.to_json(tmp_path / "result.json")
    assert Registration.from_json(tmp_path / "result.json").provenance["searched"] == reg.provenance["searched"]


def test_a_reduced_image_is_told_with_radii_in_its_own_pixels(turned_pair: SimulatedPair) -> None:
    images = turned_pair.reference, turned_pair.secondary
    reduced, whole = (
        featreg.match(*images, method="rift", n_features=300, refine=False, pixels_per_feature=p) for p in (75.0, 0.0)
    )
    assert searched(reduced)["reference"] == {"share": 0.5, "reduced_by": "pixels_per_feature", "radii_px": [40.0]}
    assert searched(whole)["reference"] == {"share": 1.0, "radii_px": [20.0]}
    assert "features" in searched_words({"searched": [{"reference": {"share": 0.5, "reduced_by": "x"}} | {
        "secondary": {"share": 1.0}}]})  # fmt: skip
    assert searched_words(reduced.provenance) == (
        "keypoints of 40 px radius, at 50 % of the size (pixels_per_feature=75)"
    )
    assert not searched_words(whole.provenance)
    assert to_search_all(reduced.provenance) == ("--set pixels_per_feature=0",)


def test_blocks_say_in_how_many_of_them(turned_pair: SimulatedPair, tmp_path: Path) -> None:
    """Fresh, and from the files of a run before."""
    keywords: Any = {"block": 150, "n_features": 60, "workers": 1, "resume": tmp_path}
    first, again = (featreg.match(turned_pair.reference, turned_pair.secondary, **keywords) for _ in range(2))
    assert again.provenance["blocks"]["reused"] == 4
    for reg in (first, again):
        ways = reg.provenance["searched"]
        assert sum(way["blocks"] for way in ways) == 4
        assert all("detector.skip" in way["reference"]["left_out_px"] for way in ways)
        assert "blocks keypoints of" in searched_words(reg.provenance)
        assert "(detector.skip=2)" in searched_words(reg.provenance)
    assert first.provenance["searched"] == again.provenance["searched"]


def test_a_cause_of_few_tie_points_is_named_with_its_cure(turned_pair: SimulatedPair) -> None:
    noise = np.random.default_rng(0).gamma(1, 1, (300, 300)).astype(np.float32)
    text = " ".join(featreg.match(turned_pair.reference, noise, n_features=100, method="sar-orb").explain().split())
    assert "features were not looked for everywhere" in text
    assert "--set detector.skip=0" in text


def test_who_does_not_tell_is_not_spoken_for(turned_pair: SimulatedPair) -> None:
    reg = featreg.match(turned_pair.reference, turned_pair.secondary, method="sar-dense")
    assert "searched" not in reg.provenance


def test_names_and_radii_follow_the_part_and_the_reduction() -> None:
    told = Searched(radii=(3.0,), left_out={"skip": (1.0, 2.0)}).of_part("detector").reduced(0.5, "pixels_per_feature")
    assert told == Searched(0.5, "pixels_per_feature", (6.0,), {"detector.skip": (2.0, 4.0)})
    assert Searched().whole
    assert not told.whole


@pytest.mark.parametrize("wrong", [True, float("nan"), float("inf"), -1.0])
def test_how_many_pixels_a_feature_needs_is_a_number(wrong: Any) -> None:
    parts = registry.create("detector", "orb"), None, registry.create("nearest", "brute-force")
    with pytest.raises(ParameterError, match="'pixels_per_feature' must be a number"):
        FeatureMatcher(*parts, pixels_per_feature=wrong)
    with pytest.raises(ParameterError, match="'pixels_per_feature' must be a number"):
        assemble("sar-sift", pixels_per_feature=wrong)


def test_no_number_of_a_plugin_may_be_nan_and_none_of_our_own_sizes_infinite() -> None:
    """Infinite are thresholds that nothing or everything passes, and what other libraries take."""
    for kind in ("detector", "descriptor", "nearest", "matcher", "filter"):
        for entry in registry.entries(kind):
            for name, parameter in entry.declared.items():
                if parameter.kind is float:
                    assert not parameter.allows(float("nan")), (entry.name, name)
                    if entry.name in OWN and "threshold" not in name and name != "quota_decay":
                        assert not parameter.allows(float("inf")), (entry.name, name)


OWN = (
    *("sar-ofast", "sar-harris", "block-sar-harris", "phase-congruency", "bf-sift", "brief", "max-index-map"),
    *("ratio-gloh", "ratio-daisy", "gabor-odd", "gabor-daisy"),
)


# Strips of valid pixels in a frame


def strip(side: int, width: float, turned: bool) -> NDArray[np.bool_]:
    y, x = np.mgrid[:side, :side]
    return np.asarray(np.abs(x - y if turned else 0 * x + y - side / 2 + 0.5) < width / 2 * (2**0.5 if turned else 1))


@pytest.mark.parametrize("width", [60, 100, 300])
def test_what_is_valid_is_as_wide_as_the_squares_in_it(width: int) -> None:
    """A diagonal strip is as wide as the squares that fit into it, by a root of two less than straight ones."""
    blank = np.ones((1200, 1200), np.float32)
    assert valid_width(Image(blank, np.ones_like(blank, np.bool_))) == 1200
    for turned, wide in ((False, width), (True, width / 2**0.5)):
        mask = strip(1200, width, turned)
        assert valid_width(Image(blank * mask, mask)) == pytest.approx(max(wide, 48), rel=0.12)
    assert valid_width(Image(blank[:90], np.ones((90, 1200), np.bool_))) == 90


@pytest.mark.parametrize("method", ["sar-orb", "sar-sift", "rift"])
def test_a_strip_in_a_frame_gives_as_many_matches_as_alone(sar_texture: Texture, method: str) -> None:
    """A diagonal strip is as wide as a straight one that is narrower by a root of two, and longer."""
    matcher, rng = assemble(method, n_features=250).matcher, np.random.default_rng(7)
    assert matcher is not None
    scene = sar_texture(600, 600, looks=400.0)
    looks = [(scene * np.sqrt(rng.gamma(4, 0.25, scene.shape))).astype(np.float32) for _ in range(2)]
    diagonal, straight = strip(600, 100, True), strip(600, 100 / 2**0.5, False)

    def right(images: list[Image]) -> int:
        found = matcher.match(*images)
        return int((np.hypot(*(found.reference_xy - found.secondary_xy).T) < 1.5).sum())

    framed = right([as_image(look, mask=diagonal) for look in looks])
    cropped = right([as_image(look[straight.any(axis=1)]) for look in looks])
    assert cropped > 20
    assert framed > 0.9 * cropped


def test_what_another_plugin_tells_without_radii_is_said_too() -> None:
    image = {"share": 1.0, "radii_px": [20.0], "left_out_px": {"detector.skip": []}}
    assert "without those of no radius" in searched_words({"searched": [{"reference": image, "secondary": image}]})


@pytest.mark.parametrize("method", ["rift", "orb"])
def test_images_are_reduced_for_as_many_features_as_the_detector_gives(turned_pair: SimulatedPair, method: str) -> None:
    whole: dict[str, Any] = {"method": method, "refine": False, "pixels_per_feature": 300.0}
    budgets: list[dict[str, Any]] = [
        {"n_features": 200}, {"n_features": 2000, "detector.n_features": 200}, {"n_features": 2000},
    ]  # fmt: skip
    shares = [
        searched(featreg.match(turned_pair.reference, turned_pair.secondary, **whole, **budget))["reference"]["share"]
        for budget in budgets
    ]
    assert shares[0] == shares[1] < shares[2] == 1
