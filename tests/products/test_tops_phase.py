"""TOPS bursts of point targets whose carriers follow from the beam's steering, moved by a known part of a pixel."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from featreg.cli.info import describe
from featreg.cli.main import main
from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine
from featreg.io.opening import open_reader
from featreg.io.products.sentinel1_tops import tops_of, tops_terms
from featreg.products.in_memory import warp
from featreg.products.tops_phase import TopsPhase
from featreg.products.warping import warp_file
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Matches

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

LIGHT = 299_792_458.0
LINES, BURSTS, WIDTH = 300, 2, 96
INTERVAL, SAMPLING, NEAR = 2.0556e-3, 6.4345e7, 5.34e-3
FREQUENCY, STEERING, SPEED = 5.405e9, 1.59, 7590.0
RATE, CENTROID = (-2325.0, 450_000.0), ((12.0, 6e6), (-35.0, 9e6))
SHIFT = (0.3, 0.45)


def stamp(seconds: float) -> str:
    return f"2022-01-04T17:06:{seconds:09.6f}"


def annotation(*, old: bool = False) -> str:
    middles = [0.5 * (LINES - 1) * INTERVAL + 2.7 * b for b in range(BURSTS)]
    bursts = "".join(f"<burst><azimuthTime>{stamp(2.7 * b)}</azimuthTime></burst>" for b in range(BURSTS))
    orbit = "".join(
        f"<orbit><time>{stamp(10.0 * k)}</time><velocity><x>{SPEED * 0.6}</x><y>0</y><z>{SPEED * 0.8}</z></velocity>"
        "</orbit>"
        for k in range(3)
    )
    powers = f"<c0>{RATE[0]}</c0><c1>{RATE[1]}</c1><c2>0</c2>"
    if not old:
        powers = f"<azimuthFmRatePolynomial>{RATE[0]} {RATE[1]} 0</azimuthFmRatePolynomial>"
    rate = f"<azimuthFmRate><azimuthTime>{stamp(1)}</azimuthTime><t0>{NEAR}</t0>{powers}</azimuthFmRate>"
    # The second of three estimates is nearest to neither burst.
    estimates = "".join(
        f"<dcEstimate><azimuthTime>{stamp(when)}</azimuthTime><t0>{NEAR}</t0>"
        f"<dataDcPolynomial>{c[0]} {c[1]}</dataDcPolynomial></dcEstimate>"
        for when, c in ((middles[0] + 0.2, CENTROID[0]), (1.5, (900.0, 0.0)), (middles[1] - 0.3, CENTROID[1]))
    )
    return (
        "<product><generalAnnotation><productInformation><projection>Slant Range</projection>"
        f"<rangeSamplingRate>{SAMPLING}</rangeSamplingRate><radarFrequency>{FREQUENCY}</radarFrequency>"
        f"<azimuthSteeringRate>{STEERING}</azimuthSteeringRate></productInformation><orbitList>{orbit}</orbitList>"
        f"<azimuthFmRateList>{rate}</azimuthFmRateList></generalAnnotation><imageAnnotation><imageInformation>"
        f"<slantRangeTime>{NEAR}</slantRangeTime><azimuthTimeInterval>{INTERVAL}</azimuthTimeInterval>"
        f"<numberOfLines>{LINES * BURSTS}</numberOfLines><numberOfSamples>{WIDTH}</numberOfSamples></imageInformation>"
        f"</imageAnnotation><dopplerCentroid><dcEstimateList>{estimates}</dcEstimateList></dopplerCentroid><swathTiming>"
        f"<linesPerBurst>{LINES}</linesPerBurst><burstList>{bursts}</burstList></swathTiming></product>"
    )


def carrier(burst: int, x: Any, time: Any) -> Any:
    """Hz of a target at a zero-Doppler time after the burst's middle, as the beam saw it.

    Its Doppler frequency k_a (t - time) and that of the beam's centre, f + k_s t, are equal when the beam passes; f is
    such that the centroid in the middle of the burst is that of the annotation.
    """
    after = x / SAMPLING
    rate = RATE[0] + RATE[1] * after
    centroid = CENTROID[burst][0] + CENTROID[burst][1] * after
    steering = 2 * SPEED * FREQUENCY / LIGHT * np.deg2rad(STEERING)
    beam = centroid * (rate - steering) / rate
    passes = (beam + rate * time) / (rate - steering)
    return rate * (passes - time)


def scene(dx: float, dy: float) -> Any:
    """The bursts at places moved by (dx, dy): exactly, since targets are functions."""
    rng = np.random.default_rng(3)
    count, reach = 2500, 12
    out = np.zeros((BURSTS, LINES, WIDTH), np.complex128)
    for b in range(BURSTS):
        places = rng.uniform(-4, [WIDTH + 4, LINES + 4], (count, 2))
        sizes = rng.normal(size=count) + 1j * rng.normal(size=count)
        for (x, y), size in zip(places.tolist(), sizes.tolist(), strict=True):
            col = np.arange(max(0, int(x - dx) - reach), min(WIDTH, int(x - dx) + reach + 1))
            row = np.arange(max(0, int(y - dy) - reach), min(LINES, int(y - dy) + reach + 1))
            u, v = col + dx - x, row + dy - y
            turns = carrier(b, x, (y - 0.5 * (LINES - 1)) * INTERVAL) * INTERVAL
            across, along = (np.sinc(0.62 * w) * np.cos(np.pi * np.clip(w / 26, -0.5, 0.5)) ** 2 for w in (u, v))
            out[b, row[0] : row[-1] + 1, col] += size * across[:, None] * (along * np.exp(2j * np.pi * turns * v))
    return out.reshape(-1, WIDTH).astype(np.complex64)


@pytest.fixture(scope="module")
def burst(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tops") / "S1A.SAFE"
    for name in ("annotation", "measurement"):
        (folder / name).mkdir(parents=True)
    (folder / "annotation/s1a-iw1-slc-vv-20220104t170558.xml").write_text(annotation())
    path = folder / "measurement/s1a-iw1-slc-vv-20220104t170558.tiff"
    samples = scene(0.0, 0.0)
    with rasterio.open(path, "w", driver="GTiff", height=len(samples), width=WIDTH, count=1, dtype="complex64") as out:
        out.write(samples, 1)
    (folder / "manifest.safe").write_text(f'<XFDU><fileLocation href="./measurement/{path.name}"/></XFDU>')
    return path


def registration(path: Path) -> Registration:
    known = InputImage(str(path), (LINES * BURSTS, WIDTH), "complex")
    model = Affine(np.array([[1.0, 0, SHIFT[0]], [0, 1, SHIFT[1]]]))
    return Registration(Matches.empty(), {}, np.zeros(0, bool), model, "ok", "", reference=known, secondary=known)


def test_bursts_are_interpolated_right_with_deramping_and_wrong_without(
    burst: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    wanted, errors = scene(*SHIFT), {}
    for deramp in (False, True):
        caplog.clear()
        made = warp_file(registration(burst), burst, tmp_path / "o.tif", deramp=deramp, workers=1)
        with rasterio.open(tmp_path / "o.tif") as dataset:
            values = dataset.read(1)
            assert dataset.tags().get("FEATREG_DERAMP") == ("annotation" if deramp else None)
        assert ("phase will be wrong without deramp" in caplog.text) is not deramp
        assert isinstance(made.ramp, TopsPhase) is deramp
        good = np.isfinite(values)
        good[np.abs(np.arange(len(good)) % LINES - 0.5 * (LINES - 1)) > 0.5 * LINES - 14] = False
        assert good.mean() > 0.7
        errors[deramp] = np.linalg.norm((values - wanted)[good]) / np.linalg.norm(wanted[good])
        # No sample is made of two bursts.
        assert np.isnan(values[LINES - 1]).all() == deramp
    caplog.clear()
    warp(registration(burst), burst)
    assert "phase will be wrong without deramp" in caplog.text
    inside = warp(registration(burst), burst, deramp=True)
    np.testing.assert_allclose(inside[good], values[good], atol=1e-4)
    assert errors[True] < 0.03
    assert errors[False] > 0.5


def test_the_ramp_is_that_of_the_beam(burst: Path) -> None:
    reader = open_reader(burst.parent.parent)
    terms = tops_of(reader, 0)
    reader.close()
    assert terms is not None
    found = TopsPhase(terms)
    x, step = np.array([0.0, 40.0, 95.0]), 1e-3
    for b in range(BURSTS):
        for row in (5.0, 150.0, 290.0):
            y = b * LINES + row
            local = (found.phase(x, y + step) - found.phase(x, y - step)) / (4 * np.pi * step * INTERVAL)
            expected = carrier(b, x, (row - 0.5 * (LINES - 1)) * INTERVAL)
            # The reference time takes the centroid's change with range a second time: up to 10 Hz of 486 Hz here.
            np.testing.assert_allclose(local, expected, atol=12.0)
            assert local[0] == pytest.approx(expected[0], abs=0.5)
    assert found.steepest(WIDTH) == pytest.approx(1.15, abs=0.1)
    old = tops_terms("a.xml", annotation(old=True).encode(), (LINES * BURSTS, WIDTH))
    assert old is not None
    np.testing.assert_array_equal(TopsPhase(old).phase(x, 77.0), found.phase(x, 77.0))


def test_what_is_said_of_it(burst: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    ramp = describe(str(burst))["phase_ramp"]
    assert (ramp["kind"], ramp["bursts"], ramp["lines"]) == ("TOPS", BURSTS, LINES)
    registration(burst).to_json(tmp_path / "r.json")
    assert main(["warp", str(tmp_path / "r.json"), str(burst), "-o", str(tmp_path / "o.tif"), "--deramp"]) == 0
    assert "phase ramp: that of 2 TOPS bursts, as the annotation states it" in capsys.readouterr().out


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("<azimuthSteeringRate>1.59</azimuthSteeringRate>", ""),
        lambda text: text.replace(f"{RATE[0]} {RATE[1]} 0", ""),
        lambda text: text.replace(str(RATE[0]), "2000"),
        lambda text: text.replace(str(INTERVAL), "nan"),
        lambda text: text.replace("dcEstimateList", "list"),
        lambda text: text.replace(f"<linesPerBurst>{LINES}<", f"<linesPerBurst>{LINES - 1}<"),
    ],
)
def test_a_broken_annotation_is_refused(change: Callable[[str], str]) -> None:
    with pytest.raises(InputError, match=r"a\.xml: does not state the phase of its bursts"):
        tops_terms("a.xml", change(annotation()).encode(), (LINES * BURSTS, WIDTH))


def test_what_cannot_be_deramped_in_memory() -> None:
    known = InputImage("array", (40, 40))
    result = Registration(
        Matches.empty(), {}, np.zeros(0, bool), Affine(np.eye(3)[:2]), "ok", "", reference=known, secondary=known
    )
    with pytest.raises(ParameterError, match="deramp needs complex ones"):
        warp(result, np.random.default_rng(0).random((40, 40)), deramp=True)


def test_other_images_have_no_bursts() -> None:
    assert tops_terms("a.xml", annotation().encode(), (LINES, WIDTH)) is None
    ground = annotation().replace("Slant Range", "Ground Range")
    assert tops_terms("a.xml", ground.encode(), (LINES * BURSTS, WIDTH)) is None
