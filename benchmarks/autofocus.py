"""Tables 2 and 3, Figures 5, 13 and 18 of the PMEA paper in kind, and what focusing does for registration.

    python benchmarks/autofocus.py [--suite simulated,gotcha,pulses,weak,registration,speed,trust] [--draws 3] [--seed 0] [--out DIR]

Every figure is a pair, entropy and residual phase, because a wrong phase may lower the entropy. The residual is the RMS over the
pulses that carry signal, weighted by their power, constant and linear part apart; dE is the entropy of the image less that of
the image without error. Real images are read from FEATREG_DATA/gotcha; without them those suites are left out.
"""  # noqa: E501

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from measuring import DATA, machine, on_one_thread, table
from numpy.typing import NDArray

import featreg
from featreg.focusing import FocusResult
from featreg.focusing.azimuth_filter import image_entropy
from featreg.focusing.phase_error import Band
from featreg.geometry import Rigid
from featreg.types import FloatArray

Complex = NDArray[np.complex128]
COLUMNS = ("case", "dE, nats", "residual, rad", "ok", "expected, rad", "iterations", "CPU ms")
METHODS: Mapping[str, tuple[str, dict[str, Any]]] = {
    "auto": ("auto", {}),
    "pmea, 5 %": ("pmea", {"fraction": 0.05}),
    "pmea by sar-ofast, 5 %": ("pmea", {"fraction": 0.05, "detector": "sar-ofast"}),
    "mea, 5 %": ("mea", {"fraction": 0.05}),
    "mca, 5 %": ("mca", {"fraction": 0.05}),
    "pga": ("pga", {}),
    "legendre": ("legendre", {}),
    "pmea-paper": ("pmea-paper", {}),
    "mea-paper": ("mea-paper", {}),
    "mca-paper": ("mca-paper", {}),
    "pga-paper": ("pga-paper", {}),
    "pmea-paper, 10 %": ("pmea-paper", {"fraction": 0.1}),
}


def error(n: int, rng: np.random.Generator, *, rough: bool, strength: float = 1.0) -> FloatArray:
    """A smooth phase error; rough ones have a sine and 0.1 rad of noise in addition. The paper's Eq. 10 is unknown."""
    u = 2 * np.fft.fftfreq(n)
    phase = strength * (12 * u**2 + 5 * u**3 - 4 * u**4)
    if rough:
        phase = phase + strength * 1.5 * np.sin(2 * np.pi * (2.3 * u + rng.uniform())) + 0.1 * rng.normal(size=n)
    return np.asarray(phase)


def blurred(image: NDArray[Any], phase: FloatArray) -> NDArray[np.complex64]:
    return np.fft.ifft(np.fft.fft(image, axis=0) * np.exp(1j * phase)[:, None], axis=0).astype(np.complex64)


def simulated(rng: np.random.Generator, clutter_db: float | None, n: int = 512) -> Complex:
    """Section 3.1: 20 points of amplitude 1, one per range cell, and 20 of 1.5 in one range cell."""
    points = [(130 + rng.uniform(-3, 3), 60 + 8 * i, 1.0) for i in range(20)]
    points += [(250 + 10 * i, 380, 1.5) for i in range(20)]
    f = np.fft.fftfreq(n)
    spectrum = np.zeros((n, n), complex)
    for row, cell, amplitude in points:
        turn = amplitude * np.exp(2j * np.pi * rng.uniform())
        spectrum += turn * np.outer(np.exp(-2j * np.pi * f * row), np.exp(-2j * np.pi * f * cell))
    if clutter_db is not None:
        noise = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
        spectrum += noise * 10 ** (clutter_db / 20) * 3 * np.abs(spectrum).mean() / np.abs(noise).mean()
    window = np.where(np.abs(f) < 0.4, 0.54 + 0.46 * np.cos(2 * np.pi * f / 0.8), 0)
    return np.asarray(np.fft.ifft2(spectrum * np.outer(np.abs(f) < 0.4, window)))


