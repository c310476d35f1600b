"""BRIEF: turned with its keypoint, on the level of its scale, clear of nodata and borders."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.pyramid import pyramid, to_base
from featreg.sar.speckle import despeckled_bytes
from featreg.types import Features, Image
from made.keypoints import at

Texture = Callable[..., NDArray[np.float32]]


def describe(picture: Image, features: Features, **parameters: Any) -> Features:
    return registry.create("descriptor", "brief", **parameters).describe_features(picture, features)


def bits(features: Features) -> NDArray[np.uint8]:
    assert features.descriptors is not None
    return np.unpackbits(features.descriptors.astype(np.uint8), axis=1)


def agreement(a: Features, b: Features) -> float:
    return float((bits(a) == bits(b)).mean())


def inner_points(shape: tuple[int, int], n: int = 60) -> NDArray[np.int64]:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.integers(26, shape[1] - 26, n), rng.integers(26, shape[0] - 26, n)])


@pytest.mark.parametrize("length", [256, 512, 1024])
def test_length_and_kind(sar_texture: Texture, length: int) -> None:
    found = describe(as_image(sar_texture()), at(inner_points((200, 220))), bits=length)
    assert found.norm == "hamming"
    assert found.descriptors is not None
    assert found.descriptors.shape == (60, length // 8)
    assert found.descriptors.dtype == np.uint8
    assert 0.35 < bits(found).mean() < 0.65


def test_a_bit_is_set_where_the_first_sample_is_darker() -> None:
    """On a ramp along x, a comparison and its mirror image give opposite bits."""
    x = np.mgrid[:100, :100][1]
    ramp = as_image(np.exp(0.02 * x))
    towards, away = describe(ramp, at([[50, 50]])), describe(ramp, at([[50, 50]], angle=math.pi))
    assert 0.3 < bits(towards).mean() < 0.7
    assert (bits(towards) != bits(away)).mean() > 0.9


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0, -1.2])
def test_turning_image_and_keypoint_by_a_quarter_keeps_the_bits(sar_texture: Texture, angle: float) -> None:
    amplitude = sar_texture()
    xy = inner_points(amplitude.shape)
    before = describe(as_image(amplitude), at(xy, angle=angle))
    turned = np.column_stack([xy[:, 1], amplitude.shape[1] - 1 - xy[:, 0]])
    after = describe(as_image(np.rot90(amplitude)), at(turned, angle=angle + math.pi / 2))
    assert agreement(before, after) > 0.99
    ignored = describe(as_image(np.rot90(amplitude)), at(turned, angle=angle))
    assert agreement(before, ignored) < 0.7


def test_turning_by_thirty_degrees_keeps_most_bits(sar_texture: Texture) -> None:
    cv2 = pytest.importorskip("cv2")
    amplitude = cv2.GaussianBlur(sar_texture(260, 260), (0, 0), 1.5)
    matrix = cv2.getRotationMatrix2D((129.5, 129.5), 30.0, 1.0)  # counter-clockwise as seen
    turned = cv2.warpAffine(amplitude, matrix, (260, 260), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    xy = np.random.default_rng(0).integers(90, 170, (60, 2)).astype(np.float64)
    there = xy @ matrix[:, :2].T + matrix[:, 2]
    before = describe(as_image(amplitude), at(xy))
    after = describe(as_image(np.maximum(turned, 0)), at(there, angle=math.radians(30)))
    assert agreement(before, after) > 0.85


def test_upright_ignores_the_angle(sar_texture: Texture) -> None:
    picture = as_image(sar_texture())
    xy = inner_points((200, 220))
    angles = np.random.default_rng(1).uniform(0, 6, len(xy))
    upright = describe(picture, at(xy, angle=angles), oriented=False)
    np.testing.assert_array_equal(bits(upright), bits(describe(picture, at(xy))))


def test_mixed_angles_are_each_their_own(sar_texture: Texture) -> None:
    picture = as_image(sar_texture())
    xy = inner_points((200, 220), 4)
    angles = [0.0, 1.0, -2.0, 1.0]
    together = describe(picture, at(xy, angle=np.array(angles)))
    for i, angle in enumerate(angles):
        np.testing.assert_array_equal(bits(together)[i], bits(describe(picture, at(xy[i : i + 1], angle=angle)))[0])


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8])
def test_points_of_one_turn_have_the_bits_of_each_alone(sar_texture: Texture, count: int) -> None:
    """They are compared three at a time; what is left over, and where a turn ends, one by one."""
    picture, points = as_image(sar_texture()), inner_points((200, 220), count)
    angles = np.where(np.argsort(points[:, 1]).argsort() < 5, 0.5, 2.0)
    together = describe(picture, at(points, angle=angles))
    for number in range(count):
        alone = describe(picture, at(points[number : number + 1], angle=angles[number]))
        assert (bits(alone)[0] == bits(together)[number]).all()


@pytest.mark.parametrize("level", [0, 1, 3])
def test_the_scale_chooses_the_level(sar_texture: Texture, level: int) -> None:
    picture = as_image(sar_texture(300, 300))
    small = pyramid(picture, 8, 1.2)[level]
    xy = inner_points(small.shape, 30)
    found = describe(picture, at(to_base(xy.astype(np.float64), small, picture), scale=20.0 * 1.2**level))
    alone = describe(Image(np.array(small.amplitude), np.array(small.mask)), at(xy))
    assert len(found) == 30
    np.testing.assert_array_equal(bits(found), bits(alone))


def test_few_points_have_the_bits_of_the_whole_view(sar_texture: Texture) -> None:
    """Also halfway between the pixels of a level, where a point may go either way."""
    amplitude, between = sar_texture(260, 390), np.arange(32.0, 268.0, 13.0)
    chain = pyramid(as_image(amplitude), 2, 1.3)
    xy = np.column_stack([between * 390 / chain[1].shape[1] - 0.5, np.full(len(between), 130.0)])
    whole = as_image(amplitude)
    for level in pyramid(whole, 2, 1.3):
        despeckled_bytes(level)
    wanted = describe(whole, at(xy, scale=26.0, angle=0.7), levels=2, factor=1.3)
    for i in range(len(xy)):
        alone = describe(as_image(amplitude), at(xy[i : i + 1], scale=26.0, angle=0.7), levels=2, factor=1.3)
        np.testing.assert_array_equal(bits(alone)[0], bits(wanted)[i])


def test_points_halfway_between_pixels_of_a_level_are_made_where_they_are_described(
    sar_texture: Texture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third level of 1.2 of 300 columns has 174: (99.5 + 0.5) * 174 / 300 is whole, with the share first not."""
    asked: list[Any] = []

    def around(level: Image, places: Any, count: int, *_: Any) -> Any:
        asked.append(places())
        assert len(asked[-1]) == count
        return despeckled_bytes(level)

    module = sys.modules[type(registry.create("descriptor", "brief")).__module__]
    monkeypatch.setattr(module, "despeckled_bytes_around", around)
    image = as_image(sar_texture(300, 300))
    describe(image, at([[99.5, 199.5]], scale=20.0 * 1.2**3), levels=4, factor=1.2)
    (places,) = asked
    # As the kernel rounds them.
    assert places.tolist() == [[int(np.rint((x + 0.5) * 174 / 300 - 0.5)) for x in (99.5, 199.5)]]


