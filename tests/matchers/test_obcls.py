"""OBCLS: association, patch correlation, cancellation, and the methods on scenes of extended targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import InputError, ParameterError
from featreg.focusing.backprojection import back_project
from featreg.geometry import Rigid
from featreg.interfaces import FilterContext
from featreg.io import as_image
from featreg.products.resample import resample
from featreg.sar.obcls.alignment import aligned
from featreg.sar.obcls.association import Map, fourier_mellin, nearest, vote
from featreg.sar.obcls.cancellation import cancelled, cancelled_fit
from featreg.sar.obcls.patches import patch_shifts
from featreg.types import Matches

Floats = NDArray[np.float64]
SIZE = 320
CENTRE = np.array([[(SIZE - 1) / 2, (SIZE - 1) / 2]])


def fitted(a: Floats, b: Floats) -> Map | None:
    return Rigid.from_estimate(a, b) or None


def rigid(rotation_deg: float, shift: tuple[float, float] = (0.0, 0.0)) -> Rigid:
    """Turned about the image centre, then shifted."""
    turned = Rigid(rotation_deg)
    dx, dy = (CENTRE - turned(CENTRE))[0] + shift
    return Rigid(rotation_deg, float(dx), float(dy))


def parking(truth: Rigid, seed: int = 0, targets: int = 45, seen: float = 0.8) -> tuple[Floats, Floats]:
    """Amplitudes of two looks at bright rectangles in clutter; each look misses some and has its own speckle."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-60, SIZE + 60, (targets * 2, 2))
    # No two on one spot.
    xy = xy[[i for i in range(len(xy)) if (np.hypot(*(xy[:i] - xy[i]).T) > 24).all()]]
    angle, size = rng.uniform(0, np.pi, len(xy)), rng.uniform(3, 8, (len(xy), 2))
    shine = rng.uniform(20, 80, len(xy))
    y, x = np.mgrid[:SIZE, :SIZE]
    grid = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    looks = []
    for way in (grid, truth.inverse(grid)):
        power = np.ones(len(grid))
        for i in np.flatnonzero(rng.random(len(xy)) < seen):
            d = way - xy[i]
            along = d @ [np.cos(angle[i]), np.sin(angle[i])]
            across = d @ [-np.sin(angle[i]), np.cos(angle[i])]
            edge = np.minimum(size[i, 0] - np.abs(along), size[i, 1] - np.abs(across))
            power += shine[i] * np.clip(edge + 0.5, 0, 1)
        looks.append(np.sqrt(power * rng.gamma(2.0, 0.5, len(grid))).reshape(SIZE, SIZE))
    return looks[0], looks[1]


def errors(result: featreg.Registration, truth: Rigid) -> tuple[float, float]:
    """Degrees of rotation and pixels at the image centre."""
    model = result.model
    assert isinstance(model, Rigid)
    turn = (model.rotation_deg - truth.rotation_deg + 180) % 360 - 180
    return abs(turn), float(np.hypot(*(model(CENTRE) - truth(CENTRE))[0]))


# Methods


@pytest.mark.parametrize(("rotation", "shift"), [(0.0, (0.0, 0.0)), (7.3, (12.0, -30.0)), (-141.2, (5.4, 3.7))])
@pytest.mark.parametrize("method", ["rc-obcls", "c-obcls"])
def test_any_rotation_and_shift_are_found(method: str, rotation: float, shift: tuple[float, float]) -> None:
    truth = rigid(rotation, shift)
    result = featreg.match(*parking(truth, seed=1), method=method)
    turn, apart = errors(result, truth)
    assert (result.status, result.reason) == ("ok", "")
    assert turn < 0.15
    assert apart < 0.5


def test_the_spectra_associate_as_well() -> None:
    truth = rigid(63.4, (-8.0, 14.0))
    result = featreg.match(*parking(truth, seed=2), method="rc-obcls", association="fourier-mellin")
    assert result.status == "ok"
    assert errors(result, truth)[0] < 0.15


def test_a_secondary_turned_counter_clockwise_has_a_positive_rotation() -> None:
    first, _ = parking(rigid(0.0), seed=3)
    result = featreg.match(first, np.rot90(first), method="rc-obcls")
    assert errors(result, rigid(90.0)) == pytest.approx((0, 0), abs=0.01)