def low_contrast(rng: np.random.Generator, n: int = 512) -> Complex:
    """Speckle on fields that differ by 3 dB, with some brighter lines in both directions."""
    fields = np.kron(rng.uniform(0.7, 1.4, (16, 16)), np.ones((n // 16, n // 16)))
    for _ in range(12):
        fields[:, rng.integers(20, n - 20)] *= 2
        fields[rng.integers(20, n - 20)] *= 3
    noise = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
    keep = np.abs(np.fft.fftfreq(n)) < 0.4
    return np.asarray(np.fft.ifft2(np.fft.fft2(fields * noise) * keep[:, None]))


def band_of(image: NDArray[Any]) -> Band:
    return Band.of(np.mean(np.abs(np.fft.fft(image, axis=0)) ** 2, axis=1))


def aligned_entropy(image: NDArray[Any], truth: FloatArray, found: FloatArray, band: Band) -> float:
    """Entropy after the correction, moved by the linear part in which the phase differs from the truth."""
    rest = band.spread(band.without_line(truth - found))
    return image_entropy(blurred(image, rest))


def measured(clean: NDArray[Any], phase: FloatArray, run: Callable[[Any], FocusResult]) -> list[float]:
    band = band_of(clean)
    start = time.process_time()
    result = run(blurred(clean, phase))
    seconds = time.process_time() - start
    rise = aligned_entropy(clean, phase, result.phase, band) - image_entropy(clean)
    residual = band.difference(phase, result.phase)
    return [rise, residual, float(result.status == "ok"), result.deviation, result.iterations, 1e3 * seconds]


def compare(title: str, cases: list[tuple[NDArray[Any], FloatArray]], out: Path | None, wanted: list[str]) -> None:
    """Medians over the cases, a row per method, and the entropy of the image over the iterations of the first case."""
    rows = []
    blur = [image_entropy(blurred(clean, phase)) - image_entropy(clean) for clean, phase in cases]
    rows.append(["defocused", float(np.median(blur)), *["-"] * 5])
    for name in wanted:
        method, keywords = METHODS[name]
        values = [measured(c, p, lambda image: featreg.focus(image, method, **keywords)) for c, p in cases]  # noqa: B023
        rows.append([name, *np.median(values, axis=0).tolist()])
    print(f"\n## {title}\n\n{table(COLUMNS, rows)}")
    if out is not None:
        curves(title, *cases[0], wanted, out)


def curves(title: str, clean: NDArray[Any], phase: FloatArray, wanted: list[str], out: Path) -> None:
    """Entropy of the whole image against the most iterations allowed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    image, band = blurred(clean, phase), band_of(clean)
    most = [1, 2, 4, 6, 8, 10, 14, 20, 30, 45, 60]
    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    axes.axhline(image_entropy(clean), color="0.7", linewidth=3, label="without error")
    for name in wanted:
        method, keywords = METHODS[name]
        found = [featreg.focus(image, method, max_iterations=n, **keywords) for n in most]
        values = [aligned_entropy(clean, phase, result.phase, band) for result in found]
        style = "--" if "paper" in name else "-"
        axes.plot([0, *most], [image_entropy(image), *values], style, label=f"{name} ({found[-1].status})")
    axes.set(xlabel="most iterations", ylabel="entropy of the image, nats", title=title)
    axes.legend(fontsize=8)
    path = out / f"autofocus-{title.split(':')[0].replace(' ', '-').lower()}.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"\nwritten: {path}")


def gotcha(start: float, stop: float) -> featreg.PhaseHistory:
    return featreg.read_phase_history(DATA / "gotcha", polarisation="HH", azimuth=(start, stop))


def pulse_domain(draws: int, rng: np.random.Generator) -> None:
    """Errors put on the raw pulses, then back-projection, then focus with and without the carrier."""
    rows = []
    history = gotcha(0.0, 4.0)
    azimuth = float(history.azimuth_deg[history.central_pulse])
    grid = featreg.GroundGrid((501, 501), 0.2, turn_deg=azimuth)
    clean = featreg.back_project(history, grid).pixels
    factor = featreg.carrier(history, grid)
    before = image_entropy(clean)
    found: dict[str, list[list[float]]] = {}
    cases: dict[str, dict[str, Any]] = {"carrier left in": {}, "carrier taken out": {"carrier": factor}}
    for draw in range(draws):
        u = history.relative_azimuth_deg / np.abs(history.relative_azimuth_deg).max()
        phase = (1 + 0.3 * draw) * (12 * u**2 + 5 * u**3 - 4 * u**4) * rng.choice([-1, 1])
        samples = history.samples * np.exp(1j * phase)[:, None].astype(np.complex64)
        image = featreg.back_project(featreg.PhaseHistory(samples, history.frequencies, history.positions, history.r0,
                                                          history.azimuth_deg), grid).pixels  # fmt: skip
        for name, keywords in cases.items():
            for method in ("auto", "mea", "pmea"):
                for axis in (0, 1):
                    result = featreg.focus(image, method, azimuth_axis=axis, **keywords)
                    row = [image_entropy(image) - before, result.image_entropy[1] - before,
                           100 * (result.image_entropy[1] - before) / before, float(result.status == "ok")]  # fmt: skip
                    found.setdefault(f"{name}, {method}, azimuth axis {axis}", []).append(row)
    rows = [[name, *np.median(values, axis=0).tolist()] for name, values in found.items()]
    print(f"\n## Back-projected Gotcha, smooth error on the pulses\n\nentropy without error {before:.3f}\n")
    print(table(("case", "dE defocused", "dE after", "dE after, %", "ok"), rows))


def registration(rng: np.random.Generator) -> None:
    """RC-OBCLS on neighbouring 1-degree apertures, the secondary turned by 4 degrees, then defocused along columns."""
    from rotation import turned

    images = [featreg.back_project(gotcha(k, k + 1.0)) for k in range(4) if _has(k)]
    rows = []
    for i, (first, second) in enumerate(pairwise(images)):
        secondary = turned(second, 4.0).pixels
        for strength in (0.0, 0.5, 1.0, 3.0, 6.0):
            phase = error(len(secondary), rng, rough=strength > 0, strength=strength)
            given = blurred(secondary, phase)
            row: list[Any] = [f"{i + 1}-{i + 2}", strength]
            for focus in (None, "auto"):
                result = featreg.match(first, given, method="rc-obcls", model="rigid", focus=focus)
                angle = abs(result.model.rotation_deg - 4) if isinstance(result.model, Rigid) else float("inf")
                row += [float(angle), result.status]
            rows.append(row)
    print("\n## Registration against defocus: rotation error in degrees\n")
    print(table(("couple", "strength", "as it is", "status", "focus=auto", "status"), rows))


def _has(degree: int) -> bool:
    try:
        gotcha(degree, degree + 1.0)
    except featreg.FeatregError:
        return False
    return True


def trust(draws: int, rng: np.random.Generator) -> None:
    """How often a wrong phase is trusted, and a right one refused."""
    scenes: dict[str, Callable[[], NDArray[Any]]] = {
        "section 3.1, -40 dB": lambda: simulated(rng, -40.0),
        "low contrast": lambda: low_contrast(rng, 256),
        "homogeneous speckle": lambda: _speckle(rng, (256, 256)),
        "homogeneous, 64 x 600": lambda: _speckle(rng, (64, 600)),
    }
    rows = []
    for name, make in scenes.items():
        for method in ("auto", "mea", "pmea", "mca", "pga", "legendre", "mea-paper"):
            called, keywords = METHODS.get(method, (method, {}))
            values = []
            for draw in range(draws):
                clean = make()
                phase = error(len(clean), rng, rough=draw % 2 == 1, strength=float(rng.choice([0.5, 1.0, 3.0])))
                values.append(measured(clean, phase, lambda image: featreg.focus(image, called, **keywords)))  # noqa: B023
            residual, ok = np.array(values)[:, 1], np.array(values)[:, 2] > 0
            wrong, right = residual > 0.5, residual < 0.2
            rows.append([f"{name}, {method}", draws, int(ok.sum()), int((ok & wrong).sum()), int((~ok & right).sum())])
    print("\n## Trust\n")
    print(table(("case", "draws", "ok", "ok and > 0.5 rad", "not ok and < 0.2 rad"), rows))


def _speckle(rng: np.random.Generator, shape: tuple[int, int]) -> Complex:
    noise = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    keep = np.abs(np.fft.fftfreq(shape[0])) < 0.4
    return np.asarray(np.fft.ifft2(np.fft.fft2(noise) * keep[:, None]))


def speed(rng: np.random.Generator, n: int = 4096) -> None:
    """CPU seconds on a large image, one thread."""
    image = (rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))).astype(np.complex64)
    image[rng.integers(0, n, 4000), rng.integers(0, n, 4000)] += 60
    image = blurred(image, error(n, rng, rough=False))
    rows = []
    for method, fraction in (("pmea", 0.05), ("mea", 0.05), ("auto", None), ("pmea", 1.0)):
        start = time.process_time()
        result = featreg.focus(image, method, fraction=fraction)
        rows.append([method, fraction or "-", time.process_time() - start, result.iterations, result.status])
    print(f"\n## {n} x {n}\n\n{table(('method', 'fraction', 'CPU s', 'iterations', 'status'), rows)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--suite", default="simulated,gotcha,pulses,weak,registration,speed,trust")
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for the curves of Figures 5, 13 and 18")
    options = parser.parse_args()
    on_one_thread()
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    print(f"{machine()}; seed {options.seed}, {options.draws} draws, medians")
    real = (DATA / "gotcha").is_dir()
    wanted = list(METHODS)
    for suite in options.suite.split(","):
        rng = np.random.default_rng(options.seed)
        if suite in ("gotcha", "pulses", "registration") and not real:
            print(f"\n{suite}: left out, no images at {DATA / 'gotcha'}")
        elif suite == "simulated":
            for clutter, name in ((-40.0, "clutter -40 dB"), (None, "no clutter")):
                cases = [(simulated(rng, clutter), error(512, rng, rough=True)) for _ in range(options.draws)]
                compare(f"Table 2 and Figure 5: section 3.1, {name}", cases, options.out if clutter else None, wanted)
        elif suite == "gotcha":
            image = featreg.back_project(gotcha(0.0, 4.0)).pixels.astype(np.complex128)
            cases = [(image, error(len(image), rng, rough=True)) for _ in range(options.draws)]
            compare("Table 3 and Figure 13: real Gotcha, error in the image", cases, options.out, wanted)
        elif suite == "pulses":
            pulse_domain(options.draws, rng)
        elif suite == "weak":
            few = ["auto", "legendre", "pmea, 5 %", "pga", "pmea-paper, 10 %", "pga-paper"]
            for rough in (False, True):
                cases = [(low_contrast(rng), error(512, rng, rough=rough)) for _ in range(options.draws)]
                kind = "rough" if rough else "smooth"
                compare(f"Figure 18: low contrast, {kind} error", cases, None if rough else options.out, few)
        elif suite == "registration":
            registration(rng)
        elif suite == "speed":
            speed(rng)
        elif suite == "trust":
            trust(max(options.draws, 6), rng)
        else:
            raise SystemExit(f"unknown suite '{suite}'")


if __name__ == "__main__":
    main()
