"""What every plugin must do, whoever wrote it: one set of tests over all that are registered."""

from __future__ import annotations

import inspect
import pickle
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import FeatregError, InputError, ParameterError
from featreg.geometry import Affine
from featreg.interfaces import FilterContext
from featreg.io import as_image
from featreg.types import Features, Image, Matches

Texture = Callable[..., NDArray[np.float32]]
KINDS = ("detector", "descriptor", "nearest", "filter")
# Matches the features that it was trained on only: tests/interop/test_weights.py.
OF_ITS_OWN = ("kornia-lightglue", "opencv-lightglue")
# Networks with trained weights promise no symmetry.
TRAINED = ("kornia-aliked", "kornia-dedode", "kornia-disk", "kornia-keynet", "kornia-xfeat")
EVERY = [(kind, name) for kind in KINDS for name in registry.available(kind) if name not in OF_ITS_OWN]
every = pytest.mark.parametrize(("kind", "name"), EVERY, ids=[f"{k}:{n}" for k, n in EVERY])
PLUGINS = [*EVERY, *(("matcher", name) for name in registry.available("matcher"))]
with_matchers = pytest.mark.parametrize(("kind", "name"), PLUGINS, ids=[f"{k}:{n}" for k, n in PLUGINS])
detectors = pytest.mark.parametrize("name", registry.available("detector"))
descriptors = pytest.mark.parametrize("name", registry.available("descriptor"))
filters = pytest.mark.parametrize("name", registry.available("filter"))
nearests = pytest.mark.parametrize("name", [n for n in registry.available("nearest") if n not in OF_ITS_OWN])
symmetric = pytest.mark.parametrize("name", [n for n in registry.available("detector") if n not in TRAINED])
MATRIX = np.array([[1.01, 0.03, 5.0], [-0.03, 1.0, -4.0]])
CONTEXT_SHAPE = (400, 400)
# Some of OpenCV's detectors are themselves not symmetric: their pyramids sample every second pixel from the left.
LEAST_MIRRORED = {"harris-laplace": 0.4, "msd": 0.5}
# AdaLAM wants six neighbours that agree, which those at the rim of a sparse set do not have.
LEAST_FOUND = {"kornia-adalam": 45}
LEAST_SHIFTED = {"star": 0.3, "blob": 0.3}


def flat(height: int = 80, width: int = 90, value: float = 3.0) -> Image:
    return Image(np.full((height, width), value, np.float32), np.ones((height, width), np.bool_))


def detect(name: str, image: Image, **parameters: Any) -> Features:
    return registry.create("detector", name, **parameters).detect_features(image)


def keypoints(shape: tuple[int, int], n: int = 40) -> Features:
    """Points far from the border, of the size that suits most descriptors."""
    rng = np.random.default_rng(0)
    xy = np.column_stack([rng.uniform(45, shape[1] - 45, n), rng.uniform(45, shape[0] - 45, n)])
    return Features(xy, np.full(n, 8.0), rng.uniform(0, 6, n), np.ones(n), np.zeros(n, np.int64))


