"""What plugins of each kind are held to: a check yields a complaint for everything that is not as it should be."""

from __future__ import annotations

import inspect
import pickle
import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from featreg import registry
from featreg.errors import FeatregError, ParameterError
from featreg.interfaces import Detector
from featreg.io import as_image
from featreg.testing.material import (
    apart,
    context,
    empty_images,
    features_of,
    keypoints,
    same,
    shifted_pair,
    texture,
    tie_points,
    work,
)
from featreg.types import Features, Image, Matches

#: Px between points that count as the same.
NEAR = 1.0


class Plugin(NamedTuple):
    """What is under test: how to make it, and one that was made."""

    entry: registry.Entry
    make: Callable[..., Any]
    made: Any


Check = Callable[[Plugin], Iterator[str]]


# Of every kind


def _parameters(plugin: Plugin) -> Iterator[str]:
    fresh = plugin.entry.factory()
    for key, default in plugin.entry.parameters.items():
        if getattr(fresh, key, None) != default:
            yield f"parameter '{key}' is not kept under its own name"
        if isinstance(default, int | float) and not isinstance(default, bool):
            try:
                plugin.make(**{key: "many"})
            except ParameterError:
                continue
            yield f"parameter '{key}' takes 'many' for a number: annotate it"


def _documented(plugin: Plugin) -> Iterator[str]:
    if inspect.isclass(plugin.entry.factory):
        lines = re.findall(r"^([a-z_0-9, ]+) : ", inspect.getdoc(plugin.entry.factory) or "", re.M)
        said = {name.strip() for line in lines for name in line.split(",")}
        if missing := set(plugin.entry.parameters) - said:
            yield f"its docstring does not say what {', '.join(sorted(missing))} mean: 'name : meaning' a line"
    if not plugin.entry.summary:
        yield "its docstring has no first line"


def _repeatable(plugin: Plugin) -> Iterator[str]:
    kind, first = plugin.entry.kind, work(plugin.entry.kind, plugin.made)
    if not same(first, work(kind, plugin.made)):
        yield "a second run gives another result"
    if not same(first, work(kind, plugin.make())):
        yield "a second instance gives another result"
    with ThreadPoolExecutor(2) as pool:
        both = [future.result() for future in [pool.submit(work, kind, plugin.made) for _ in range(2)]]
    if not all(same(first, one) for one in both):
        yield "two threads at a time give another result"


def _pickled(plugin: Plugin) -> Iterator[str]:
    again = pickle.loads(pickle.dumps(plugin.made))
    before = dict(vars(again))
    if not same(work(plugin.entry.kind, again), work(plugin.entry.kind, plugin.made)):
        yield "a pickled copy gives another result"
    if vars(again).keys() != before.keys() or any(vars(again)[key] is not value for key, value in before.items()):
        yield "it keeps results on itself"


# Detectors


def _best_first(plugin: Plugin) -> Iterator[str]:
    found = plugin.made.detect_features(as_image(texture(180, 190)))
    if not len(found):
        yield "it finds nothing on an image of fields, buildings and speckle"
        return
    if not ((found.xy >= 0) & (found.xy <= [189, 179])).all():
        yield "points lie outside the image"
    if not (np.diff(found.score) <= 0).all():
        yield "points are not in the order of their score, best first"
    if not (found.scale > 0).all():
        yield "the radius of a point's support, scale, is not positive"
    if "n_features" in plugin.entry.parameters:
        few = plugin.make(n_features=5).detect_features(as_image(texture(180, 190)))
        if not 0 < len(few) <= 5:
            yield f"n_features=5 gives {len(few)} points"
    if type(plugin.made).detect_places is not Detector.detect_places:
        image = as_image(texture(180, 190))
        places, some = plugin.made.detect_places(image), np.arange(0, len(found), 3)
        if not np.array_equal(places.xy, found.xy):
            yield "detect_places gives other points than detect_features"
        elif not np.array_equal(plugin.made.oriented(image, places.take(some)).angle, found.angle[some]):
            yield "oriented gives points of detect_places other angles than detect_features"


def _all_points(plugin: Plugin, image: Image) -> Features:
    most = {"n_features": 100_000} if "n_features" in plugin.entry.parameters else {}
    found: Features = plugin.make(**most).detect_features(image)
    return found


def _mirrored(plugin: Plugin) -> Iterator[str]:
    # Odd, so that every third pixel mirrors onto every third.
    whole, mirrored = (_all_points(plugin, as_image(a)) for a in (texture(181, 181), texture(181, 181)[:, ::-1]))
    there = mirrored.xy * [-1, 1] + [180, 0]
    if not len(whole):
        yield "it finds nothing"
        return
    distance, partner = apart(whole.xy, there)
    near = distance < 1.5 * NEAR  # half a pixel of slip shows twice
    if not near.mean() > 0.8:
        yield f"the mirror image has {100 * near.mean():.0f} % of the mirrored points, 80 % are expected"
        return
    x, y = (there[partner] - whole.xy)[near].mean(axis=0)
    if max(abs(x), abs(y)) > 0.05:
        yield f"points of the mirror image are off by ({x:+.2f}, {y:+.2f}) px: is the centre of the first pixel (0, 0)?"


