"""GOF: ratio gradients of odd Gabor filters, their descriptor, and the presets built on it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.gradients import gabor
from featreg.sar.gradients.gabor import gabor_gradients, half_filters
from featreg.simulate import SimulatedPair
from featreg.types import Features, Image
from made.keypoints import at

Texture = Callable[..., NDArray[np.float32]]


def halves(image: NDArray[np.float32], sigma: float, theta: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Plain weighted means on the side towards theta (counter-clockwise as seen) and on the other side."""
    from scipy.ndimage import correlate

    reach = math.ceil(3 * sigma * 1.5)
    x, up = np.meshgrid(np.arange(-reach, reach + 1), np.arange(reach, -reach - 1, -1))
    u = x * math.cos(theta) + up * math.sin(theta)
    v = up * math.cos(theta) - x * math.sin(theta)
    wave = np.exp(-(u**2 + (v / 1.5) ** 2) / (2 * sigma**2)) * np.sin(math.pi * u / (2 * sigma))
    after, before = np.maximum(wave, 0), np.maximum(-wave, 0)
    return tuple(correlate(image.astype(np.float64), k / k.sum(), mode="mirror") for k in (after, before))  # type: ignore[return-value]


@pytest.mark.parametrize(("sigma", "orientations"), [(2.0, 4), (1.4, 6), (3.0, 2)])
def test_gradients_are_the_projected_log_ratios_of_the_halves(
    sar_texture: Texture, sigma: float, orientations: int
) -> None:
    amplitude = sar_texture(90, 110)
    floor = 0.01 * amplitude.mean()
    wanted = np.zeros((2, *amplitude.shape))
    for n in range(orientations):
        theta = math.pi * n / orientations
        after, before = halves(amplitude, sigma, theta)
        ratio = np.log((after + floor) / (before + floor)) * 2 / orientations
        wanted += np.array([math.cos(theta), -math.sin(theta)])[:, None, None] * ratio
    found = gabor_gradients(as_image(amplitude), sigma, orientations)
    np.testing.assert_allclose(found, wanted, atol=2e-4)


def test_pieces_fit_together(sar_texture: Texture, monkeypatch: pytest.MonkeyPatch) -> None:
    amplitude = sar_texture(130, 150)
    whole = gabor_gradients(as_image(amplitude), 2.0)
    monkeypatch.setattr(gabor, "PIECE", 50)
    np.testing.assert_allclose(gabor_gradients(as_image(amplitude), 2.0), whole, atol=1e-4)