@pytest.mark.parametrize("method", ["c-obcls-paper", "rc-obcls-paper", "cls"])
def test_nearly_aligned_images_are_registered_on_the_papers_path(method: str) -> None:
    truth = rigid(1.5, (1.0, 0.0))
    result = featreg.match(*parking(truth, seed=4), method=method)
    assert errors(result, truth)[0] < 0.3


def test_cancellation_matters_and_can_be_switched_off() -> None:
    truth = rigid(4.0)
    off = []
    for seed in range(5, 9):
        pair = parking(truth, seed=seed)
        kept = featreg.match(*pair, method="rc-obcls-paper")
        everything = featreg.match(*pair, method="rc-obcls-paper", cancellation=False)
        assert everything.stages["mad"].all()
        off.append((errors(kept, truth)[0], errors(everything, truth)[0]))
    with_it, without = np.mean(off, axis=0)
    assert with_it < 0.2
    assert without > 3 * with_it


@pytest.mark.parametrize("rotation", [30.0, -75.0])
def test_the_papers_path_does_not_claim_what_it_cannot_reach(rotation: float) -> None:
    for seed in (6, 7):
        result = featreg.match(*parking(rigid(rotation), seed=seed), method="rc-obcls-paper")
        assert result.status == "unreliable"


@pytest.mark.parametrize("method", ["rc-obcls", "c-obcls"])
def test_mirrored_other_and_empty_scenes_are_not_trusted(method: str) -> None:
    first, second = parking(rigid(5.0), seed=8)
    noise = np.sqrt(np.random.default_rng(0).exponential(size=first.shape))
    for other in (second[:, ::-1], parking(rigid(0.0), seed=9)[1], noise):
        result = featreg.match(first, other, method=method)
        assert result.status == "unreliable"
        assert result.reason


@pytest.mark.parametrize("count", [0, 1, 2, 3])
@pytest.mark.parametrize(
    "method", ["rc-obcls", "c-obcls", "rc-obcls-paper", "c-obcls-paper", "cc-obcls-paper", "cls-paper"]
)
def test_too_few_targets_give_a_reason(method: str, count: int) -> None:
    looks = []
    for seed in (0, 1):
        amplitude = np.sqrt(np.random.default_rng(seed).exponential(size=(200, 200)))
        for i in range(count):
            amplitude[40 + 50 * i : 50 + 50 * i, 60:72] *= 12
        looks.append(amplitude.astype(np.complex64))
    result = featreg.match(*looks, method=method)
    assert result.status == "unreliable"
    assert result.reason


def test_identical_images_are_identical() -> None:
    first, _ = parking(rigid(0.0), seed=10)
    for method in ("rc-obcls", "rc-obcls-paper", "c-obcls", "cls"):
        assert errors(featreg.match(first, first, method=method), rigid(0.0)) == pytest.approx((0, 0), abs=0.01)


def test_the_complex_correlation_is_the_finest_where_speckle_agrees() -> None:
    rng = np.random.default_rng(11)
    truth = Rigid(0.0, 3.0, -2.0)
    amplitude, _ = parking(rigid(0.0), seed=11)
    whole = amplitude * (rng.normal(size=amplitude.shape) + 1j * rng.normal(size=amplitude.shape))
    first, second = whole[20:300, 20:300], whole[22:302, 17:297]
    result = featreg.match(first, second, method="cc-obcls", refine=False)
    assert isinstance(result.model, Rigid)
    np.testing.assert_allclose(result.model(CENTRE), truth(CENTRE), atol=0.02)


