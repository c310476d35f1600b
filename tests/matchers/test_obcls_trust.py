"""OBCLS: what may not be trusted, and real couples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import featreg
from featreg.focusing.backprojection import back_project
from featreg.geometry import Rigid
from featreg.io import as_image
from featreg.products.resample import resample
from made.parking_lots import SIZE, parking, rigid

# Methods


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