@pytest.mark.parametrize("shape", [(130, 151), (129, 150), (1, 2), (2, 1), (3, 4)])
@pytest.mark.parametrize("sigma", [1.4, 2.0])
@pytest.mark.parametrize("piece", [50, 300])
def test_sparse_gradients_are_every_other_one_and_what_lies_between(
    sar_texture: Texture, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], sigma: float, piece: int
) -> None:
    amplitude = sar_texture(160, 160)[: shape[0], : shape[1]]
    picture = Image(np.ascontiguousarray(amplitude), np.ones(shape, np.bool_))
    monkeypatch.setattr(gabor, "PIECE", piece)
    both = (gabor_gradients(picture, sigma, 3, sparse=sparse) for sparse in (False, True))
    for whole, sparse in zip(*both, strict=True):
        np.testing.assert_allclose(sparse[::2, ::2], whole[::2, ::2], atol=1e-4)
        columns, rows = sparse[:, : (shape[1] - 1) // 2 * 2 + 1], sparse[: (shape[0] - 1) // 2 * 2 + 1]
        np.testing.assert_allclose(columns[:, 1::2], (columns[:, :-2:2] + columns[:, 2::2]) / 2, atol=1e-6)
        np.testing.assert_allclose(rows[1::2], (rows[:-2:2] + rows[2::2]) / 2, atol=1e-6)


@pytest.mark.parametrize(("sigma", "most"), [(2.0, 0.35), (4.0, 0.1)])
def test_sparse_gradients_of_speckle_are_near_dense_ones(sigma: float, most: float) -> None:
    """Speckle is the worst case: between the samples, gradients of a scene are straighter."""
    speckle = as_image(np.sqrt(np.random.default_rng(0).gamma(4, 0.25, (200, 200))).astype(np.float32))
    dense, sparse = (np.array(gabor_gradients(speckle, sigma, 3, sparse=sparse)) for sparse in (False, True))
    assert 0 < np.sqrt(((sparse - dense) ** 2).mean() / (dense**2).mean()) < most


@pytest.mark.parametrize("angle", [0.0, 30.0, 75.0, 140.0, 250.0])
def test_the_gradient_points_towards_the_bright_side(angle: float) -> None:
    t = math.radians(angle)
    y, x = np.mgrid[:80, :80]
    edge = as_image(np.where((x - 40) * math.cos(t) - (y - 40) * math.sin(t) > 0, 3.0, 1.0).astype(np.float32))
    gx, gy = gabor_gradients(edge, 2.0, 8)
    found = math.degrees(math.atan2(-gy[40, 40], gx[40, 40]))
    assert abs(math.remainder(found - angle, 360)) < 6


def test_gain_drops_out_and_a_flat_image_has_no_gradient(sar_texture: Texture) -> None:
    amplitude = sar_texture(80, 80)
    first, second = (gabor_gradients(as_image(amplitude * np.float32(g)), 2.0) for g in (1, 300))
    np.testing.assert_allclose(first, second, atol=1e-3)
    flat = Image(np.full((70, 60), 5.0, np.float32), np.ones((70, 60), np.bool_))
    np.testing.assert_allclose(gabor_gradients(flat, 2.0), 0, atol=1e-5)


def test_speckle_spreads_alike_on_dark_and_bright_ground() -> None:
    """What a ratio is for: the gradient of pure speckle does not depend on the mean."""
    speckle = np.sqrt(np.random.default_rng(0).gamma(4, 0.25, (100, 200))).astype(np.float32)
    ground = np.where(np.arange(200) < 100, 1, 20).astype(np.float32)
    gx, _ = gabor_gradients(as_image(speckle * ground), 2.0, floor=0.0)
    assert gx[:, 15:85].std() == pytest.approx(gx[:, 115:185].std(), rel=0.1)


def test_ground_without_any_echo_and_no_floor() -> None:
    """A mean that is nothing but rounding errors, half of them negative, counts as 1e-36 of the image's mean."""
    amplitude = np.zeros((90, 90), np.float32)
    amplitude[20:80:20, 20:80:20] = 5
    picture = Image(amplitude, np.ones((90, 90), np.bool_))
    gx, gy = gabor_gradients(picture, 2.0, 2, floor=0.0)
    for y in range(20, 80, 20):
        assert (gx[y - 2 : y + 3, 17:77:20] > 5).all()
        assert (gx[y - 2 : y + 3, 23:83:20] < -5).all()
    # The points are 900 times as bright as the mean, which is less than 1e39 times the least mean.
    assert max(np.abs(gx).max(), np.abs(gy).max()) < math.log(1e39)


def test_what_lies_under_the_mask_has_no_influence(sar_texture: Texture) -> None:
    amplitude = sar_texture(100, 100)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[40:60, 40:60] = False
    first, second = (
        gabor_gradients(as_image(a, mask=mask), 2.0)
        for a in (amplitude, np.where(mask, amplitude, 77).astype(np.float32))
    )
    np.testing.assert_array_equal(first, second)
    for component in first:
        assert not component[36:64, 36:64].any()
        assert component[30, 30] != 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (3, 200), (7, 5)])
def test_images_smaller_than_the_filter(shape: tuple[int, int]) -> None:
    amplitude = np.random.default_rng(0).uniform(1, 2, shape).astype(np.float32)
    picture = Image(amplitude, np.ones(shape, np.bool_))
    for component in gabor_gradients(picture, 4.0):
        assert component.shape == shape
        assert np.isfinite(component).all()


def test_filters_hold_means() -> None:
    """Both halves have unit sum: of a constant image the mean is that constant and the difference 0."""
    filters = half_filters(64, 80, 2.0, 4)
    np.testing.assert_allclose(64 * 80 * filters[:, 0, 0], 1, atol=1e-6)


