"""Figures 3 to 18 of the PMEA paper: scenes, phase error, entropy over the iterations, and the images they lead to."""

from __future__ import annotations

from typing import Any

import autofocus
import numpy as np
from measuring import DATA
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.focusing import FocusResult
from featreg.focusing.azimuth_filter import image_entropy
from featreg.io import as_image
from featreg.types import FloatArray
from figures.page import Figure, axes, ranked, show

PAPER = "Autofocus by minimum entropy on Prewitt feature points (PMEA)"
SAID = (
    "Its error function (Eq. 10), its threshold and its measured images are not in the copy at hand. The scene of "
    "section "
    "3.1 is simulated, one aperture of Gotcha stands for the metal tube of 3.2.1 and weak texture for the wall of "
    "3.2.2. "
    "Entropies are those of the image, moved as the truth has it, in nats."
)
#: What is cut out in the zoomed views, px.
ZOOM = 160
Run = tuple[str, str, dict[str, Any]]
SIMULATED: tuple[Run, ...] = (("PMEA", "pmea-paper", {}), ("MEA", "mea-paper", {}), ("MCA", "mca-paper", {}))
WEAK: tuple[Run, ...] = (("PMEA, 10 %", "pmea-paper", {"fraction": 0.1}), ("PGA", "pga-paper", {}))
DEFAULT: Run = ("auto (featreg's default)", "auto", {})


def _entropies(clean: NDArray[Any], phase: FloatArray, run: Run, steps: list[int]) -> tuple[list[float], FocusResult]:
    """Entropy of the image after at most so many iterations each, and the last result."""
    image, band = autofocus.blurred(clean, phase), autofocus.band_of(clean)
    made = [featreg.focus(image, run[1], max_iterations=n, **run[2]) for n in steps]
    return [image_entropy(image), *(autofocus.aligned_entropy(clean, phase, m.phase, band) for m in made)], made[-1]


def entropy(
    number: str, what: str, clean: NDArray[Any], phase: FloatArray, runs: tuple[Run, ...], most: int, beside: str
) -> tuple[Figure, dict[str, FocusResult]]:
    """Entropy against the most iterations allowed, as Figures 5, 13 and 18 have it; and the last results."""
    steps = [n for n in (1, 2, 4, 6, 8, 10, 14, 20, 30, 45, 60) if n <= most]
    drawn, places = axes(1, 1, (8, 4.4))
    place, said, results = places[0, 0], [], {}
    ends: dict[str, float] = {}
    place.axhline(image_entropy(clean), color="0.7", linewidth=3, label="without error")
    band = autofocus.band_of(clean)
    for run in (*runs, DEFAULT):
        values, results[run[0]] = _entropies(clean, phase, run, steps)
        residual = band.difference(phase, results[run[0]].phase)
        place.plot([0, *steps], values, "--" if run is DEFAULT else "-", label=run[0])
        ends[run[0]] = values[-1]
        said.append(f"{run[0]} {values[-1]:.2f} nats, {residual:.2f} rad off, {results[run[0]].status}")
    place.set(xlabel="iterations", ylabel="entropy, nats")
    place.legend(fontsize=9)
    text = f"{what}; without error {image_entropy(clean):.2f} nats. At the end: {'; '.join(said)}."
    order = ranked({name: ends[name] for name, _, _ in runs}, digits=2)
    return Figure.of(number, "Entropy over the iterations", text, f"{beside} Here, in nats: {order}.", drawn), results


def scene(clean: NDArray[Any]) -> Figure:
    """Figure 3: the scene of point targets."""
    drawn, places = axes(1, 1, (6, 6))
    show(places[0, 0], clean, "", 50)
    return Figure.of(
        "Figure 3", "The simulated scene",
        "20 points of amplitude 1 upper left, one in each range cell (columns), and 20 of amplitude 1.5 lower right, "
        "all in one range cell: strong scatterers, concentrated. Clutter at -40 dB.",
        "The paper's rows are written as horizontal and vertical; which of its axes is range is not said. Ours makes "
        "the "
        "strong ones share a range cell, as its argument needs.", drawn,
    )  # fmt: skip


def phase_error(phase: FloatArray) -> Figure:
    """Figure 4: the phase error that is put on."""
    drawn, places = axes(1, 1, (7, 3.4))
    places[0, 0].plot(np.fft.fftshift(phase), linewidth=0.8)
    places[0, 0].set(xlabel="azimuth pulse", ylabel="phase error, radians")
    return Figure.of(
        "Figure 4", "The phase error", "A polynomial of fourth degree, a sine and 0.1 radians of noise.",
        "The paper's own (Eq. 10) is missing from the text at hand.", drawn,
    )  # fmt: skip