def test_parameters_reach_the_one_part_they_belong_to() -> None:
    first, second = parking(rigid(2.0), seed=12)
    parameters = featreg.match(
        first, second, method="c-obcls", association="nearest", cancellation=False, threshold="mad", passes=2, patch=32,
        subpixel=False,
    ).provenance["parameters"]  # fmt: skip
    given = {k: parameters["matcher"][k] for k in ("association", "passes", "patch", "subpixel")}
    assert given == {"association": "nearest", "passes": 2, "patch": 32, "subpixel": False}
    assert (parameters["mad"]["cancellation"], parameters["mad"]["threshold"]) == (False, "mad")
    assert parameters["model"] == "rigid"


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("target-centroids", {"tie_points": "x"}),
        ("target-centroids", {"association": "x"}),
        ("target-centroids", {"passes": 0}),
        ("target-centroids", {"patch": 2}),
        ("target-centroids", {"cfar": "x"}),
        ("target-centroids", {"median": 2}),
        ("target-centroids", {"guard": 600}),
        ("patch-grid", {"tie_points": "c"}),
        ("patch-grid", {"step": -1}),
    ],
)
def test_impossible_parameters_are_refused(name: str, wrong: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        registry.create("matcher", name, **wrong)
    with pytest.raises(ParameterError):
        registry.create("filter", "mad", threshold="x")


# Association


def test_nearest_is_mutual() -> None:
    a = np.array([[0.0, 0], [1, 0], [50, 0]])
    b = np.array([[0.8, 0], [90, 0]])
    np.testing.assert_array_equal(nearest(a, b), [[1, 0], [2, 1]])
    np.testing.assert_array_equal(nearest(a, b, 10), [[1, 0]])
    assert nearest(a, np.zeros((0, 2))).shape == (0, 2)


@pytest.mark.parametrize("rotation", [0.0, 33.3, 179.0, -90.0])
def test_the_vote_finds_true_pairs_among_as_many_false_ones(rotation: float) -> None:
    rng = np.random.default_rng(0)
    a, truth = rng.uniform(0, 500, (60, 2)), Rigid(rotation, 30.0, -80.0)
    b = np.concatenate(
        [truth(a[:30]) + rng.normal(0, 0.7, (30, 2)), rng.uniform(0, 500, (30, 2)) + truth(a).mean(0) - 250]
    )
    found = vote(a, b, fitted, (500, 500))
    assert isinstance(found.map, Rigid)
    assert abs((found.map.rotation_deg - rotation + 180) % 360 - 180) < 0.4
    true = (found.pairs[:, 0] == found.pairs[:, 1]) & (found.pairs[:, 0] < 30)
    assert true.sum() >= 26
    assert found.log10_chance < -8


def test_the_chance_of_random_targets_is_no_evidence() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        assert vote(rng.uniform(0, 500, (80, 2)), rng.uniform(0, 500, (80, 2)), fitted, (500, 500)).log10_chance > -3


def test_degenerate_targets_are_not_associated() -> None:
    line = np.column_stack([np.arange(0, 400, 60.0), np.full(7, 50.0)])
    for a in (np.zeros((0, 2)), np.zeros((1, 2)), np.zeros((5, 2)), line[:2]):
        assert vote(a, line, fitted, (400, 400)).pairs.shape == (0, 2)
    # Either way round.
    assert vote(line, line, fitted, (400, 400)).pairs.shape == (0, 2)


@pytest.mark.parametrize("rotation", [0.0, 21.7, -152.3])
def test_spectra_and_images_give_rotation_and_shift(rotation: float) -> None:
    truth = rigid(rotation, (9.0, -21.0))
    first, second = (np.log(np.maximum(look, 2)).astype(np.float32) for look in parking(truth, seed=13))
    way = fourier_mellin(first, second)[0]
    some = CENTRE + np.array([[0, 100], [100, 0]])
    assert np.hypot(*(way(some) - truth(some)).T).max() < 4
    assert fourier_mellin(np.zeros((64, 64), np.float32), np.zeros((64, 64), np.float32)) == []


# Patches and alignment


def smooth_noise(seed: int, complex_: bool) -> NDArray[np.complex128] | Floats:
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    parts = [gaussian_filter(rng.normal(size=(120, 140)), 2.0, mode="wrap") for _ in range(2)]
    return parts[0] + 1j * parts[1] if complex_ else parts[0]


@pytest.mark.parametrize("complex_", [False, True])
@pytest.mark.parametrize("padded", [False, True])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (2.3, -1.6), (9.0, 5.0)])
def test_patches_find_a_known_shift(complex_: bool, padded: bool, shift: tuple[float, float]) -> None:
    image = smooth_noise(0, complex_)
    ky, kx = np.fft.fftfreq(120)[:, None], np.fft.fftfreq(140)[None, :]
    moved = np.fft.ifft2(np.fft.fft2(image) * np.exp(-2j * np.pi * (kx * shift[0] + ky * shift[1])))
    first = image.astype(np.complex64 if complex_ else np.float32)
    second = moved.astype(np.complex64) if complex_ else moved.real.astype(np.float32)
    at = np.array([[20, 10], [50, 40], [70, 60]])
    found = patch_shifts(first, second, at, at, (48, 56), padded=padded)
    assert found.sound.all()
    # What leaves a patch pulls the peak towards no shift: that is what further passes are for.
    np.testing.assert_allclose(found.shift.mean(axis=0), shift, atol=0.1 + 0.06 * max(np.abs(shift)))
    same = patch_shifts(first, first, at, at, (48, 56), padded=padded)
    np.testing.assert_allclose(same.shift, 0, atol=1e-4)
    np.testing.assert_allclose(same.height, 1, atol=1e-5)


