"""Autofocus: known phase errors recovered, the phase convention, wrong phases that are not trusted, and bad input."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import CancelledError, FeatregError, InputError, ParameterError, UnknownNameError
from featreg.focusing import METHODS, autofocus, complex_image
from featreg.focusing.azimuth_filter import image_entropy
from featreg.focusing.legendre_phase import legendre_basis
from featreg.focusing.phase_error import Band
from featreg.focusing.pulse_spectra import PulseSpectra, grouped, pulse_spectra
from featreg.focusing.range_cells import cell_energies, choose_cells, count_points

SIDE = 256
BAND = np.abs(np.fft.fftfreq(SIDE)) < 0.4
Complex = NDArray[np.complex128]


def scene(points: Sequence[tuple[float, float, float]], clutter: float, seed: int) -> Complex:
    """Points (azimuth, range, amplitude) over clutter, band-limited in both axes."""
    rng = np.random.default_rng(seed)
    f = np.fft.fftfreq(SIDE)
    spectrum = clutter * np.fft.fft2(rng.normal(size=(SIDE, SIDE)) + 1j * rng.normal(size=(SIDE, SIDE)))
    for row, cell, amplitude in points:
        turn = np.exp(2j * np.pi * rng.uniform())
        spectrum += amplitude * turn * np.outer(np.exp(-2j * np.pi * f * row), np.exp(-2j * np.pi * f * cell))
    window = np.where(np.abs(f) < 0.4, 0.54 + 0.46 * np.cos(2 * np.pi * f / 0.8), 0)
    return np.asarray(np.fft.ifft2(spectrum * BAND[:, None] * window))


def rows_and_columns(seed: int = 0, clutter: float = 1e-3) -> Complex:
    """Section 3.1 of the paper: weak points one per range cell, strong ones all in one range cell."""
    rng = np.random.default_rng(seed)
    weak = [(80 + rng.uniform(-3, 3), 30 + 6 * i, 1.0) for i in range(16)]
    return scene(weak + [(100 + 8 * i, 200, 1.5) for i in range(16)], clutter, seed)


def low_contrast(seed: int = 0) -> Complex:
    rng = np.random.default_rng(seed)
    fields = np.kron(rng.uniform(0.7, 1.4, (16, 16)), np.ones((16, 16)))
    fields[rng.integers(10, SIDE - 10, 8)] *= 3
    noise = rng.normal(size=(SIDE, SIDE)) + 1j * rng.normal(size=(SIDE, SIDE))
    return np.asarray(np.fft.ifft2(np.fft.fft2(fields * noise) * BAND[:, None]))


def speckle(shape: tuple[int, int] = (SIDE, SIDE), seed: int = 0) -> Complex:
    rng = np.random.default_rng(seed)
    keep = np.abs(np.fft.fftfreq(shape[0])) < 0.4
    return np.asarray(np.fft.ifft2(np.fft.fft2(rng.normal(size=shape) + 1j * rng.normal(size=shape)) * keep[:, None]))


def smooth(n: int = SIDE, strength: float = 1.0) -> NDArray[np.float64]:
    u = 2 * np.fft.fftfreq(n)
    return np.asarray(strength * (12 * u**2 + 5 * u**3 - 4 * u**4))


def mixed(seed: int = 0) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    u = 2 * np.fft.fftfreq(SIDE)
    return np.asarray(smooth() + 1.5 * np.sin(2 * np.pi * (2.3 * u + rng.uniform())) + 0.1 * rng.normal(size=SIDE))


def blurred(image: Complex, phase: NDArray[np.float64]) -> NDArray[np.complex64]:
    spectrum = np.fft.fft(image, axis=0) * np.exp(1j * phase)[:, None]
    return np.fft.ifft(spectrum, axis=0).astype(np.complex64)


def residual(image: Complex, truth: NDArray[np.float64], found: NDArray[np.float64]) -> float:
    """RMS radians, constant and linear part apart, by the method of the tests, not of the library."""
    power = np.mean(np.abs(np.fft.fft(image, axis=0)) ** 2, axis=1)
    f = np.fft.fftfreq(len(truth))
    order = np.argsort(f)
    turn = (np.exp(1j * (truth - found)) * power)[order]
    slopes = np.linspace(-np.pi, np.pi, 8001)
    keep = power[order] > 1e-3 * power.max()
    match = np.abs(np.exp(-1j * np.outer(slopes, np.arange(len(f))[keep])) @ turn[keep])
    turn = turn[keep] * np.exp(-1j * slopes[match.argmax()] * np.arange(len(f))[keep])
    left = np.angle(turn * np.exp(-1j * np.angle(turn.sum())))
    return float(np.sqrt(np.average(left**2, weights=np.abs(turn))))


# The phase


@pytest.mark.parametrize("method", ["auto", "mea", "pmea", "mca"])
@pytest.mark.parametrize("seed", [1, 2])
def test_point_targets_are_focused(method: str, seed: int) -> None:
    clean, phase = rows_and_columns(seed), mixed(seed)
    result = featreg.focus(blurred(clean, phase), method, fraction=None if method == "auto" else 0.1)
    assert result.status == "ok", result.reason
    assert residual(clean, phase, result.phase) < 0.06
    assert result.image_entropy[1] < result.image_entropy[0] - 0.5
    assert result.deviation < 0.1


def test_pga_focuses_isolated_points() -> None:
    rng = np.random.default_rng(0)
    clean = scene([(rng.uniform(30, 226), 5 + 6 * i, 1.0) for i in range(40)], 1e-3, 0)
    phase = mixed()
    result = featreg.focus(blurred(clean, phase), "pga")
    assert result.status == "ok", result.reason
    assert residual(clean, phase, result.phase) < 0.15


def test_a_polynomial_phase_is_found_where_contrast_is_low() -> None:
    clean = low_contrast()
    for method in ("legendre", "auto"):
        result = featreg.focus(blurred(clean, smooth()), method)
        assert result.status == "ok", result.reason
        assert residual(clean, smooth(), result.phase) < 0.12


def test_other_methods_do_not_claim_what_they_cannot_do_at_low_contrast() -> None:
    clean, phase = low_contrast(1), mixed(1)
    for method in ("mea", "pmea", "mca", "pga", "legendre"):
        result = featreg.focus(blurred(clean, phase), method)
        assert result.status == "unreliable" or residual(clean, phase, result.phase) < 0.3, method


def test_the_phase_belongs_to_the_fft_of_the_image() -> None:
    image = blurred(rows_and_columns(), mixed())
    for axis, given in ((0, image), (1, np.ascontiguousarray(image.T))):
        result = featreg.focus(given, "mea", azimuth_axis=axis)
        turn = np.exp(-1j * result.phase)
        turn = turn[:, None] if axis == 0 else turn
        again = np.fft.ifft(np.fft.fft(given, axis=axis) * turn, axis=axis)
        np.testing.assert_allclose(result.image, again, atol=2e-6 * np.abs(again).max())
        assert result.image.dtype == np.complex64
        assert result.phase.shape == (SIDE,)
        assert len(result.entropy) == result.iterations + 1


def test_turning_the_axes_turns_the_result() -> None:
    image = blurred(rows_and_columns(), mixed())
    a, b = featreg.focus(image, "pmea"), featreg.focus(np.ascontiguousarray(image.T), "pmea", azimuth_axis=1)
    np.testing.assert_array_equal(a.cells, b.cells)
    np.testing.assert_allclose(a.image, b.image.T, atol=1e-5 * np.abs(a.image).max())


def test_the_gain_of_the_image_does_not_matter() -> None:
    image = blurred(rows_and_columns(), mixed())
    a, b = featreg.focus(image), featreg.focus(image * np.complex64(1e6j))
    assert Band.of(np.ones(SIDE)).difference(a.phase, b.phase) < 1e-2
    assert b.image_entropy[1] == pytest.approx(a.image_entropy[1], abs=1e-3)


def test_entropy_is_that_of_the_cells_and_with_all_cells_that_of_the_image() -> None:
    image = blurred(low_contrast(), smooth())
    for normalize in (True, False):
        result = featreg.focus(image, "mea", fraction=1.0, normalize=normalize, max_iterations=12)
        np.testing.assert_allclose(result.entropy[[0, -1]], result.image_entropy, rtol=1e-5)
        assert result.image_entropy[1] == pytest.approx(image_entropy(result.image))


def test_detrending_leaves_the_image_where_it_was() -> None:
    clean = rows_and_columns()
    shift = np.exp(-2j * np.pi * np.fft.fftfreq(SIDE) * 20)
    image = blurred(np.asarray(np.fft.ifft(np.fft.fft(clean, axis=0) * shift[:, None], axis=0)), smooth(strength=0.5))

    def centre(values: NDArray[Any]) -> float:
        power = np.abs(values) ** 2
        return float(np.angle(np.sum(power * np.exp(2j * np.pi * np.arange(SIDE) / SIDE)[:, None])) * SIDE / 2 / np.pi)

    result = featreg.focus(image, detrend=True)
    assert centre(result.image) == pytest.approx(centre(image), abs=0.5)


# What is not trusted


@pytest.mark.parametrize("method", ["mea", "pmea"])
def test_without_normalisation_the_strong_row_collapses_and_is_not_trusted(method: str) -> None:
    clean, phase = rows_and_columns(3), mixed(3)
    kw: dict[str, Any] = {"fraction": 0.1, "normalize": False}
    result = featreg.focus(blurred(clean, phase), method, **kw)
    assert residual(clean, phase, result.phase) > 0.7
    assert result.image_entropy[1] < image_entropy(clean)  # entropy alone would call it the better image
    assert result.status == "unreliable"
    assert "halves" in result.reason


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(256, 200), (64, 80)])
def test_homogeneous_speckle_is_not_trusted(method: str, shape: tuple[int, int]) -> None:
    for seed in range(2):
        result = featreg.focus(speckle(shape, seed).astype(np.complex64), method)
        assert result.status == "unreliable"
        assert result.reason


@pytest.mark.parametrize("method", METHODS)
def test_a_single_scatterer_cannot_be_checked(method: str) -> None:
    result = featreg.focus(blurred(scene([(100, 100, 1.0)], 0.0, 0), smooth()), method, fraction=0.01)
    assert result.status in ("ok", "unreliable")
    assert np.isfinite(result.image).all()


def test_few_cells_are_not_enough() -> None:
    result = featreg.focus(blurred(rows_and_columns(), mixed()), "mea", fraction=0.005)
    assert result.status == "unreliable"
    assert "too few range cells" in result.reason


def test_neighbouring_cells_are_one_place_however_many() -> None:
    image = np.zeros((SIDE, 96), np.complex64)
    image[:, 40:46] = speckle((SIDE, 6))
    result = featreg.focus(image, "pga")
    assert result.reason.startswith("too few range cells with independent scatterers to check the phase: ")
    assert not result.gates["cells"].passed
    assert result.gates["cells"].value is None
    assert result.gates["entropy"].passed


# Range blocks, carrier, inputs


def test_an_error_that_changes_over_range_needs_blocks() -> None:
    rng = np.random.default_rng(4)
    clean = scene([(rng.uniform(60, 196), 3 + 2.5 * i, 1.0) for i in range(100)], 1e-3, 4)
    spectrum = np.fft.fft(clean, axis=0) * np.exp(1j * np.outer(smooth(strength=2), np.linspace(0.6, 1.4, SIDE)))
    image = np.fft.ifft(spectrum, axis=0).astype(np.complex64)
    one, four = (featreg.focus(image, "mea", fraction=0.5, range_blocks=n) for n in (1, 4))
    assert four.phase.shape == (4, SIDE)
    assert four.block_edges == (0, 64, 128, 192, 256)
    assert four.status == "ok", four.reason
    assert four.image_entropy[1] < one.image_entropy[1] - 0.1


def test_the_carrier_is_taken_out_and_put_back() -> None:
    clean = rows_and_columns()
    image = blurred(clean, mixed())
    rows, columns = np.indices(image.shape)
    factor = np.exp(0.3j * (rows - 100) ** 2 / 30 + 0.2j * columns).astype(np.complex64)
    plain, carried = featreg.focus(image), featreg.focus(image / factor, carrier=factor)
    np.testing.assert_allclose(carried.image * factor, plain.image, atol=1e-4 * np.abs(plain.image).max())


def test_missing_samples_count_as_zero() -> None:
    image = blurred(rows_and_columns(), mixed())
    holes = image.copy()
    holes[:, 210:230] = np.nan
    result = featreg.focus(holes, "mea", fraction=0.1)
    assert result.status == "ok"
    assert np.isfinite(result.image).all()
    assert not set(result.cells) & set(range(210, 230))
    assert np.isnan(holes[0, 215])


def test_the_input_is_never_written_to() -> None:
    image = blurred(rows_and_columns(), mixed())
    for axis in (0, 1):
        before = image.copy()
        featreg.focus(image, "pmea", azimuth_axis=axis, max_iterations=5)
        np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.ones((40, 40)), "complex"),
        (np.zeros((40, 40), complex), "zeros"),
        (np.zeros((0, 40), complex), "shape"),
        (np.ones((8, 40), complex), "at least 16"),
        (np.ones((40, 40, 2), complex), "shape"),
        (np.full((40, 40), np.nan + 0j), "array"),
        ("missing.npy", "no such file"),
        ([[1j]], "list"),
    ],
)
def test_what_cannot_be_focused_is_refused(image: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        featreg.focus(image)


@pytest.mark.parametrize(
    ("keywords", "error"),
    [
        ({"method": "mae"}, ParameterError),
        ({"azimuth_axis": 2}, ParameterError),
        ({"fraction": 0}, ParameterError),
        ({"fraction": 1.5}, ParameterError),
        ({"max_iterations": 0}, ParameterError),
        ({"range_blocks": 0}, ParameterError),
        ({"range_blocks": 40}, ParameterError),
        ({"workers": 0}, ParameterError),
        ({"detector": "prewit"}, UnknownNameError),
        ({"detector": 3}, ParameterError),
        ({"carrier": np.ones((3, 3))}, InputError),
    ],
)
def test_impossible_parameters_are_refused(keywords: dict[str, Any], error: type[FeatregError]) -> None:
    with pytest.raises(error):
        featreg.focus(speckle().astype(np.complex64), **keywords)


def test_a_constant_image_is_not_trusted() -> None:
    assert featreg.focus(np.full((40, 40), 1 + 1j, np.complex64)).status == "unreliable"


def test_progress_and_cancel() -> None:
    image = blurred(rows_and_columns(), mixed())
    seen: list[int] = []
    featreg.focus(image, "mea", progress=lambda done, total: seen.append(done))
    assert seen == sorted(seen)
    assert seen
    stop = threading.Event()
    stop.set()
    with pytest.raises(CancelledError):
        featreg.focus(image, cancel=stop)


def test_workers_do_not_change_a_bit() -> None:
    image = np.tile(blurred(rows_and_columns(), mixed()), (1, 6))
    a, b = (featreg.focus(image, "pmea", fraction=1.0, max_iterations=10, workers=n) for n in (1, 2))
    np.testing.assert_array_equal(a.phase, b.phase)
    np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(a.entropy, b.entropy)


# Registration


def test_match_focuses_complex_images_first() -> None:
    clean = rows_and_columns(5, clutter=0.02)
    image = clean.astype(np.complex64)
    result = featreg.match(image, blurred(clean, mixed()), method="sar-orb", focus="auto")
    record = result.provenance["focus"]
    assert record["secondary"]["used"]
    assert record["secondary"]["status"] == "ok"
    with pytest.raises(ParameterError, match="did you mean"):
        featreg.match(image, image, focus="atuo")
    with pytest.raises(InputError, match="complex"):
        featreg.match(np.abs(image), np.abs(image), focus="auto")


def test_match_leaves_an_image_alone_that_cannot_be_focused() -> None:
    image = speckle().astype(np.complex64)
    record = featreg.match(image, np.abs(image), focus="mea").provenance["focus"]
    assert record["reference"]["status"] == "unreliable"
    assert not record["reference"]["used"]
    assert record["secondary"]["status"] == "not done"


# Pieces


def test_the_kernels_agree_with_plain_numpy() -> None:
    image = low_contrast().astype(np.complex64)
    cells = pulse_spectra(image, 0, np.arange(20, 60))
    phase = smooth(strength=0.3)
    g = np.fft.ifft(cells.spectra * np.exp(-1j * phase), axis=1, norm="ortho")
    p = np.abs(g) ** 2 * SIDE
    np.testing.assert_allclose(p.mean(axis=1), 1, rtol=1e-4)
    for contrast, weight in ((True, p), (False, np.maximum(np.log(p) + 2, 0))):
        step = cells.step(phase, contrast=contrast, offset=2.0)
        expected = np.sum(cells.spectra * np.conj(np.fft.fft(weight * g, axis=1, norm="ortho")), axis=0)
        np.testing.assert_allclose(step.correlation, expected, atol=1e-4 * np.abs(expected).max())
        assert step.objective == pytest.approx(-float(np.mean(p * np.log(p))), rel=1e-5)


def test_the_unclamped_step_is_the_gradient() -> None:
    cells = pulse_spectra(low_contrast().astype(np.complex64), 0, np.arange(40))
    phase, direction = smooth(), np.random.default_rng(0).normal(size=SIDE)
    step = cells.step(phase, contrast=False, clamped=False)
    slope = -2 * np.imag(step.correlation * np.exp(-1j * phase)) / cells.cells
    h = 2e-2
    rise = cells.criteria(phase + h * direction)[0] - cells.criteria(phase - h * direction)[0]
    assert slope @ direction == pytest.approx(rise / (2 * h), rel=0.02)


@pytest.mark.parametrize("start", [0, 40, 250])
def test_the_band_is_found_wherever_it_lies(start: int) -> None:
    power = np.zeros(300)
    power[(start + np.arange(120)) % 300] = 1.0
    band = Band.of(power)
    np.testing.assert_array_equal(band.order, (start + np.arange(120)) % 300)
    np.testing.assert_allclose(band.place[[0, -1]], [-1, 1])
    line = band.spread(np.asarray(3.0 + 2.5 * np.arange(120), np.float64))
    assert band.difference(line, np.zeros(300)) < 1e-6
    basis = legendre_basis(band, 4)
    assert basis.shape == (300, 3)
    assert not basis[power == 0].any()


def test_cells_are_chosen_by_points_then_energy_and_never_empty_ones() -> None:
    energy = np.array([5.0, 0.0, 3.0, 4.0, 1.0])
    np.testing.assert_array_equal(choose_cells(energy, 0.4), [0, 3])
    np.testing.assert_array_equal(choose_cells(energy, 1.0), [0, 2, 3, 4])
    np.testing.assert_array_equal(choose_cells(energy, 0.4, np.array([0, 9, 2, 2, 5])), [3, 4])
    xy = np.array([[0, 0], [0, 3], [2, 1], [2.4, 0]])
    np.testing.assert_array_equal(count_points(xy, 0, 4), [2, 0, 2, 0])
    np.testing.assert_array_equal(count_points(xy, 1, 4), [2, 1, 0, 1])


def test_cells_that_are_mostly_missing_do_not_count() -> None:
    mask = np.ones((40, 30), np.bool_)
    mask[:30, 5] = False
    energy = cell_energies(np.ones((40, 30), np.complex64), 0, mask)
    np.testing.assert_array_equal(np.flatnonzero(energy == 0), [5])


def test_neighbours_share_a_group_and_halves_share_none() -> None:
    assert grouped([3, 4, 6, 20, 21]) == ((0, 3), (3, 5))
    assert grouped(list(range(16))) == ((0, 8), (8, 16))
    cells: PulseSpectra = pulse_spectra(low_contrast().astype(np.complex64), 0, np.arange(0, 200, 5))
    first, second = cells.halves()
    assert first.cells + second.cells == cells.cells == 40
    np.testing.assert_array_equal(first.spectra[1], cells.spectra[2])
    assert cells.thinned(10 * SIDE).cells == 10


@pytest.mark.parametrize("wide", [False, True])
def test_automatic_reports_the_cells_that_it_used_however_many_the_other_set_has(
    monkeypatch: pytest.MonkeyPatch, wide: bool
) -> None:
    strongest, spread = np.arange(60, 80), np.arange(0, 200, 10)
    monkeypatch.setattr(complex_image, "_automatic_cells", lambda *given: spread if given[-1] else strongest)

    def automatic(choose: Any, band_of: Any, **how: Any) -> Any:
        used = choose(wide)
        found = autofocus.estimate("mea", used, band_of(used), max_iterations=2)
        return found, used, autofocus.NO_CHECK

    monkeypatch.setattr(autofocus, "automatic", automatic)
    np.testing.assert_array_equal(featreg.focus(low_contrast()).cells, spread if wide else strongest)


@pytest.mark.realdata
def test_real_apertures_find_the_error_that_was_put_in(realdata: Any) -> None:
    """Self-consistency: what is found in the blurred image less what is found in the image as it is."""
    history = featreg.read_phase_history(realdata / "gotcha", polarisation="HH")
    image = featreg.back_project(history, featreg.GroundGrid((301, 301), 0.2)).pixels
    rng = np.random.default_rng(0)
    phase = smooth(301) + 0.1 * rng.normal(size=301)
    made = blurred(image.astype(np.complex128), phase)
    own, found = (featreg.focus(i, "mea", fraction=0.2) for i in (image, made))
    power = np.mean(np.abs(np.fft.fft(image, axis=0)) ** 2, axis=1)
    assert found.status == "ok", found.reason
    assert Band.of(power).difference(found.phase - own.phase, phase) < 0.05