def test_scales_beyond_the_pyramid_use_its_ends(sar_texture: Texture) -> None:
    picture = as_image(sar_texture(300, 300))
    xy = [[150, 150]]
    tiny, first = describe(picture, at(xy, scale=0.0)), describe(picture, at(xy, scale=20.0))
    np.testing.assert_array_equal(bits(tiny), bits(first))
    assert len(describe(picture, at(xy, scale=1e6))) == 1


def test_gain_drops_out(sar_texture: Texture) -> None:
    amplitude, xy = sar_texture(), inner_points((200, 220))
    louder = describe(as_image(amplitude * np.float32(1000)), at(xy))
    assert agreement(describe(as_image(amplitude), at(xy)), louder) > 0.999


def test_points_too_near_the_border_or_nodata_are_dropped_and_the_rest_named(sar_texture: Texture) -> None:
    amplitude = sar_texture(200, 200)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[100:110, 100:110] = False
    xy = np.array([[100, 40], [22, 60], [18, 60], [0, 0], [-5, 300], [127, 105], [140, 105], [182, 100], [177, 100]])
    found = describe(as_image(amplitude, mask=mask), at(xy))
    assert found.index is not None
    np.testing.assert_array_equal(found.xy, xy[found.index])
    assert found.index.tolist() == [0, 1, 6, 8]


@pytest.mark.parametrize("radius", [5.0, 16.0, 20.5, 31.0])
def test_samples_fill_the_radius_and_do_not_leave_it(sar_texture: Texture, radius: float) -> None:
    """Shuffling the pixels beyond the radius changes next to nothing, shuffling the outer half of it does."""
    rng = np.random.default_rng(0)
    amplitude = sar_texture(160, 160)
    y, x = np.mgrid[:160, :160]
    agreed = {}
    for reach in (radius + 3, 0.5 * radius):
        beyond = np.hypot(x - 80, y - 80) > reach
        other = amplitude.copy()
        other[beyond] = rng.permutation(other[beyond])
        made = [
            describe(as_image(v), at([[80, 80]], radius, 0.8), radius=radius, spread=radius / 2)
            for v in (amplitude, other)
        ]
        agreed[reach] = agreement(*made)
    assert agreed[radius + 3] > 0.985
    assert agreed[0.5 * radius] < 0.95


def test_nothing_in_nothing_out(sar_texture: Texture) -> None:
    for features in (Features.empty(), at([[0.0, 0.0]])):
        found = describe(as_image(sar_texture()), features)
        assert len(found) == 0
        assert found.descriptors is not None
        assert found.descriptors.shape == (0, 32)
        assert found.index is not None


def test_unlike_points_have_unlike_bits(sar_texture: Texture) -> None:
    found = bits(describe(as_image(sar_texture(300, 300)), at(inner_points((300, 300), 200)))).astype(int)
    distance = np.abs(found[::2] - found[1::2]).mean(axis=1)
    assert distance.mean() > 0.35


@pytest.mark.parametrize(
    "parameters",
    [
        {"bits": 0},
        {"bits": 100},
        {"radius": 0.0},
        {"radius": 101.0},
        {"radius": 1.0},
        {"radius": 2.0},  # no two samples can be two pixels apart
        {"radius": float("nan")},
        {"spread": 0.0},
        {"spread": 1e-3},
        {"factor": 1.0},
        {"levels": 0},
        {"sigma": -1.0},
    ],
    ids=str,
)
def test_impossible_parameters_are_refused_when_the_descriptor_is_made(parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create("descriptor", "brief", **parameters)