def _shifted(plugin: Plugin) -> Iterator[str]:
    a = texture(220, 220)
    first, second = (_all_points(plugin, as_image(part)) for part in (a[:190, :190], a[12:202, 20:210]))
    inner = first.xy[((first.xy > [60, 52]) & (first.xy < 150)).all(axis=1)]
    if not len(inner):
        yield "it finds nothing in the middle of the image"
        return
    again = (apart(inner - [20, 12], second.xy)[0] < NEAR).mean()
    if not again > 0.6:
        yield f"a view moved by (20, 12) px has {100 * again:.0f} % of the points again, 60 % are expected"


def _same_under_gain(plugin: Plugin) -> Iterator[str]:
    one, other = (_all_points(plugin, as_image(texture(180, 190) * np.float32(gain))) for gain in (1, 1000))
    if not all((apart(a.xy, b.xy)[0] < 0.1).mean() > 0.97 for a, b in ((one, other), (other, one)) if len(a)):
        yield "an image 1000 times as bright has other points"


def _nodata(plugin: Plugin) -> Iterator[str]:
    amplitude = texture(220, 230)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[90:110, 100:130] = False
    mask[:, :40] = False
    found = _all_points(plugin, as_image(amplitude, mask=mask))
    # An image holds 0 where it has no data: whoever takes that for data finds the edges of the holes.
    distance, _ = apart(found.xy, np.argwhere(~mask)[:, ::-1].astype(np.float64))
    if not (distance >= found.scale - 1.0).all():
        yield "the support (scale) of points reaches over pixels without data"


def _nothing_to_detect(plugin: Plugin) -> Iterator[str]:
    for what, image in empty_images():
        if plugin.made.detect_features(image).xy.shape != (0, 2):
            yield f"{what} has points"
    for shape in ((16, 16), (16, 300), (33, 20)):
        noise = np.random.default_rng(0).gamma(4, 0.25, shape)
        xy = plugin.made.detect_features(as_image(noise)).xy
        if not ((xy >= 0) & (xy <= np.array(shape[::-1]) - 1)).all():
            yield f"points lie outside an image of {shape[0]} x {shape[1]}"


# Descriptors


def _found_again(plugin: Plugin) -> Iterator[str]:
    amplitude, points = texture(240, 240), keypoints((200, 200), 60)
    moved = Features(points.xy + np.array([20.0, 12.0]), points.scale, points.angle, points.score, points.level)
    a = plugin.made.describe_features(as_image(amplitude[12:212, 20:220]), points)
    b = plugin.made.describe_features(as_image(amplitude), moved)
    pairs, _ = registry.create("nearest", "brute-force").match_features(a, b)
    right = np.hypot(*(a.xy[pairs[:, 0]] + [20, 12] - b.xy[pairs[:, 1]]).T) < 0.1
    if not (len(pairs) > 25 and right.mean() > 0.9):
        yield f"of 60 points in a view moved by (20, 12) px {int(right.sum())} of {len(pairs)} matches are right"


def _descriptors_under_gain(plugin: Plugin) -> Iterator[str]:
    points = keypoints((180, 190))
    a, b = (plugin.made.describe_features(as_image(texture(180, 190) * np.float32(g)), points) for g in (1, 1000))
    if a.descriptors is None or len(a) != len(b):
        yield "an image 1000 times as bright has other points described"
    elif a.norm == "hamming":
        if not (np.unpackbits(a.descriptors, axis=1) == np.unpackbits(b.descriptors, axis=1)).mean() > 0.97:
            yield "an image 1000 times as bright has other descriptors"
    elif np.median(np.linalg.norm(a.descriptors - b.descriptors, axis=1)) > 0.1 * np.median(
        np.linalg.norm(a.descriptors, axis=1)
    ):
        yield "an image 1000 times as bright has other descriptors"


def _index(plugin: Plugin) -> Iterator[str]:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-5, 200, (80, 2))
    everywhere = Features(xy, np.full(80, 8.0), np.zeros(80), np.arange(80.0), np.zeros(80, np.int64))
    found = plugin.made.describe_features(as_image(texture(180, 190)), everywhere)
    if found.index is None and len(found) != 80:
        yield "points were left out, and `index` does not say which were kept"
    elif found.index is not None and not np.allclose(found.xy, xy[found.index], atol=1e-4):
        yield "`index` does not name the points that were kept"


