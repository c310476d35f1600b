"""What `focus` takes: range blocks, carrier, missing samples, workers; what it refuses; `match` that focuses first."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import CancelledError, FeatregError, InputError, ParameterError, UnknownNameError
from made.blurred_scenes import SIDE, blurred, mixed_phase, points_in_clutter, rows_and_columns, smooth_phase, speckle

# Range blocks, carrier, inputs


def test_an_error_that_changes_over_range_needs_blocks() -> None:
    rng = np.random.default_rng(4)
    clean = points_in_clutter([(rng.uniform(60, 196), 3 + 2.5 * i, 1.0) for i in range(100)], 1e-3, 4)
    spectrum = np.fft.fft(clean, axis=0) * np.exp(1j * np.outer(smooth_phase(strength=2), np.linspace(0.6, 1.4, SIDE)))
    image = np.fft.ifft(spectrum, axis=0).astype(np.complex64)
    one, four = (featreg.focus(image, "mea", fraction=0.5, range_blocks=n) for n in (1, 4))
    assert four.phase.shape == (4, SIDE)
    assert four.block_edges == (0, 64, 128, 192, 256)
    assert four.status == "ok", four.reason
    assert four.image_entropy[1] < one.image_entropy[1] - 0.1


def test_the_carrier_is_taken_out_and_put_back() -> None:
    clean = rows_and_columns()
    image = blurred(clean, mixed_phase())
    rows, columns = np.indices(image.shape)
    factor = np.exp(0.3j * (rows - 100) ** 2 / 30 + 0.2j * columns).astype(np.complex64)
    plain, carried = featreg.focus(image), featreg.focus(image / factor, carrier=factor)
    np.testing.assert_allclose(carried.image * factor, plain.image, atol=1e-4 * np.abs(plain.image).max())


def test_missing_samples_count_as_zero() -> None:
    image = blurred(rows_and_columns(), mixed_phase())
    holes = image.copy()
    holes[:, 210:230] = np.nan
    result = featreg.focus(holes, "mea", fraction=0.1)
    assert result.status == "ok"
    assert np.isfinite(result.image).all()
    assert not set(result.cells) & set(range(210, 230))
    assert np.isnan(holes[0, 215])


def test_the_input_is_never_written_to() -> None:
    image = blurred(rows_and_columns(), mixed_phase())
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


def test_progress_and_cancel() -> None:
    image = blurred(rows_and_columns(), mixed_phase())
    seen: list[int] = []
    featreg.focus(image, "mea", progress=lambda done, total: seen.append(done))
    assert seen == sorted(seen)
    assert seen
    stop = threading.Event()
    stop.set()
    with pytest.raises(CancelledError):
        featreg.focus(image, cancel=stop)


def test_workers_do_not_change_a_bit() -> None:
    image = np.tile(blurred(rows_and_columns(), mixed_phase()), (1, 6))
    a, b = (featreg.focus(image, "pmea", fraction=1.0, max_iterations=10, workers=n) for n in (1, 2))
    np.testing.assert_array_equal(a.phase, b.phase)
    np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(a.entropy, b.entropy)


# Registration


def test_match_focuses_complex_images_first() -> None:
    clean = rows_and_columns(5, clutter=0.02)
    image = clean.astype(np.complex64)
    result = featreg.match(image, blurred(clean, mixed_phase()), method="sar-orb", focus="auto")
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