def focused(
    numbers: str, clean: NDArray[Any], phase: FloatArray, results: dict[str, FocusResult], beside: str, zoom: bool
) -> Figure:
    """What the methods make of the defocused image, as Figures 6 to 8, 9 to 11 and 14 to 17 show it."""
    images = {"without error": clean, "defocused": autofocus.blurred(clean, phase)}
    images |= {f"{name} ({made.status})": made.image for name, made in results.items()}
    columns = 3
    rows = -(-len(images) // columns)
    drawn, places = axes(rows, columns, (12, 4.2 * rows))
    for place in places.ravel():
        place.axis("off")
    for place, (name, image) in zip(places.ravel(), images.items(), strict=False):
        place.axis("on")
        n = len(image) // 2
        part = image[n - ZOOM // 2 : n + ZOOM // 2, n - ZOOM // 2 : n + ZOOM // 2] if zoom else image
        show(place, part, f"{name}, {image_entropy(image):.2f} nats", 50)
    cut = f" The middle {ZOOM} x {ZOOM} px." if zoom else ""
    return Figure.of(
        numbers,
        "Images after autofocus",
        f"Azimuth runs down.{cut} A shift by part of a pixel moves these entropies.",
        beside,
        drawn,
    )


def feature_points(image: NDArray[Any]) -> Figure:
    """Figure 12: the feature points of the defocused image."""
    found = registry.create("detector", "prewitt", n_features=1_000_000).detect_features(as_image(image))
    drawn, places = axes(1, 2, (11, 5.6))
    show(places[0, 0], image, "defocused", 50)
    cells = np.bincount(found.xy[:, 0].astype(int), minlength=image.shape[1])
    places[0, 1].plot(*found.xy.T, ",", color="black")
    chosen = np.argsort(-cells, kind="stable")[: round(0.05 * len(cells))]
    for cell in chosen:
        places[0, 1].axvline(cell, color="tab:red", linewidth=0.4, alpha=0.6)
    places[0, 1].set(xlim=(0, image.shape[1]), ylim=(len(image), 0), aspect="equal", xticks=[], yticks=[],
                     title="feature points; red: the 5 % of range cells with most")  # fmt: skip
    return Figure.of(
        "Figure 12", "Prewitt feature points of the defocused image",
        f"{len(found)} points above 4 times the mean gradient (the paper's threshold is missing).",
        "In the paper the outline of what is there shows in spite of the defocus.", drawn,
    )  # fmt: skip


def figures(seed: int) -> list[Figure]:
    rng = np.random.default_rng(seed)
    clean, phase = autofocus.simulated(rng, -40.0), autofocus.error(512, rng, rough=True)
    drawn, results = entropy(
        "Figure 5", "The scene of Figure 3 with the error of Figure 4", clean, phase, SIMULATED, 60,
        "In the paper PMEA ends lowest (8.50), then MEA (8.89), then MCA (9.56). A phase far from the one put on means "
        "that the row that shares a range cell was collapsed.",
    )  # fmt: skip
    made = [scene(clean), phase_error(phase), drawn]
    made.append(focused("Figures 6 to 8", clean, phase, results,
                        "The paper shows visible defocus for MEA and MCA and none for PMEA.", zoom=False))  # fmt: skip
    if (DATA / "gotcha").is_dir():
        image = featreg.back_project(autofocus.gotcha(0.0, 4.0)).pixels.astype(np.complex128)
        phase = autofocus.error(len(image), rng, rough=True)
        drawn, results = entropy(
            "Figure 13", "Three degrees of Gotcha with an error put on", image, phase, SIMULATED, 60,
            "In the paper PMEA 12.23, MEA 12.3, MCA 12.54 nats.",
        )  # fmt: skip
        made.append(
            focused(
                "Figures 9 to 11",
                image,
                phase,
                results,
                "Another scene than the paper's.",
                zoom=True,
            )
        )
        made += [feature_points(autofocus.blurred(image, phase)), drawn]  # fmt: skip
    weak = autofocus.low_contrast(rng)
    phase = autofocus.error(len(weak), rng, rough=False)
    drawn, results = entropy(
        "Figure 18", "Speckle on fields that differ by 3 dB", weak, phase, WEAK, 30,
        "In the paper PMEA on 10 % of the cells converges below PGA, which fails.",
    )  # fmt: skip
    beside = "In the paper PMEA is sharp and PGA is not; what each says of itself here stands above its image."
    made.append(focused("Figures 14 and 15", weak, phase, results, beside, zoom=False))
    made.append(focused("Figures 16 and 17", weak, phase, results, "The middle of the images before.", zoom=True))
    return [*made, drawn]