def _nothing_to_describe(plugin: Plugin) -> Iterator[str]:
    none = plugin.made.describe_features(as_image(texture(180, 190)), Features.empty())
    if len(none) or (none.descriptors is not None and len(none.descriptors)):
        yield "no points have descriptors"
    point = Features(np.full((1, 2), 8.0), np.ones(1), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
    for shape in ((80, 90), (16, 16)):
        for what, image in empty_images(shape):
            found = plugin.made.describe_features(image, point)
            if found.descriptors is not None and not np.isfinite(np.asarray(found.descriptors, np.float64)).all():
                yield f"{what} has descriptors that are not finite"


# Nearest


def _finds_itself(plugin: Plugin) -> Iterator[str]:
    order = np.random.default_rng(1).permutation(60)
    for dtype in (np.uint8, np.float32):
        values = np.random.default_rng(0).integers(0, 256, (60, 32)).astype(dtype)
        described = features_of(values)
        pairs, score = plugin.made.match_features(described, described.take(order))
        # A test among neighbours may leave out those at the rim of the set.
        if len(pairs) < 30 or not (order[pairs[:, 1]] == pairs[:, 0]).all():
            yield f"descriptors of {np.dtype(dtype).name} do not find themselves"
        if score.shape != (len(pairs),) or not np.isfinite(score).all():
            yield "the score must be one finite number a pair"


def _no_descriptors(plugin: Plugin) -> Iterator[str]:
    for n, m in ((0, 5), (5, 0), (0, 0)):
        pairs, score = plugin.made.match_features(*(features_of(np.zeros((k, 32), np.uint8)) for k in (n, m)))
        if (pairs.shape, score.shape) != ((0, 2), (0,)):
            yield f"{n} and {m} descriptors give pairs of shape {pairs.shape}, not (0, 2)"
    try:
        plugin.made.match_features(features_of(np.zeros((3, 32), np.uint8)), features_of(np.zeros((3, 32), np.float32)))
    except FeatregError:
        return
    yield "descriptors of two kinds must be refused with a FeatregError"


# Filters


def _keeps_a_warp(plugin: Plugin) -> Iterator[str]:
    matches, good = tie_points(1500, 500)
    kept = plugin.made.keep(matches, context())
    if kept.dtype != np.bool_ or kept.shape != (len(matches),):
        yield f"it must give one bool a match, got {kept.dtype} of shape {kept.shape}"
        return
    if not kept[good].mean() > 0.8:
        yield f"it keeps {100 * kept[good].mean():.0f} % of what an affine map explains, 80 % are expected"
    if not kept[~good].mean() < 0.05:
        yield f"it keeps {100 * kept[~good].mean():.0f} % of what is placed at random, at most 5 % are expected"
    equal = Matches(matches.reference_xy, matches.secondary_xy, np.ones(len(matches)))
    if not plugin.made.keep(equal, context())[good].mean() > 0.8:
        yield "where all scores are equal it keeps less than 80 % of what an affine map explains"


def _few_matches(plugin: Plugin) -> Iterator[str]:
    for count in (0, 1, 2, 3, 5):
        shape = plugin.made.keep(tie_points(300, 200)[0].take(np.arange(count)), context()).shape
        if shape != (count,):
            yield f"{count} matches give a mask of shape {shape}"
    xy = np.full((50, 2), 100.0)
    if plugin.made.keep(Matches(xy, xy, np.ones(50)), context()).shape != (50,):
        yield "50 matches at one place do not give 50 bools"


# Matchers


def _inside_and_right(plugin: Plugin) -> Iterator[str]:
    pair = shifted_pair()
    found = plugin.made.match(as_image(pair.reference), as_image(pair.secondary))
    if not len(found):
        yield "it finds nothing between two dates moved by (3, -2) px"
        return
    for xy in (found.reference_xy, found.secondary_xy):
        if not ((xy >= -0.5) & (xy <= 239.5)).all():
            yield "tie points lie outside the image"
    error = np.hypot(*(found.secondary_xy - found.reference_xy @ pair.truth[:, :2].T - pair.truth[:, 2]).T)
    if not (error < 2).mean() > 0.3:
        yield f"{100 * (error < 2).mean():.0f} % of its tie points are within 2 px of the truth, 30 % are expected"


def _nothing_to_match(plugin: Plugin) -> Iterator[str]:
    for what, image in empty_images((120, 120)):
        found = plugin.made.match(image, image)
        if found.reference_xy.shape[1:] != (2,):
            yield f"{what} gives tie points of shape {found.reference_xy.shape}"


EVERY: Mapping[str, Check] = {
    "parameters": _parameters,
    "docstring": _documented,
    "same bits again": _repeatable,
    "pickled": _pickled,
}
#: Checks that a network with trained weights need not pass.
SYMMETRY = ("mirror image", "shifted view")
OF_KIND: Mapping[str, Mapping[str, Check]] = {
    "detector": {
        "points": _best_first,
        "mirror image": _mirrored,
        "shifted view": _shifted,
        "gain": _same_under_gain,
        "nodata": _nodata,
        "nothing there": _nothing_to_detect,
    },
    "descriptor": {
        "found again": _found_again,
        "gain": _descriptors_under_gain,
        "index": _index,
        "nothing there": _nothing_to_describe,
    },
    "nearest": {"finds itself": _finds_itself, "nothing there": _no_descriptors},
    "filter": {"known warp": _keeps_a_warp, "few matches": _few_matches},
    "matcher": {"known shift": _inside_and_right, "nothing there": _nothing_to_match},
}
