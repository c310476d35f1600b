"""Every "-paper" parameter beside what its paper says.

Of sar-orb-paper and the OBCLS these are the paper's words, shortened, or ours where it says nothing (`SAID`). The
papers of SAR-SIFT, GOF, BFSIFT and RIFT are not at hand: what stands beside their parameters (`RETOLD`) is paraphrase
of what is known of them, so that these rows hold what was meant, not what was published.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import registry
from featreg.io import as_image
from featreg.pipeline.assembly import assemble
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.presets import PRESETS
from featreg.sar.gradients.gabor import gabor_gradients
from featreg.sar.gradients.gradient_field import GradientField
from featreg.sar.gradients.ratio import quantised_edges, ratio_gradients
from featreg.sar.keypoints.gradient_histograms import dominant_orientation, further_orientations, gloh, normalised
from featreg.sar.keypoints.harris import harris_response
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Features

# (method, part, parameter, value, what the paper says)
SAID: list[tuple[str, str, str, Any, str]] = [
    ("sar-orb-paper", "detector", "edge", "eq5", "The SAR edge image can be acquired using (5)"),
    ("sar-orb-paper", "detector", "clip", False, "Eq. 5 has no upper limit"),
    ("sar-orb-paper", "detector", "centroid", "edges", "FAST keypoints are detected at each edge layer ... centroid"),
    ("sar-orb-paper", "detector", "subpixel", "corner", "the coordinate of corner q is (7)"),
    ("sar-orb-paper", "detector", "quota_decay", 1.2, "features selected from each layer decreases with ... scale"),
    ("sar-orb-paper", "detector", "levels", 8, "ORB's pyramid"),
    ("sar-orb-paper", "detector", "factor", 1.2, "ORB's pyramid"),
    ("sar-orb-paper", "detector", "skip", 0, "the FAST keypoints are detected at each edge layer of the pyramid"),
    ("sar-orb-paper", "detector", "alpha", 2.0, "not given"),
    ("sar-orb-paper", "detector", "floor", 0.01, "departs: 1 % of the mean amplitude is added"),
    ("sar-orb-paper", "detector", "sigma", 2.0, "Gaussian weight, of which the width is not given"),
    ("sar-orb-paper", "detector", "threshold", 5, "not given"),
    ("sar-orb-paper", "descriptor", "levels", 8, "local binary descriptors of the neighborhoods of keypoints"),
    ("sar-orb-paper", "descriptor", "bits", 256, "the BRIEF approach, as in ORB"),
    ("sar-orb-paper", "descriptor", "spread", 6.2, "BRIEF: a Gaussian of a fifth of the patch of 31"),
    ("sar-orb-paper", "nearest", "mutual", False, "a brute force algorithm is adopted to roughly match"),
    ("c-obcls-paper", "matcher", "tie_points", "c", "1) centroids' positions"),
    ("cc-obcls-paper", "matcher", "tie_points", "cc", "2) peak of the complex 2D cross-correlation modulus"),
    ("rc-obcls-paper", "matcher", "tie_points", "rc", "3) peak of the real 2D cross-correlation"),
    ("rc-obcls-paper", "matcher", "cfar", "ca", "cell averaging"),
    ("rc-obcls-paper", "matcher", "pfa", 0.01, "a false alarm rate equal to 10^-2"),
    ("rc-obcls-paper", "matcher", "patch", 64, "not given"),
    ("rc-obcls-paper", "matcher", "subpixel", False, "peak of the cross-correlation"),
    ("rc-obcls-paper", "matcher", "association", "nearest", "a minimum distance criterion"),
    ("rc-obcls-paper", "matcher", "passes", 1, "no pass on an aligned image"),
    ("rc-obcls-paper", "matcher", "order", 17, "the order equal to 17 over a domain of 25 pixels"),
    ("rc-obcls-paper", "matcher", "median", 7, "a neighborhood of 7 x 7 pixels"),
]
# (method, part, parameter, value, what is known to us of papers that were not read, in our words)
RETOLD: list[tuple[str, str, str, Any, str]] = [
    ("sar-sift-paper", "detector", "alpha", 2.0, "the least alpha is 2"),
    ("sar-sift-paper", "detector", "scales", 8, "eight scales"),
    ("sar-sift-paper", "detector", "factor", 2 ** (1 / 3), "three scales an octave"),
    (
        "sar-sift-paper",
        "detector",
        "integration",
        math.sqrt(2),
        "a Gaussian of the square root of 2 times alpha smooths the matrix",
    ),
    ("sar-sift-paper", "detector", "d", 0.04, "0.04, as Harris has it"),
    ("sar-sift-paper", "detector", "floor", 0.01, "ours: 1 % of the mean amplitude is added"),
    ("sar-sift-paper", "descriptor", "step", 1 / 24, "ours: samples half an alpha apart, of a radius of 12 alpha"),
    ("sar-sift-paper", "detector", "second", 0.8, "further directions from 0.8 of the highest peak on, as in SIFT"),
    ("sar-sift-paper", "detector", "thin", False, "all eight scales, whatever the size"),
    ("sar-sift-paper", "detector", "coarse", False, "all eight scales, whatever the size"),
    ("sar-sift-paper", "detector", "subscale", False, "a keypoint has the scale at which it is a maximum"),
    ("sar-sift-paper", "detector", "support", 12.0, "a disc of 12 alpha around it"),
    ("sar-sift-paper", "detector", "exact", True, "every scale is computed on the image itself"),
    ("sar-sift-paper", "descriptor", "exact", True, "every scale is computed on the image itself"),
    ("sar-sift-paper", "descriptor", "harmonics", 4, "plain histograms of directions"),
    ("sar-sift-paper", "descriptor", "soft", False, "a pixel counts in one cell"),
    ("sar-sift-paper", "nearest", "ratio", 0.8, "the ratio test, at the value of SIFT"),
    ("s-gof-paper", "descriptor", "magnification", 6.0, "SIFT's window, which is four cells of 3 sigma wide"),
    ("s-gof-paper", "descriptor", "orientations", 6, "six directions of filters"),
    ("s-gof-paper", "descriptor", "harmonics", 4, "plain histograms of directions"),
    ("s-gof-paper", "descriptor", "exact", True, "filters in every pixel of the image itself"),
    ("s-gof-paper", "nearest", "ratio", 0.85, "ours: which ratio they take is not known to us"),
    ("m-gof-paper", "descriptor", "exact", True, "filters in every pixel of the image itself"),
    ("m-gof-paper", "descriptor", "scales", 4, "more than one scale of filters; that it is four is ours"),
    ("m-gof-paper", "descriptor", "spread", 100.0, "ours: every scale is sampled alike"),
    ("m-gof-paper", "nearest", "ratio", 0.85, "ours: which ratio they take is not known to us"),
    ("bfsift-paper", "detector", "exact", True, "bilateral filters in the place of Gaussian ones, not approximated"),
    ("bfsift-paper", "detector", "skip", 1, "the finest scale is left out; that it is one interval is our reading"),
    ("bfsift-paper", "detector", "thin", False, "no other scale is left out"),
    ("bfsift-paper", "detector", "second", 0.8, "further directions from 0.8 of the highest peak on, as in SIFT"),
    ("bfsift-paper", "detector", "orientation_scale", 1.0, "directions at the scale of the keypoint, as in SIFT"),
    ("bfsift-paper", "descriptor", "exact", True, "described in the same bilateral scale space"),
    ("bfsift-paper", "descriptor", "coarser", 1.0, "described at the scale of the keypoint, as in SIFT"),
    ("bfsift-paper", "descriptor", "harmonics", 4, "plain histograms of directions, as in SIFT"),
    ("bfsift-paper", "nearest", "mutual", True, "matches must be the best both ways"),
    ("rift-paper", "detector", "scales", 4, "four scales of log-Gabor filters"),
    ("rift-paper", "detector", "orientations", 6, "six orientations of log-Gabor filters"),
    ("rift-paper", "detector", "exact", True, "the noise of each orientation is estimated"),
    ("rift-paper", "detector", "threshold", 13, "of the authors' program: 0.05 of the greatest moment"),
    ("rift-paper", "descriptor", "exact", True, "described in the maps of the detector"),
    ("rift-paper", "descriptor", "patch", 96.0, "a window of 96 pixels"),
    ("rift-paper", "descriptor", "grid", 6, "six cells along each side of it"),
    ("rift-paper", "descriptor", "reindex", "dominant", "of RIFT2: indices are counted from the dominant one"),
]


@pytest.mark.parametrize(("method", "role", "name", "value", "sentence"), SAID, ids=[f"{s[0]}.{s[2]}" for s in SAID])
def test_a_parameter_is_what_its_paper_says(method: str, role: str, name: str, value: Any, sentence: str) -> None:
    part = getattr(PRESETS[method], role)
    given = {**registry.entry(role, part.name).parameters, **part.parameters}
    assert given[name] == pytest.approx(value), sentence


@pytest.mark.parametrize(("method", "role", "name", "value", "words"), RETOLD, ids=[f"{s[0]}.{s[2]}" for s in RETOLD])
def test_a_parameter_is_what_is_known_to_us(method: str, role: str, name: str, value: Any, words: str) -> None:
    test_a_parameter_is_what_its_paper_says(method, role, name, value, words)


def test_words_of_papers_that_were_not_read_are_no_quotations() -> None:
    read = ("sar-orb-paper", "c-obcls-paper", "cc-obcls-paper", "rc-obcls-paper")
    assert {row[0] for row in SAID} == set(read)
    assert {row[0] for row in RETOLD}.isdisjoint(read)
    assert not [row for row in RETOLD if "..." in row[4] or "=" in row[4]]


def test_a_ratio_that_is_ours_is_called_so() -> None:
    for method in ("s-gof-paper", "m-gof-paper"):
        assert "ratio of 0.85 (ours)" in PRESETS[method].summary


def test_filters_follow_the_papers() -> None:
    # "GMS ... for each small pair ... In the global scope ... FSC"
    assert [part.name for part in PRESETS["sar-orb-paper"].filters] == ["gms", "fsc"]
    # Eq. 4: MAD, "starting from kappa = 3 and reducing it until reaching 2"
    (mad,) = PRESETS["rc-obcls-paper"].filters
    assert (mad.name, mad.parameters["threshold"]) == ("mad", "mad")
    given = {**registry.entry("filter", "mad").parameters, **mad.parameters}
    assert [given[f"kappa_{name}"] for name in ("first", "last", "step")] == [3.0, 2.0, 0.25]
    assert all(not PRESETS[name].refine for name in PRESETS if name.endswith("-paper"))


FEATURE_FORMS = [name for name in PRESETS if name.endswith("-paper") and PRESETS[name].detector is not None]


@pytest.mark.parametrize("method", FEATURE_FORMS)
@pytest.mark.parametrize("blocks", [False, True])
def test_no_short_cut_of_ours_is_in_a_published_form(method: str, blocks: bool) -> None:
    """Images as they are, each feature in its own direction, matches where they were found, in blocks too."""
    made = assemble(method, n_features=100, blocks=blocks)
    matcher = made.matcher
    assert isinstance(matcher, FeatureMatcher)
    assert (matcher.pixels_per_feature, matcher.common_rotation) == (0, False)
    assert (made.locate, made.refine) == (None, None)
    # What depends on how large an image is, or how many features are asked for.
    for name in ("skip", "thin", "coarse"):
        assert not getattr(matcher.detector, name, False) or (method, name) == ("bfsift-paper", "skip")
    assert type(matcher.descriptor).__name__ in {"Brief", "RatioGloh", "GaborOdd", "BfSiftDescriptor", "MaxIndexMap"}


def part(method: str, role: str, **changed: Any) -> Any:
    """A part of a published form as the form has it."""
    found = getattr(PRESETS[method], role)
    return registry.create(role, found.name, **{**found.parameters, **changed})  # type: ignore[call-overload]  # any role


def test_the_published_direction_is_that_of_the_corner_before_it_moves(pair: SimulatedPair) -> None:
    """ "The intensity centroid is used to compute the orientation of corners obtained by FAST": 2.3.2, before 2.3.3."""
    image = as_image(pair.reference[:160, :170])
    still, moved = (part("sar-orb-paper", "detector", n_features=400, subpixel=kind) for kind in ("none", "corner"))
    found, places = moved.detect_features(image), still.detect_features(image)
    np.testing.assert_array_equal(found.angle, places.angle)
    assert (np.hypot(*(found.xy - places.xy).T) > 0.5).any()
    seen = moved.oriented(image, moved.detect_places(image))
    np.testing.assert_array_equal(seen.angle, found.angle)
    edges = quantised_edges(image, 2.0, 0.01, eq5=True, clip=False).astype(np.float64)
    dy, dx = np.mgrid[-15:16, -15:16]
    inside = dx**2 + dy**2 <= 15**2
    finest = np.flatnonzero(places.level == 0)
    assert len(finest) > 20
    for row in finest:
        x, y = np.rint(places.xy[row]).astype(int)
        disc = edges[y - 15 : y + 16, x - 15 : x + 16] * inside
        assert places.angle[row] == pytest.approx(math.atan2(-(disc * dy).sum(), (disc * dx).sum()), abs=1e-9)


def test_published_scales_are_computed_on_the_image_itself(pair: SimulatedPair) -> None:
    image = as_image(pair.reference[:300, :310])
    xy, angle = np.array([[150.2, 140.7], [155.0, 160.0]]), np.array([0.3, 2.0])
    # alpha = scale / 12, of the series 2 * 2^(k / 3): 5.04 and 10.08.
    points = Features(xy, np.array([60.0, 118.0]), angle, np.ones(2), np.zeros(2, np.int64))
    found = part("sar-sift-paper", "descriptor").describe_features(image, points).descriptors
    for n, alpha in enumerate((2 * 2 ** (4 / 3), 2 * 2 ** (7 / 3))):
        field, one = GradientField(*ratio_gradients(image, alpha, 0.01)), points.take(np.array([n]))
        wanted = normalised(gloh(field, one.xy, one.scale, one.angle, 4, 1 / 24, False))
        np.testing.assert_allclose(found[n : n + 1], wanted, atol=1e-5)
    small = replace(points, scale=np.array([5.0, 9.0]))
    field = GradientField(*gabor_gradients(image, 2.0, 6))
    np.testing.assert_allclose(
        part("s-gof-paper", "descriptor").describe_features(image, small).descriptors,
        normalised(gloh(field, xy, 6 * small.scale, angle, 4, 0.0625)),
        atol=1e-5,
    )
    features = part("sar-sift-paper", "detector").detect_features(image)
    alphas = 2 * 2 ** (np.arange(8) / 3)
    np.testing.assert_allclose(features.scale, 12 * alphas[features.level], rtol=1e-9)
    coarse = features.level == 6
    assert coarse.any()
    response = harris_response(*ratio_gradients(image, alphas[6], 0.01), math.sqrt(2) * alphas[6])
    x, y = np.rint(features.xy[coarse]).astype(int).T
    near = [response[b - 1 : b + 2, a - 1 : a + 2].max() for a, b in zip(x, y, strict=True)]
    np.testing.assert_allclose(features.score[coarse], near, rtol=1e-4)


def test_corners_take_their_direction_from_the_edges_where_the_paper_does(pair: SimulatedPair) -> None:
    image = as_image(pair.reference[:200, :200])
    ours, paper = (
        registry.create("detector", "sar-ofast", n_features=300, centroid=kind).detect_features(image)
        for kind in ("amplitude", "edges")
    )
    np.testing.assert_array_equal(ours.xy, paper.xy)
    assert np.abs(np.angle(np.exp(1j * (ours.angle - paper.angle)))).max() > 0.5


def test_unclipped_edges_leave_less_to_the_weak_ones(pair: SimulatedPair) -> None:
    image = as_image(pair.reference[:200, :200])
    counts = [
        len(registry.create("detector", "sar-ofast", n_features=50000, clip=clip).detect_features(image))
        for clip in (True, False)
    ]
    assert 0 < counts[1] < counts[0]


def test_the_finest_scale_can_be_left_out(pair: SimulatedPair) -> None:
    image = as_image(pair.reference[:160, :160])
    every, fewer = (registry.create("detector", "bf-sift", skip=skip).detect_features(image) for skip in (0, 1))
    assert every.level.min() == 0
    assert fewer.level.min() >= 1


def test_two_directions_of_equal_strength_are_two_orientations() -> None:
    """Half of the disc has gradients to the right, the other half upwards, a little weaker."""
    gx, gy = np.zeros((64, 64), np.float32), np.zeros((64, 64), np.float32)
    gx[:, :33], gy[:, 33:] = 1.0, -0.9
    at, radius = np.array([[31.5, 31.5]]), np.array([12.0])
    field = GradientField(gx, gy)
    assert dominant_orientation(field, at, radius)[0] == pytest.approx(0, abs=0.1)
    rows, angles = further_orientations(field, at, radius, 0.6)
    assert rows.tolist() == [0]
    assert angles[0] == pytest.approx(np.pi / 2, abs=0.1)
    assert len(further_orientations(field, at, radius, 0.99)[0]) == 0


def test_further_orientations_make_further_keypoints_at_the_same_places(pair: SimulatedPair) -> None:
    image = as_image(pair.reference[:200, :200])
    one, more = (
        registry.create("detector", "sar-harris", n_features=100000, second=share).detect_features(image)
        for share in (1.0, 0.8)
    )
    assert len(one) < len(more) < 2 * len(one)
    assert {tuple(p) for p in one.xy} == {tuple(p) for p in more.xy}
    few = registry.create("detector", "sar-harris", n_features=50, second=0.8).detect_features(image)
    assert len(few) == 50


@pytest.mark.parametrize("method", ["s-gof-paper", "m-gof-paper"])
def test_gabor_descriptors_see_the_window_of_sift(method: str) -> None:
    """With a radius of one sigma, 1 or 2 px, hardly anything matched."""
    pair = sar_pair((300, 300), rotation_deg=4, seed=2, looks=4)
    reg = featreg.match(pair.reference, pair.secondary, method=method, n_features=2000)
    scores = featreg.evaluate(reg, pair.truth)
    assert reg.status == "ok"
    assert scores.ncm > 40
    assert scores.precision > 0.25
