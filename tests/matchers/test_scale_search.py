"""Features at several ratios of the scales, and the method for optical against SAR that rests on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from featreg.matchers.scale_search import ScaleSearch, _Trial
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import ParameterError
from featreg.geometry import Similarity
from featreg.io import as_image
from featreg.simulate import sar_pair
from featreg.types import Image, Matches

cv2 = pytest.importorskip("cv2")


def test_the_ratios_cover_the_range_in_steps_no_larger_than_asked() -> None:
    ratios = np.array(ScaleSearch(largest=2.0, step=1.3).ratios)
    assert ratios[0] == pytest.approx(0.5)
    assert ratios[-1] == pytest.approx(2.0)
    assert 1.0 in ratios
    assert (ratios[1:] / ratios[:-1] <= 1.3).all()
    assert ScaleSearch(largest=1.0).ratios == (1.0,)


@pytest.mark.parametrize("scale", [0.6, 1.0, 1.6])
def test_a_difference_in_scale_is_bridged(scale: float) -> None:
    pair = sar_pair((300, 300), rotation_deg=20.0, scale=1.0, shift=(4.0, -3.0), seed=5)
    size = round(300 * scale)
    resized = cv2.resize(pair.secondary, (size, size), interpolation=cv2.INTER_AREA)
    grow = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1]])
    reg = featreg.match(pair.reference, resized, method="optical-sar")
    assert reg.status == "ok", reg.reason
    scores = featreg.evaluate(reg, (grow @ np.vstack([pair.truth, [0, 0, 1]]))[:2])
    assert scores.grid_rmse < 1.5


def test_images_of_different_places_have_no_trusted_alignment() -> None:
    first, second = (sar_pair((256, 256), seed=seed).reference for seed in (1, 2))
    assert featreg.match(first, second, method="optical-sar").status == "unreliable"


@pytest.mark.parametrize(("rival", "count"), [(30, 5), (70, 0)])
def test_two_alignments_with_a_consensus_each_give_no_match(
    rival: int, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which of the two it is cannot be told, so nothing is said."""
    here = np.random.default_rng(0).uniform(0, 100, (5, 2))
    one, half_turn = Similarity(rotation_deg=0.0), Similarity(rotation_deg=180.0, dx=100.0, dy=100.0)
    trials = [
        _Trial(Matches(here, model(here), np.ones(5)), model, 1.0, 1.0, places)
        for model, places in ((one, 90), (half_turn, rival))
    ]
    image = as_image(np.random.default_rng(0).gamma(4, size=(100, 100)))
    matcher = ScaleSearch(largest=1.5, step=1.5)
    answers = iter([None, *trials, trials[0]])
    monkeypatch.setattr(ScaleSearch, "_at", lambda *given: next(answers))
    found = matcher.match(image, image)
    assert len(found) == count
    if count:
        np.testing.assert_array_equal(found.secondary_xy, here)


def test_both_images_are_halved_while_they_stay_large_enough() -> None:
    sizes = [ScaleSearch(halvings=2)._sizes(blank(n), blank(1500)) for n in (300, 600, 1100)]
    assert sizes == [[1.0], [1.0, 0.5], [1.0, 0.5, 0.25]]


def blank(side: int) -> Image:
    return Image(np.ones((side, side), np.float32), np.ones((side, side), np.bool_))


def test_nothing_in_nothing_out() -> None:
    noise = np.random.default_rng(0).gamma(4, 0.25, (40, 50))
    assert len(registry.create("matcher", "scale-search").match(as_image(noise), as_image(noise))) == 0


@pytest.mark.parametrize(
    "parameters", [{"largest": 0.5}, {"step": 1.0}, {"threshold": 0.0}, {"ambiguity": 0.0}, {"n_features": 0}]
)
def test_impossible_parameters_are_refused(parameters: dict[str, float]) -> None:
    with pytest.raises(ParameterError, match=f"'scale-search\\.{next(iter(parameters))}' must be a"):
        registry.create("matcher", "scale-search", **parameters)


def outline_angle(content: NDArray[np.bool_]) -> float:
    """Angle in degrees, modulo a quarter turn, by which the square content of an image was turned about its centre."""
    y, x = np.mgrid[0 : content.shape[0], 0 : content.shape[1]] - (content.shape[0] - 1) / 2
    half = content.shape[0] / 2

    def overlap(degrees: float) -> float:
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        square = (np.abs(x * c - y * s) <= half) & (np.abs(x * s + y * c) <= half)
        return float((square & content).sum() / (square | content).sum())

    return max(np.arange(0, 90, 0.5), key=overlap)


@pytest.mark.realdata
@pytest.mark.parametrize("number", [1, 8, 15, 22, 27, 38])
def test_optical_and_sar_pairs_of_any_rotation_and_scale(number: int, realdata: Path) -> None:
    """The SAR images were turned about their centre, so their outline tells the rotation, and their size the scale."""
    folder = realdata / "optical_sar"
    optical, sar = (cv2.imread(str(folder / f"srif_pair{number}_{k}.jpg"), cv2.IMREAD_GRAYSCALE) for k in (1, 2))
    reg = featreg.match(optical, sar, method="optical-sar")
    assert reg.status == "ok", reg.reason
    dark = (cv2.medianBlur(sar, 3) < 12).astype(np.uint8)
    labels = cv2.connectedComponents(dark, connectivity=4)[1]
    corners = {int(labels[y, x]) for y in (0, -1) for x in (0, -1) if dark[y, x]}
    wanted = outline_angle(~np.isin(labels, list(corners)))
    matrix = np.asarray(reg.model.matrix)
    found = np.rad2deg(np.arctan2(matrix[0, 1], matrix[0, 0]))
    assert abs((found - wanted + 45) % 90 - 45) < 2.0
    assert np.sqrt(np.linalg.det(matrix[:2, :2])) == pytest.approx(256 / optical.shape[0], rel=0.04)
    middle = reg.model(np.array([[(optical.shape[1] - 1) / 2, (optical.shape[0] - 1) / 2]]))[0]
    np.testing.assert_allclose(middle, 127.5, atol=6)