def test_patches_without_content_have_no_peak() -> None:
    flat, at = np.ones((50, 50), np.float32), np.array([[5, 5]])
    found = patch_shifts(flat, flat, at, at, (20, 20))
    assert not found.sound.any()
    assert found.height[0] == 0
    noise = np.random.default_rng(0).random((50, 50)).astype(np.float32)
    nowhere = np.zeros((50, 50), np.bool_)
    assert not patch_shifts(noise, noise, at, at, (20, 20), first_valid=nowhere).sound.any()
    assert patch_shifts(noise, noise, at[:0], at[:0], (20, 20)).shift.shape == (0, 2)


def test_complex_images_keep_their_carrier_when_aligned() -> None:
    """A carrier that plain interpolation would destroy."""
    y, x = np.mgrid[:90, :90]
    wave = np.exp(1j * (2.4 * x - 1.9 * y)).astype(np.complex64)
    matrix = Rigid(10.0, 3.3, 18.4).matrix[:2]
    moved, inside = aligned(wave, np.ones(wave.shape, np.bool_), matrix, (60, 60))
    sx, sy = (matrix[i, 0] * x[:60, :60] + matrix[i, 1] * y[:60, :60] + matrix[i, 2] for i in (0, 1))
    inner = inside & (sx > 3) & (sy > 3) & (sx < 86) & (sy < 86)
    assert inner.sum() > 2000
    np.testing.assert_allclose(moved[inner], np.exp(1j * (2.4 * sx - 1.9 * sy))[inner], atol=0.02)


# Cancellation


@pytest.mark.parametrize("threshold", ["mad", "median+mad"])
def test_outliers_are_cancelled_and_good_points_stay(threshold: str) -> None:
    rng = np.random.default_rng(0)
    a, truth = rng.uniform(0, 500, (80, 2)), rigid(4.0)
    b = truth(a) + rng.normal(0, 0.3, a.shape)
    b[:20] += rng.uniform(-40, 40, (20, 2))
    wrong = np.hypot(*(b - truth(a)).T) > 3
    context = FilterContext((500, 500), (500, 500), Rigid)
    kept = registry.create("filter", "mad", threshold=threshold).keep(Matches(a, b, np.ones(80)), context)
    assert not kept[wrong].any()
    assert kept.sum() >= (5 if threshold == "mad" else 45)


def test_a_consensus_survives_a_majority_of_outliers() -> None:
    rng = np.random.default_rng(1)
    a, truth = rng.uniform(0, 500, (90, 2)), rigid(20.0)
    b = truth(a) + rng.normal(0, 0.3, a.shape)
    b[:55] = rng.uniform(0, 500, (55, 2))
    context = FilterContext((500, 500), (500, 500), Rigid)
    kept = registry.create("filter", "mad", start="consensus").keep(Matches(a, b, np.ones(90)), context)
    assert kept[55:].sum() > 28
    assert kept[:55].sum() <= 1


def test_residuals_that_are_all_zero_cancel_nothing() -> None:
    a = np.random.default_rng(2).uniform(0, 100, (12, 2))
    for threshold in ("mad", "median+mad"):
        assert cancelled(lambda kept: np.zeros(12), 12, threshold=threshold).all()
    model, kept = cancelled_fit(fitted, a, rigid(3.0)(a))
    assert kept.all()
    assert isinstance(model, Rigid)
    assert model.rotation_deg == pytest.approx(3.0)


def test_what_cannot_be_fitted_is_cancelled_whole() -> None:
    a = np.full((6, 2), 7.0)
    model, kept = cancelled_fit(fitted, a, a)
    assert model is None
    assert not kept.any()
    assert cancelled_fit(fitted, a[:0], a[:0])[0] is None


def test_the_covariance_of_tie_points_has_the_size_of_their_errors() -> None:
    truth = rigid(3.0)
    matches = registry.create("matcher", "target-centroids").match(*(as_image(i) for i in parking(truth, seed=14)))
    off = matches.secondary_xy - truth(matches.reference_xy)
    near = np.hypot(*off.T) < 3
    assert matches.covariance is not None
    squared = np.einsum("ni,nij,nj->n", off[near], np.linalg.inv(matches.covariance[near]), off[near])
    assert 0.4 < np.nanmedian(squared) / (2 * np.log(2)) < 2.5