def describe(name: str, image: Image, features: Features) -> Features:
    return registry.create("descriptor", name).describe_features(image, features)


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit: arrays, tuples of arrays, dataclasses of arrays."""
    if isinstance(a, tuple):
        return all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, Features):
        return all(same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    return bool(np.array_equal(a, b)) if isinstance(a, np.ndarray) else a == b


def bits(features: Features) -> NDArray[np.uint8]:
    return np.unpackbits(np.asarray(features.descriptors, np.uint8), axis=1)


def tie_points(good: int = 300, bad: int = 200, seed: int = 0) -> tuple[Matches, NDArray[np.bool_]]:
    rng = np.random.default_rng(seed)
    here = rng.uniform(60, 340, (good + bad, 2))
    there = here @ MATRIX[:, :2].T + MATRIX[:, 2] + rng.normal(0, 0.3, here.shape)
    there[good:] = rng.uniform(0, 399, (bad, 2))
    order = rng.permutation(good + bad)
    score = np.where(np.arange(good + bad) < good, rng.uniform(0.3, 1, good + bad), rng.uniform(0, 0.7, good + bad))
    return Matches(here[order], there[order], score[order]), (np.arange(good + bad) < good)[order]


def context(seed: int = 0) -> FilterContext:
    return FilterContext(CONTEXT_SHAPE, CONTEXT_SHAPE, Affine, np.random.default_rng(seed))


def apart(xy: NDArray[np.float64], others: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distance of each point to the nearest of the others, and which that is."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(others).query(xy)
    return np.asarray(distance), np.asarray(nearest, np.int64)


RESULTS: dict[tuple[str, str], Any] = {}


def first_result(kind: str, name: str, texture: Texture) -> Any:
    """What a fresh plugin makes of the fixed input, computed once for all tests."""
    if (kind, name) not in RESULTS:
        RESULTS[kind, name] = work(kind, registry.create(kind, name), texture)  # type: ignore[call-overload]
    return RESULTS[kind, name]


def work(kind: str, plugin: Any, texture: Texture) -> Any:
    """One run of any plugin on fixed input."""
    if kind == "detector":
        return plugin.detect_features(as_image(texture(150, 160)))
    if kind == "descriptor":
        return plugin.describe_features(as_image(texture(150, 160)), keypoints((150, 160)))
    if kind == "nearest":
        rng = np.random.default_rng(0)
        packed = [rng.integers(0, 256, (n, 32)).astype(np.uint8) for n in (90, 80)]
        return plugin.match_features(*(described(p) for p in packed))
    return plugin.keep(tie_points()[0], context())


def described(descriptors: NDArray[Any], xy: NDArray[np.float64] | None = None) -> Features:
    n = len(descriptors)
    norm = "hamming" if descriptors.dtype == np.uint8 else "l2"
    xy = np.zeros((n, 2)) if xy is None else xy
    return Features(xy, np.ones(n), np.zeros(n), np.ones(n), np.zeros(n, np.int64), descriptors, norm)


# All kinds


@every
def test_parameters_are_kept_under_their_own_names_and_documented(kind: str, name: str) -> None:
    entry = registry.entry(kind, name)
    made = registry.create(kind, name)  # type: ignore[call-overload]
    for key, default in entry.parameters.items():
        assert getattr(made, key) == default, key
    if inspect.isclass(entry.factory):
        lines = re.findall(r"^([a-z_0-9, ]+) : ", inspect.getdoc(entry.factory) or "", re.M)
        assert {n.strip() for line in lines for n in line.split(",")} >= set(entry.parameters)


@every
def test_a_second_run_and_a_second_instance_give_the_same_bits(kind: str, name: str, sar_texture: Texture) -> None:
    other = registry.create(kind, name)  # type: ignore[call-overload]
    for _ in range(2):
        assert same(work(kind, other, sar_texture), first_result(kind, name, sar_texture))


@every
def test_two_threads_give_the_same_bits(kind: str, name: str, sar_texture: Texture) -> None:
    made = registry.create(kind, name)  # type: ignore[call-overload]
    alone = first_result(kind, name, sar_texture)
    with ThreadPoolExecutor(2) as pool:
        together = [f.result() for f in [pool.submit(work, kind, made, sar_texture) for _ in range(2)]]
    assert same(alone, together[0])
    assert same(alone, together[1])


@every
def test_plugins_can_be_pickled_and_hold_no_results(kind: str, name: str, sar_texture: Texture) -> None:
    made = registry.create(kind, name)  # type: ignore[call-overload]
    again = pickle.loads(pickle.dumps(made))
    assert vars(again) == vars(made)
    assert same(work(kind, again, sar_texture), first_result(kind, name, sar_texture))
    assert vars(again) == vars(made)


@every
def test_values_of_the_wrong_type_are_refused(kind: str, name: str) -> None:
    for key, default in registry.entry(kind, name).parameters.items():
        if isinstance(default, int | float) and not isinstance(default, bool):
            with pytest.raises(ParameterError):
                registry.create(kind, name, **{key: "many"})  # type: ignore[call-overload]


@with_matchers
def test_values_beyond_what_is_declared_are_refused_whoever_constructs(kind: str, name: str) -> None:
    entry = registry.entry(kind, name)
    makers: list[Callable[..., Any]] = [lambda **given: registry.create(kind, name, **given)]  # type: ignore[call-overload]
    makers += [entry.factory] if isinstance(entry.factory, type) else []
    for key, parameter in entry.declared.items():
        assert parameter.allows(parameter.default), key
        beyond: list[Any] = ["no such choice", None] if parameter.choices else []
        beyond += [-np.inf, np.inf, np.nan] if parameter.kind is float else []
        beyond += [-(10**9), 10**9, 1.5, True] if parameter.kind is int else []
        for value in beyond:
            for make in makers if not parameter.allows(value) else []:
                with pytest.raises(ParameterError, match=re.escape(f"'{name}.{key}' must be ")):
                    make(**{key: value})


@with_matchers
def test_numbers_of_our_own_have_a_declared_range_and_a_meaning(kind: str, name: str) -> None:
    entry = registry.entry(kind, name)
    if isinstance(entry.factory, type):
        free = [key for key, one in entry.declared.items() if one.kind in (int, float) and not one.bounds]
        assert free == (["chance"] if name == "target-centroids" else [])
        assert all(one.meaning for one in entry.declared.values())


# Detectors


@detectors
def test_points_lie_in_the_image_best_first(name: str, sar_texture: Texture) -> None:
    image = as_image(sar_texture(180, 190))
    found = detect(name, image)
    assert len(found) > 0
    assert ((found.xy >= 0) & (found.xy <= [189, 179])).all()
    assert (np.diff(found.score) <= 0).all()
    assert (found.scale > 0).all()
    few = detect(name, image, n_features=5)
    assert 0 < len(few) <= 5


@symmetric
def test_the_mirror_image_has_mirrored_points(name: str, sar_texture: Texture) -> None:
    amplitude = sar_texture(181, 181)  # odd, so that every third pixel mirrors onto every third
    whole = detect(name, as_image(amplitude), n_features=100000)
    mirrored = detect(name, as_image(amplitude[:, ::-1]), n_features=100000)
    there = mirrored.xy * [-1, 1] + [180, 0]
    distance, partner = apart(whole.xy, there)
    near = distance < 1.0
    assert near.mean() > LEAST_MIRRORED.get(name, 0.8)
    offset = (there[partner] - whole.xy)[near].mean(axis=0)
    # A half-pixel slip would show twice. MSD's positions on its coarse scales are OpenCV's, and off by up to 2 px.
    np.testing.assert_allclose(offset, 0, atol=0.4 if name == "msd" else 0.05)


@symmetric
def test_a_shifted_view_has_shifted_points(name: str, sar_texture: Texture) -> None:
    amplitude = sar_texture(220, 220)
    first = detect(name, as_image(amplitude[:190, :190]), n_features=100000)
    second = detect(name, as_image(amplitude[12:202, 20:210]), n_features=100000)
    inner = first.xy[((first.xy > [60, 52]) & (first.xy < 150)).all(axis=1)]
    assert len(inner) > 1
    assert (apart(inner - [20, 12], second.xy)[0] < 1.0).mean() > LEAST_SHIFTED.get(name, 0.6)


@detectors
def test_gain_does_not_move_the_points(name: str, sar_texture: Texture) -> None:
    amplitude = sar_texture(180, 190)
    first, second = (detect(name, as_image(amplitude * np.float32(g)), n_features=100000) for g in (1, 1000))
    assert abs(len(first) - len(second)) <= 0.02 * len(first) + 1
    assert (apart(first.xy, second.xy)[0] < 0.1).mean() > 0.97


@detectors
def test_no_support_touches_nodata(name: str, sar_texture: Texture) -> None:
    amplitude = sar_texture(220, 230)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[90:110, 100:130] = False
    mask[:, :40] = False
    found = detect(name, as_image(amplitude, mask=mask), n_features=100000)
    assert len(found) > 0
    distance, _ = apart(found.xy, np.argwhere(~mask)[:, ::-1].astype(np.float64))
    assert (distance >= found.scale - 1.0).all()  # to the pixel in which the point lies
    other = detect(name, as_image(np.where(mask, amplitude, 77.0), mask=mask), n_features=100000)
    np.testing.assert_array_equal(found.xy, other.xy)


@detectors
@pytest.mark.parametrize("shape", [(16, 16), (17, 40), (80, 90)])
def test_images_without_content_have_no_points(name: str, shape: tuple[int, int]) -> None:
    for image in (flat(*shape), flat(*shape, value=0.0), Image(np.zeros(shape, np.float32), np.zeros(shape, np.bool_))):
        found = detect(name, image)
        assert found.xy.shape == (0, 2)


@detectors
@pytest.mark.parametrize("shape", [(16, 16), (16, 300), (33, 20)])
def test_small_images_do_not_break(name: str, shape: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).gamma(4, 0.25, shape)
    found = detect(name, as_image(noise))
    assert ((found.xy >= 0) & (found.xy <= np.array(shape[::-1]) - 1)).all()


# Descriptors


@descriptors
def test_descriptors_tell_points_apart_and_find_them_again(name: str, sar_texture: Texture) -> None:
    """The same points in a view moved by (20, 12) px."""
    amplitude = sar_texture(240, 240)
    points = keypoints((200, 200), 60)
    moved = Features(points.xy + np.array([20.0, 12.0]), points.scale, points.angle, points.score, points.level)
    a = describe(name, as_image(amplitude[12:212, 20:220]), points)
    b = describe(name, as_image(amplitude), moved)
    pairs, _ = registry.create("nearest", "brute-force").match_features(a, b)
    assert len(pairs) > 25
    right = np.hypot(*(a.xy[pairs[:, 0]] + [20, 12] - b.xy[pairs[:, 1]]).T) < 0.1
    assert right.mean() > (0.1 if name == "lucid" else 0.9)  # the order of few grey values hardly tells speckle apart


@descriptors
def test_descriptors_do_not_change_with_the_gain(name: str, sar_texture: Texture) -> None:
    amplitude = sar_texture(180, 190)
    a, b = (describe(name, as_image(amplitude * np.float32(g)), keypoints((180, 190))) for g in (1, 1000))
    assert a.descriptors is not None
    assert b.descriptors is not None
    assert len(a) == len(b) > 0
    if a.norm == "hamming":
        assert (bits(a) == bits(b)).mean() > 0.97
    else:
        error = np.linalg.norm(a.descriptors - b.descriptors, axis=1)
        assert np.median(error / np.maximum(np.linalg.norm(a.descriptors, axis=1), 1e-9)) < 0.1


@descriptors
def test_the_index_names_the_points_that_were_kept(name: str, sar_texture: Texture) -> None:
    rng = np.random.default_rng(0)
    everywhere = Features(
        rng.uniform(-5, 200, (80, 2)), np.full(80, 8.0), np.zeros(80), np.arange(80.0), np.zeros(80, np.int64)
    )
    found = describe(name, as_image(sar_texture(180, 190)), everywhere)
    assert found.descriptors is not None
    assert 0 < len(found) < 80
    assert found.index is not None
    np.testing.assert_allclose(found.xy, everywhere.xy[found.index], atol=1e-4)
    np.testing.assert_array_equal(found.score, everywhere.score[found.index])


@descriptors
def test_what_lies_under_the_mask_does_not_change_descriptors(name: str, sar_texture: Texture) -> None:
    amplitude = sar_texture(180, 190)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[60:90, 60:100] = False
    a, b = (
        describe(name, as_image(np.where(mask, amplitude, v), mask=mask), keypoints((180, 190))) for v in (0.0, 50.0)
    )
    assert same(a, b)


@descriptors
def test_no_points_no_descriptors(name: str, sar_texture: Texture) -> None:
    found = describe(name, as_image(sar_texture(180, 190)), Features.empty())
    assert len(found) == 0
    assert found.descriptors is None or len(found.descriptors) == 0


@descriptors
def test_constant_and_tiny_images_do_not_break(name: str) -> None:
    for image in (flat(), flat(16, 16)):
        points = Features(np.full((1, 2), 8.0), np.ones(1), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
        found = describe(name, image, points)
        assert len(found) <= 1
        if found.descriptors is not None and found.norm == "l2":
            assert np.isfinite(found.descriptors).all()


# Nearest


@nearests
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_descriptors_find_themselves(name: str, dtype: Any) -> None:
    values = np.random.default_rng(0).integers(0, 256, (60, 32)).astype(dtype)
    order = np.random.default_rng(1).permutation(60)
    xy = np.random.default_rng(2).uniform(0, 100, (60, 2))
    a, b = described(values, xy), described(values[order], xy[order])
    pairs, score = registry.create("nearest", name).match_features(a, b)
    np.testing.assert_array_equal(order[pairs[:, 1]], pairs[:, 0])
    assert len(pairs) >= LEAST_FOUND.get(name, 60)
    assert score.shape == (len(pairs),)
    assert np.isfinite(score).all()


@nearests
@pytest.mark.parametrize(("n", "m"), [(0, 5), (5, 0), (0, 0)])
def test_no_descriptors_no_pairs(name: str, n: int, m: int) -> None:
    empty = [described(np.zeros((k, 32), np.uint8)) for k in (n, m)]
    pairs, score = registry.create("nearest", name).match_features(*empty)
    assert (pairs.shape, score.shape) == ((0, 2), (0,))


@nearests
def test_descriptors_of_two_kinds_are_refused(name: str) -> None:
    with pytest.raises(FeatregError):
        registry.create("nearest", name).match_features(
            described(np.zeros((3, 32), np.uint8)), described(np.zeros((3, 32), np.float32))
        )


# Filters


@filters
@pytest.mark.parametrize("seed", [0, 1])
def test_filters_keep_a_known_warp_and_drop_the_rest(name: str, seed: int) -> None:
    matches, good = tie_points(1500, 500, seed)
    kept = registry.create("filter", name).keep(matches, context(seed))
    assert kept.dtype == np.bool_
    assert kept[good].mean() > 0.8
    assert kept[~good].mean() < 0.05


@filters
@pytest.mark.parametrize("count", [0, 1, 2, 3, 5])
def test_few_matches_give_a_mask_of_their_length(name: str, count: int) -> None:
    matches = tie_points()[0].take(np.arange(count))
    assert registry.create("filter", name).keep(matches, context()).shape == (count,)


@filters
def test_filters_survive_matches_that_coincide(name: str) -> None:
    xy = np.full((50, 2), 100.0)
    assert registry.create("filter", name).keep(Matches(xy, xy, np.ones(50)), context()).shape == (50,)


@filters
def test_a_score_of_no_meaning_does_not_matter(name: str) -> None:
    matches, good = tie_points(1500, 300)
    equal = Matches(matches.reference_xy, matches.secondary_xy, np.ones(len(matches)))
    kept = registry.create("filter", name).keep(equal, context())
    assert kept[good].mean() > 0.8


# OpenCV's manners


def tiles() -> dict[str, tuple[NDArray[Any], NDArray[np.uint8] | None]]:
    """Arrays on which there is nothing to find, and their masks."""
    noise = np.random.default_rng(0).gamma(4, 0.25, (64, 64)).astype(np.float32)
    return {
        "blank": (np.full((64, 64), 3, np.float32), None),
        "all masked": (noise, np.zeros((64, 64), np.uint8)),
        "10 x 10": (noise[:10, :10], None),
        "1 x 1": (noise[:1, :1], np.full((1, 1), 255, np.uint8)),
        "no data": (np.full((64, 64), np.nan, np.float32), None),
    }


@detectors
def test_detecting_on_nothing_finds_nothing(name: str) -> None:
    made = featreg.extractor(name)
    for what, (array, mask) in tiles().items():
        assert made.detect(array, mask) == [], what
        assert made.detector.detect(array, mask) == [], what
        assert featreg.extractor(name, "brief").detectAndCompute(array, mask) == ([], None), what


@descriptors
def test_describing_on_nothing_gives_nothing(name: str) -> None:
    made = featreg.extractor("fast", name)
    points = keypoints((120, 120), 5).to_keypoints()
    for what, (array, mask) in tiles().items():
        assert made.detectAndCompute(array, mask) == ([], None), what
        if what != "all masked":  # OpenCV's compute knows no mask
            assert made.compute(array, points) == ([], None), what
    assert made.compute(np.random.default_rng(0).gamma(4, 0.25, (64, 64)), []) == ([], None)


@detectors
def test_an_array_of_no_image_and_a_mask_of_another_size_are_refused(name: str) -> None:
    made = featreg.extractor(name)
    noise = np.random.default_rng(0).gamma(4, 0.25, (64, 64))
    for array, mask in (
        (np.stack([noise] * 3, axis=2), None),
        (np.full((10, 10, 3), 7, np.uint8), None),
        (noise, np.ones((64, 63), np.uint8)),
        (noise[:10, :10], np.ones((64, 64), np.uint8)),
        (np.full((64, 64), "a"), None),
    ):
        with pytest.raises(InputError):
            made.detect(array, mask)


@descriptors
def test_the_form_of_descriptors_is_known_before_they_are_made(name: str, sar_texture: Texture) -> None:
    made = featreg.extractor("fast", name)
    form = (made.defaultNorm(), made.descriptorSize(), made.descriptorType())
    found = describe(name, as_image(sar_texture(150, 160)), keypoints((150, 160)))
    assert found.descriptors is not None
    constants = (cv2.NORM_HAMMING, cv2.CV_8U) if found.norm == "hamming" else (cv2.NORM_L2, cv2.CV_32F)
    assert form == (constants[0], found.descriptors.shape[1], constants[1])
