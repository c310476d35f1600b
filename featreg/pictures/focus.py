"""The picture of an autofocus: the image before and after, and the entropy of the range cells over the iterations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.focusing import FocusResult
from featreg.pictures.panels import views_to_draw_on
from featreg.pictures.sheet import FAINT, Note, Sheet, checked_target
from featreg.types import FloatArray, Image

#: Colours of a trusted and of a distrusted verdict, and of the curve.
GOOD, BAD, CURVE = (0, 130, 100), (200, 75, 0), (0, 90, 160)
#: Width and height of the panel of the curve, of the panel of the phase, in inches at DPI.
WIDTH, HEIGHT, DPI = 7.5, 3.0, 100


def draw_focus(before: Image, result: FocusResult, path: str | Path) -> None:
    """Write one PNG: amplitude before and after at the same stretch, entropy and phase.

    Raises
    ------
    InputError
        The folder is missing or the name does not end in .png.
    """
    checked_target(path)
    after = Image(result.image, before.mask, None, before.name, "complex64", "complex")
    good = result.status == "ok"
    header = [
        [Note(f"autofocus: {result.method}", bold=True), Note(result.status, GOOD if good else BAD, bold=True),
         *([] if good else [Note(result.reason, BAD)])],
        [Note(f"entropy of the image {result.image_entropy[0]:.4f} before, {result.image_entropy[1]:.4f} after"),
         Note(f"{result.iterations} iterations on {len(result.cells)} range cells", FAINT)],
    ]  # fmt: skip
    if np.isfinite(result.deviation):
        header[1].append(Note(f"expected phase error {result.deviation:.3f} rad RMS", FAINT))
    images = views_to_draw_on(before, after)
    labels = ["before", "after", "entropy of the range cells used (Eq. 1, nats) over the iterations",
              "phase over the pulses (rad), constant and linear part taken out"]  # fmt: skip
    Sheet([images, [_curve(result.entropy), _phase(result)]], labels, header).write(path)


def _curve(entropy: FloatArray) -> NDArray[np.uint8]:
    return _panel([(np.arange(len(entropy), dtype=np.float64), entropy)], "iteration")


def _phase(result: FocusResult) -> NDArray[np.uint8]:
    """The phase in the order of the pulses, smooth where it is, of every range block."""
    curves = []
    for row in np.atleast_2d(result.phase):
        power = np.where(row != 0, 1.0, 0.0)
        if power.any():
            from featreg.focusing.phase_error import Band

            band = Band.of(power)
            curves.append((band.place, np.unwrap(band.detrended(row)[band.order])))
    return _panel(curves, "pulse, from one end of the band to the other")


def _panel(curves: list[tuple[FloatArray, FloatArray]], label: str) -> NDArray[np.uint8]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI, layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    for number, (x, y) in enumerate(curves):
        shade = 0.65 * number / max(len(curves) - 1, 1)
        colour = [c / 255 + (1 - c / 255) * shade for c in CURVE]
        axes.plot(x, y, color=colour, linewidth=1.4)
    axes.set_xlabel(label)
    axes.margins(x=0.01)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