def test_equal_input_gives_equal_bits() -> None:
    pair = parking(rigid(12.0), seed=15)
    runs = [featreg.match(*pair, method="rc-obcls") for _ in range(2)]
    np.testing.assert_array_equal(runs[0].matches.secondary_xy, runs[1].matches.secondary_xy)
    np.testing.assert_array_equal(runs[0].inliers, runs[1].inliers)


# Trust


def test_a_stretched_secondary_is_not_explained_by_a_rotation() -> None:
    """One percent along one axis, as a defocused image has it: a part of the scene still fits a rigid model."""
    import cv2

    first, second = parking(rigid(6.0), seed=16)
    assert featreg.match(first, second, method="rc-obcls").status == "ok"
    stretched = cv2.resize(second, (SIZE, round(1.01 * SIZE)), interpolation=cv2.INTER_CUBIC)[:SIZE]
    result = featreg.match(first, np.maximum(stretched, 0), method="rc-obcls")
    assert result.status == "unreliable"
    # Half of the percent on each axis, at the root mean square distance from the centre.
    assert result.gates["distortion"].value == pytest.approx(0.005 * SIZE / np.sqrt(6), abs=0.2)


def test_a_quarter_of_the_scene_is_not_enough() -> None:
    """The rotation would rest on a few neighbouring places."""
    first, second = parking(rigid(6.0), seed=17, targets=90)
    other = parking(rigid(0.0), seed=18, targets=90)[1]
    other[:150, :150] = second[:150, :150]
    result = featreg.match(first, other, method="rc-obcls")
    assert result.status == "unreliable"


def test_a_regular_row_of_targets_is_ambiguous() -> None:
    """A shift by one place explains nearly as many: neither the vote nor the spectra may choose."""
    rng = np.random.default_rng(19)
    looks = []
    for _ in range(2):
        amplitude = np.sqrt(rng.exponential(size=(SIZE, SIZE)))
        for y in range(30, SIZE - 20, 50):
            for x in range(30, SIZE - 20, 50):
                amplitude[y - 6 : y + 6, x - 6 : x + 6] *= 8
        looks.append(amplitude)
    result = featreg.match(looks[0], np.roll(looks[1], 50, axis=1), method="rc-obcls")
    assert result.status == "unreliable"


def test_complex_correlation_needs_complex_images() -> None:
    first, second = parking(rigid(0.0), seed=20)
    for method in ("cc-obcls", "cc-obcls-paper", "cls-paper"):
        with pytest.raises(InputError, match="needs two complex images"):
            featreg.match(first.astype(np.complex64), second, method=method)


@pytest.mark.realdata
@pytest.mark.slow
def test_real_couples_are_right_or_refused(realdata: Path) -> None:
    """The next degree of azimuth, turned and shifted: right; out of focus or mostly replaced: right or unreliable."""
    history = featreg.read_phase_history(realdata / "gotcha")
    images = [back_project(history.select(i, i + 1)).pixels for i in range(3)]
    centre = np.array([[250.0, 250.0]])
    couples = [((0, 1), 11.37, (20.0, -35.0)), ((1, 2), -143.6, (0.0, 60.0)), ((0, 2), 4.0, (0.0, 0.0))]
    for (i, j), degrees, shift in couples:
        turned = Rigid(degrees)
        dx, dy = (centre - turned(centre))[0] + shift
        truth = Rigid(degrees, float(dx), float(dy))
        there = resample(as_image(images[j]), truth.inverse, (501, 501), resampling="nearest").pixels
        there = np.where(np.isfinite(there), there, 0)
        found = featreg.match(images[i], there, method="rc-obcls")
        assert found.status == "ok"
        assert isinstance(found.model, Rigid)
        assert abs((found.model.rotation_deg - degrees + 180) % 360 - 180) < 0.1
        assert np.hypot(*(found.model(centre) - truth(centre))[0]) < 1
        frequency = np.fft.fftfreq(501)[:, None] * 2
        error = np.exp(1j * (25 * frequency**2 + 12 * frequency**3))
        blurred = np.fft.ifft(np.fft.fft(there, axis=0) * error, axis=0).astype(np.complex64)
        found = featreg.match(images[i], blurred, method="rc-obcls")
        if found.status == "ok":
            assert isinstance(found.model, Rigid)
            assert abs((found.model.rotation_deg - degrees + 180) % 360 - 180) < 0.15
