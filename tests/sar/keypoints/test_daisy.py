"""DAISY descriptors of gradient fields, and the descriptors `ratio-daisy` and `gabor-daisy` made of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.gradients.gabor import gabor_fields, gabor_gradients
from featreg.sar.gradients.gradient_field import GradientField
from featreg.sar.keypoints import daisy as daisy_module
from featreg.sar.keypoints.daisy import CELLS, LENGTH, Gradients, daisy
from featreg.types import Features, Image

Texture = Callable[..., NDArray[np.float32]]
NAMES = ("ratio-daisy", "gabor-daisy")


def points(xy: Any, scale: float, angle: Any = 0.0) -> Features:
    xy = np.asarray(xy, np.float64)
    return Features(xy, scale, angle, np.ones(len(xy)), np.zeros(len(xy), np.int64))


def field_of(image: Image, steepness: float) -> tuple[GradientField]:
    gy, gx = np.gradient(np.log(image.pixels) * steepness)
    return (GradientField(np.asarray(gx, np.float32), np.asarray(gy, np.float32)),)


def plain(field: GradientField, at: Features, sigma: float, block: int) -> NDArray[np.float64]:
    """What the descriptor is, by SciPy, one point and one cell after the other."""
    from scipy.ndimage import correlate1d, map_coordinates

    x, y = field.x.astype(np.float64), -field.y.astype(np.float64)
    length, angle = np.hypot(x, y), np.arctan2(y, x)
    maps = [length, x, y, length * np.cos(2 * angle), length * np.sin(2 * angle)]
    room = [(0, -side % block) for side in x.shape]
    rest = math.sqrt(sigma**2 - (block**2 - 1) / 12) / block
    reach = math.ceil(2.5 * rest)
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / rest) ** 2)
    for n, one in enumerate(maps):
        padded = np.pad(one, room)
        blocks = padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block).sum(axis=(1, 3))
        # Wide enough a border that sums beyond it are 0.
        smooth = np.pad(blocks, 20)
        for axis in (0, 1):
            smooth = correlate1d(smooth, taps / taps.sum(), axis=axis, mode="constant")
        maps[n] = smooth
    rings = [(0.0, 0.0)] + [(0.43, k / 4) for k in range(4)] + [(0.83, (k + 0.5) / 8) for k in range(8)]
    weight = [np.sinc(k / 8) ** 2 * math.sqrt((1 if k == 0 else 2) / 8) for k in (0, 1, 2)]
    rows = []
    for (px, py), radius, turn in zip(at.xy, at.scale, at.angle, strict=True):
        cells = []
        for out, share in rings:
            t = turn + 2 * math.pi * share
            place = np.array([py - radius * out * math.sin(t), px + radius * out * math.cos(t)])
            m, c1, s1, c2, s2 = (
                map_coordinates(one, ((place + 0.5) / block - 0.5 + 20)[:, None], order=1)[0] for one in maps
            )
            first, second = complex(c1, s1) * np.exp(-1j * turn), complex(c2, s2) * np.exp(-2j * turn)
            cells.append(
                [
                    weight[0] * m,
                    *(weight[1] * np.array([first.real, first.imag])),
                    *(weight[2] * np.array([second.real, second.imag])),
                ]
            )
        row = np.array(cells).T
        row /= np.linalg.norm(row)
        row *= np.minimum(1, 0.3 / np.maximum(np.linalg.norm(row, axis=0), 1e-9))
        rows.append(row.ravel() / np.linalg.norm(row))
    return np.array(rows)


@pytest.mark.parametrize(("radius", "block"), [(6.0, 1), (12.0, 2), (30.0, 4)])
@pytest.mark.parametrize("sparse", [False, True])
def test_descriptors_are_what_they_are_said_to_be(
    sar_texture: Texture, monkeypatch: pytest.MonkeyPatch, radius: float, block: int, sparse: bool
) -> None:
    """Some points lie at the border; around few points windows are made instead of maps."""
    image = as_image(sar_texture(101, 130))
    rng = np.random.default_rng(0)
    xy = np.concatenate([rng.uniform(0, 100, (70, 2)), [[0, 0], [129, 100], [1, 50.5]]])
    at = points(xy, radius, rng.uniform(-4, 4, len(xy)))
    sigma = 0.2 * 12 * 2 ** (2 / 3 * round(1.5 * math.log2(radius / 12)))
    monkeypatch.setattr(daisy_module, "SPARSE", 0 if sparse else math.inf)
    found = daisy(image, image, Gradients(field_of, (1.0,)), at, at.scale)
    np.testing.assert_allclose(found, plain(field_of(image, 1.0)[0], at, sigma, block), atol=2e-4)


def test_fields_are_added(sar_texture: Texture) -> None:
    """Of two times the same gradients the descriptor is that of once."""
    image, at = as_image(sar_texture(80, 90)), points(np.random.default_rng(1).uniform(10, 70, (30, 2)), 12.0)
    once = daisy(image, image, Gradients(field_of, (1.0,)), at, at.scale)
    twice = daisy(image, image, Gradients(_doubled, ()), at, at.scale)
    np.testing.assert_allclose(twice, once, atol=1e-5)


def _doubled(image: Image) -> tuple[GradientField, ...]:
    return field_of(image, 1.0) + field_of(image, 3.0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("scale", [12.0, 40.0])
def test_turning_image_and_points_by_a_quarter_keeps_the_descriptor(
    sar_texture: Texture, name: str, scale: float
) -> None:
    amplitude = sar_texture(200, 221)
    xy = np.random.default_rng(0).integers(50, 150, (40, 2)).astype(np.float64)
    turned = np.column_stack([xy[:, 1], amplitude.shape[1] - 1 - xy[:, 0]])
    descriptor = registry.create("descriptor", name)
    before = descriptor.describe_features(as_image(amplitude), points(xy, scale, 0.4)).descriptors
    other = as_image(np.rot90(amplitude).copy())
    after = descriptor.describe_features(other, points(turned, scale, 0.4 + math.pi / 2)).descriptors
    assert before is not None
    assert after is not None
    assert before.shape == (40, LENGTH)
    assert before.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(before, axis=1), 1, atol=1e-5)
    assert np.einsum("ij,ij->i", before, after).min() > 0.97


@pytest.mark.parametrize("name", NAMES)
def test_points_outside_and_in_nodata_are_dropped(sar_texture: Texture, name: str) -> None:
    amplitude = sar_texture(160, 200)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[40:80, 20:60] = False
    at = points([[30, 60], [100, 30], [-50, 1e6], [60, 120]], 12.0)
    found = registry.create("descriptor", name).describe_features(as_image(amplitude, mask=mask), at)
    assert found.index is not None
    kept = found.index.tolist()
    assert kept == [1, 3]


@pytest.mark.parametrize("name", NAMES)
def test_what_lies_under_the_mask_has_no_influence(sar_texture: Texture, name: str) -> None:
    amplitude = sar_texture(120, 140)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[50:60, 60:70] = False
    at = points([[55.0, 45.0], [30, 30], [80, 60]], 14.0)
    descriptor = registry.create("descriptor", name)
    one, two = (
        descriptor.describe_features(as_image(np.where(mask, amplitude, fill), mask=mask), at).descriptors
        for fill in (np.float32(1), np.float32(900))
    )
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 40), (17, 5)])
@pytest.mark.parametrize("name", NAMES)
def test_images_smaller_than_a_descriptor(name: str, shape: tuple[int, int]) -> None:
    amplitude = np.random.default_rng(0).uniform(1, 2, shape).astype(np.float32)
    image = Image(amplitude, np.ones(shape, np.bool_))
    at = points([[0.0, 0.0], [shape[1] - 1, shape[0] - 1]], 20.0)
    found = registry.create("descriptor", name).describe_features(image, at)
    assert found.descriptors is not None
    assert np.isfinite(found.descriptors).all()
    empty = registry.create("descriptor", name).describe_features(image, at.take(np.zeros(0, np.int64)))
    assert empty.descriptors is not None
    assert empty.descriptors.shape == (0, 5 * CELLS)


@pytest.mark.parametrize("shape", [(130, 151), (129, 150), (3, 4)])
@pytest.mark.parametrize("piece", [80, 300])
def test_fields_of_several_scales_are_the_gradients_in_every_other_row_and_column(
    sar_texture: Texture, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], piece: int
) -> None:
    image = Image(np.ascontiguousarray(sar_texture(160, 160)[: shape[0], : shape[1]]), np.ones(shape, np.bool_))
    monkeypatch.setattr("featreg.sar.gradients.gabor.PIECE", piece)
    fields = gabor_fields(image, (1.4, 2.8), (2, 4), 2, 3, 0.01)
    for sigma, step, field in zip((1.4, 2.8), (1, 2), fields, strict=True):
        for whole, found in zip(gabor_gradients(image, sigma, 3), (field.x, field.y), strict=True):
            assert found.shape == whole[::2, ::2].shape
            np.testing.assert_allclose(found[::step, ::step], whole[:: 2 * step, :: 2 * step], atol=2e-4)
    between = fields[1].x[:, : (fields[1].x.shape[1] - 1) // 2 * 2 + 1]
    np.testing.assert_allclose(between[:, 1::2], (between[:, :-2:2] + between[:, 2::2]) / 2, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_scales_far_beyond_the_image(sar_texture: Texture, name: str) -> None:
    """They may come from outside; a whole map for one of these would not fit into memory."""
    image, descriptor = as_image(sar_texture(100, 110)), registry.create("descriptor", name)
    found, as_far = (descriptor.describe_features(image, points([[50, 50]], scale)) for scale in (1e15, 2200.0))
    assert found.descriptors is not None
    assert as_far.descriptors is not None
    assert np.abs(found.descriptors - as_far.descriptors).max() < 1e-6


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("gabor-daisy", {"sigma": 50.0, "scales": 4}),
        ("gabor-daisy", {"scales": 12}),
        ("gabor-daisy", {"orientations": 1}),
        ("gabor-daisy", {"factor": 1.0}),
        ("ratio-daisy", {"finest": 0.0}),
        ("ratio-daisy", {"factor": 1.0}),
        ("ratio-daisy", {"floor": -1.0}),
    ],
)
def test_impossible_parameters_are_refused(name: str, given: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create("descriptor", name, **given)


def test_places_come_without_directions_and_get_those_of_whole_detection(sar_texture: Texture) -> None:
    image = as_image(sar_texture(150, 170))
    detector = registry.create("detector", "sar-harris", n_features=150)
    places, whole = detector.detect_places(image), detector.detect_features(image)
    assert not places.angle.any()
    np.testing.assert_array_equal(places.xy, whole.xy)
    some = np.array([0, 5, 17, 80])
    np.testing.assert_array_equal(detector.oriented(image, places.take(some)).angle, whole.angle[some])
    further = registry.create("detector", "sar-harris", n_features=150, second=0.8)
    np.testing.assert_array_equal(further.detect_places(image).angle, further.detect_features(image).angle)