# Descriptor


def describe(picture: Image, features: Features, **parameters: Any) -> NDArray[np.float32]:
    found = registry.create("descriptor", "gabor-odd", **parameters).describe_features(picture, features).descriptors
    assert found is not None
    return found.astype(np.float32)


@pytest.mark.parametrize("scales", [1, 4])
def test_turning_image_and_point_by_a_quarter_keeps_the_descriptor(sar_texture: Texture, scales: int) -> None:
    amplitude = sar_texture(200, 220)
    xy = np.random.default_rng(0).integers(50, 150, (40, 2)).astype(np.float64)
    turned = np.column_stack([xy[:, 1], amplitude.shape[1] - 1 - xy[:, 0]])
    before = describe(as_image(amplitude), at(xy, angle=0.4), scales=scales)
    after = describe(as_image(np.rot90(amplitude).copy()), at(turned, angle=0.4 + math.pi / 2), scales=scales)
    length = np.linalg.norm(before, axis=1)
    assert (np.einsum("ij,ij->i", before, after) / length / np.linalg.norm(after, axis=1)).min() > 0.97
    assert length.max() <= 1 + 1e-5
    assert length.min() > 0.9


def test_an_image_twice_as_large_is_described_alike_in_its_first_octave(sar_texture: Texture) -> None:
    """Halving the image whose pixels are all doubled gives the image back."""
    amplitude, xy = sar_texture(150, 160), np.random.default_rng(0).uniform(30, 120, (20, 2))
    large = as_image(amplitude.repeat(2, axis=0).repeat(2, axis=1))
    small = describe(as_image(amplitude), at(xy, 24.0, 0.7), sigma=2.0)
    np.testing.assert_allclose(describe(large, at(2 * xy + 0.5, 48.0, 0.7), sigma=4.0), small, atol=1e-5)


def test_descriptors_from_sparse_gradients_are_like_those_from_dense_ones(
    sar_texture: Texture, monkeypatch: pytest.MonkeyPatch
) -> None:
    amplitude, points = sar_texture(), at(np.random.default_rng(0).uniform(30, 170, (100, 2)))
    sparse = describe(as_image(amplitude), points, sigma=2.0)
    monkeypatch.setattr("featreg.descriptors.gabor_odd.SPARSE", math.inf)
    likeness = np.einsum("ij,ij->i", sparse, describe(as_image(amplitude), points, sigma=2.0))
    assert np.median(likeness) > 0.99
    assert likeness.max() < 1 - 1e-4


def test_scales_are_told_apart(sar_texture: Texture) -> None:
    picture, points = as_image(sar_texture()), at([[100, 100], [60, 120]])
    one, four = describe(picture, points), describe(picture, points, scales=4)
    assert one.shape == four.shape == (2, 85)
    assert np.abs(one - four).max() > 0.02
    np.testing.assert_allclose(describe(picture, points, scales=1, factor=3.0), one)


def test_harmonics_decide_how_long_a_descriptor_is(sar_texture: Texture) -> None:
    picture, points = as_image(sar_texture()), at([[100, 100], [60, 120], [80, 50]])
    for harmonics, length in ((0, 17), (1, 51), (2, 85), (3, 119), (4, 136)):
        found = describe(picture, points, harmonics=harmonics)
        assert found.shape == (3, length)
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-5)
    with pytest.raises(ParameterError, match="harmonics"):
        describe(picture, points, harmonics=5)


@pytest.mark.parametrize("detector", ["sar-ofast", "sift", "fast"])
def test_any_detector_will_do(pair: SimulatedPair, detector: str) -> None:
    found = featreg.match(
        pair.reference, pair.secondary, method="s-gof", detector=registry.create("detector", detector), refine=False
    )
    assert len(found.matches) > 50


@pytest.mark.parametrize(
    "parameters",
    [
        {"scales": 0},
        {"sigma": 0.1},
        {"sigma": float("nan")},
        {"orientations": 1},
        {"factor": 1.0},
        {"step": 0.0},
        {"floor": -1.0},
    ],
    ids=str,
)
def test_impossible_parameters_are_refused(parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create("descriptor", "gabor-odd", **parameters)
