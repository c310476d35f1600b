"""RIFT: its detector, and whole registrations."""

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
from featreg.io import as_image
from featreg.simulate import SimulatedPair
from featreg.types import Features, Image

Texture = Callable[..., NDArray[np.float32]]


def detect(picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", "phase-congruency", **parameters).detect_features(picture)


# Detector


@pytest.mark.parametrize("n_features", [1, 2, 50, 100000])
def test_the_budget_is_kept(sar_texture: Texture, n_features: int) -> None:
    found = detect(as_image(sar_texture()), n_features=n_features)
    assert 0 < len(found) <= n_features


def test_corners_and_edges_share_the_budget(sar_texture: Texture) -> None:
    picture = as_image(sar_texture(300, 300))
    points = {share: set(map(tuple, detect(picture, n_features=100, corner_share=share).xy)) for share in (0, 0.3, 1.0)}
    assert len(points[0.3]) == 100
    assert len(points[0.3] & points[1.0]) == 30
    assert len(points[0.3] & points[0]) == 70


def test_a_negative_has_the_same_points(sar_texture: Texture) -> None:
    """Phase congruency does not know bright from dark."""
    amplitude = sar_texture()
    negative = amplitude.max() - amplitude
    gain = amplitude.mean() / negative.mean()
    options: dict[str, Any] = {"view": "amplitude", "n_features": 200}
    a = detect(as_image(amplitude), floor=1e-4, **options)
    b = detect(as_image(negative * gain), floor=1e-4, **options)
    apart = np.hypot(*(a.xy[:, None] - b.xy[None]).transpose(2, 0, 1)).min(axis=1)
    assert (apart < 0.1).mean() > 0.95


def test_points_follow_a_scene_that_moves_by_a_fraction_of_a_pixel(sar_texture: Texture) -> None:
    from scipy.ndimage import fourier_shift, gaussian_filter

    shift = np.array([0.4, -0.3])
    smooth = gaussian_filter(sar_texture(240, 240).astype(np.float64), 1.2, mode="wrap")
    moved = np.maximum(np.fft.ifft2(fourier_shift(np.fft.fft2(smooth), shift[::-1])).real, 0)
    error = {}
    for subpixel in ("centroid", "none"):
        a, b = (detect(as_image(v), subpixel=subpixel).xy for v in (smooth, moved))
        apart = np.hypot(*(a[:, None] + shift - b[None]).transpose(2, 0, 1))
        partner = apart.argmin(axis=1)
        near = apart[np.arange(len(a)), partner] < 1.5
        assert near.mean() > 0.7
        found = (b[partner] - a)[near]
        error[subpixel] = float(np.hypot(*(found - shift).T).mean())
        np.testing.assert_allclose(found.mean(axis=0), shift, atol=0.1)
    assert error["centroid"] < 0.7 * error["none"]


def test_no_point_lies_on_a_black_rim(sar_texture: Texture) -> None:
    bytes_ = np.clip(sar_texture(200, 220) * 60 + 4, 1, 255).astype(np.uint8)
    bytes_[:, :50] = 0
    found = detect(as_image(bytes_))
    assert len(found) > 20
    assert found.xy[:, 0].min() >= 50 + 18


def test_maps_are_computed_once_for_both(sar_texture: Texture, monkeypatch: pytest.MonkeyPatch) -> None:
    from featreg.sar.gradients import phase_congruency

    calls: list[int] = []
    real = phase_congruency._view

    def counted(*values: Any) -> Any:
        calls.append(1)
        return real(*values)

    monkeypatch.setattr(phase_congruency, "_view", counted)
    picture = as_image(sar_texture())
    registry.create("descriptor", "max-index-map").describe_features(picture, detect(picture))
    assert len(calls) == 1


# Whole registrations


def at_truth(pair: SimulatedPair, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(xy @ pair.truth[:2, :2].T + pair.truth[:2, 2])


def error_px(result: featreg.Registration, pair: SimulatedPair) -> float:
    y, x = np.mgrid[30:270:60, 30:270:60]
    grid = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    assert result.model
    return float(np.hypot(*(result.model(grid) - at_truth(pair, grid)).T).max())


def test_a_pair_is_registered(pair: SimulatedPair) -> None:
    result = featreg.match(pair.reference, pair.secondary, method="rift", refine=False)
    assert result.status == "ok", result.reason
    assert error_px(result, pair) < 1.5


def test_a_turned_pair_is_registered(turned_pair: SimulatedPair) -> None:
    result = featreg.match(turned_pair.reference, turned_pair.secondary, method="rift", refine=False)
    assert result.status == "ok", result.reason
    assert error_px(result, turned_pair) < 2.0


def test_another_sensor_with_brightness_reversed_is_registered(pair: SimulatedPair) -> None:
    relative = pair.secondary / pair.secondary.mean()
    other = np.asarray(1 / (0.3 + relative), np.float32)
    result = featreg.match(pair.reference, other, method="rift", refine=False)
    assert result.status == "ok", result.reason
    assert error_px(result, pair) < 2.0


def test_the_papers_form_runs(pair: SimulatedPair) -> None:
    result = featreg.match(pair.reference, pair.secondary, method="rift-paper")
    assert "gms" not in result.stages
    assert len(result.matches) > 50


@pytest.mark.realdata
def test_real_dates_are_registered_below_a_pixel(realdata: Path) -> None:
    files = sorted((realdata / "sentinel1_stack").glob("*.tif"))[:2]
    result = featreg.match(*(str(f) for f in files), method="rift", model="affine", refine=False)
    assert result.status == "ok", result.reason
    assert result.model
    corners = np.array([[50.0, 50.0], [450.0, 50.0], [50.0, 450.0], [450.0, 450.0]])
    assert np.hypot(*(result.model(corners) - corners).T).max() < 1.0


@pytest.mark.parametrize(
    "parameters",
    [
        {"n_features": 0},
        {"corner_share": 1.5},
        {"threshold": 255},
        {"support": 1.0},
        {"support": float("nan")},
        {"sigma": 0.0},
        {"subpixel": "parabola"},
        {"scales": 0},
        {"orientations": 3},
        {"min_wavelength": 1.0},
        {"multiplier": 1.0},
        {"bandwidth": 1.0},
        {"noise": float("nan")},
        {"floor": 0.0},
        {"view": "log"},
    ],
    ids=str,
)
def test_impossible_parameters_are_refused_when_the_plugin_is_made(parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create("detector", "phase-congruency", **parameters)
