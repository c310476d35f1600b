"""A sheet of picture panels with labels, lines between panels and a header, written as PNG pixel for pixel."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.runtime.files import write_atomic
from featreg.types import FloatArray

Colour = tuple[int, int, int]
PAPER, INK, FAINT = (255, 255, 255), (30, 30, 30), (105, 105, 105)
#: Pixels between panels and around the sheet, height of a line of text, least width of a sheet.
GAP, LINE, NARROWEST = 12, 24, 760
#: Pixels of letters; the drawing library counts 72 points to its 100 pixels.
LETTER, DPI = 15, 100


@dataclass(frozen=True)
class Note:
    """A piece of the header: its text, colour and weight, and whether a dot of its colour stands before it."""

    text: str
    colour: Colour = INK
    bold: bool = False
    dot: bool = False


@dataclass(frozen=True, eq=False)
class Lines:
    """(K, 2) positions in the panels 0 and 1, in panel pixels: dots of one colour, the first `joined` with lines."""

    start: FloatArray
    end: FloatArray
    colour: Colour
    joined: int


@dataclass(frozen=True, eq=False)
class Sheet:
    """Rows of panels, each (h, w) gray or (h, w, 3) RGB uint8, a label over each, and paragraphs of notes on top."""

    rows: Sequence[Sequence[NDArray[np.uint8]]]
    labels: Sequence[str]
    header: Sequence[Sequence[Note]] = ()
    lines: Sequence[Lines] = field(default=())

    def write(self, path: str | Path) -> None:
        """Write the sheet as PNG, whole or not at all.

        Raises
        ------
        InputError
            The folder is missing or the name does not end in .png.
        """
        target = checked_target(path)
        import cv2

        canvas: Any = self.figure().canvas
        canvas.draw()
        _, encoded = cv2.imencode(".png", np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., 2::-1]))
        write_atomic(target, encoded.tobytes())

    def figure(self) -> Any:
        """Return the sheet as a `matplotlib.figure.Figure`, pixel for pixel at its own resolution."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        inner = max([sum(p.shape[1] + GAP for p in row) - GAP for row in self.rows] + [NARROWEST])
        agg: Any = FigureCanvasAgg(Figure(dpi=DPI))
        scratch = agg.get_renderer()
        placed, top = _flowed(self.header, inner, scratch)
        places = []
        for row in self.rows:
            left = GAP + (inner - sum(p.shape[1] + GAP for p in row) + GAP) // 2
            for panel in row:
                places.append((left, top + LINE))
                left += panel.shape[1] + GAP
            top += LINE + max(p.shape[0] for p in row) + GAP // 2
        panels = [p for row in self.rows for p in row]
        size = (inner + 2 * GAP, top + GAP // 2)
        canvas = np.full((size[1], size[0], 3), PAPER, np.uint8)
        for (x, y), panel in zip(places, panels, strict=True):
            h, w = panel.shape[:2]
            canvas[y : y + h, x : x + w] = panel if panel.ndim == 3 else panel[..., None]
        figure = figure_class()(figsize=(size[0] / DPI, size[1] / DPI), dpi=DPI)
        figure.figimage(canvas, origin="upper", zorder=-1)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        axes.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5))
        for lines in self.lines:
            _draw_lines(axes, lines, np.array(places[0]), np.array(places[1]))
        for (x, y), panel, label in zip(places, panels, self.labels, strict=True):
            # over a narrow panel only the name fits, not what follows the colon
            fits = _width(Note(label), scratch) <= panel.shape[1]
            _text(axes, x, y - LINE / 2, Note(label if fits else label.split(":")[0], FAINT))
        for x, y, note in placed:
            if note.dot:
                axes.plot([x + 6], [y], "o", color=_rgb(note.colour), markersize=7)
            _text(axes, x + 18 * note.dot, y, note)
        return figure


@cache
def figure_class() -> Any:
    """Return the class of the figures made here: matplotlib's, which a notebook shows without pyplot too."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class Drawing(Figure):
        """A figure that belongs to no window: ``savefig`` writes it, a notebook shows it."""

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            FigureCanvasAgg(self)

        def _repr_png_(self) -> bytes:
            file = io.BytesIO()
            self.savefig(file, format="png")
            return file.getvalue()

    return Drawing


def checked_target(path: str | Path) -> Path:
    """The path, if a PNG can be written there."""
    target = Path(path)
    if target.suffix.lower() != ".png":
        raise InputError(f"pictures are written as PNG, give a name that ends in .png, got '{target.name}'")
    if not target.parent.is_dir():
        raise InputError(f"the folder '{target.parent}' for the picture '{target.name}' does not exist")
    return target


def _rgb(colour: Colour) -> tuple[float, float, float]:
    return colour[0] / 255, colour[1] / 255, colour[2] / 255


def _style(note: Note) -> dict[str, Any]:
    return {"fontsize": LETTER * 72 / DPI, "fontweight": "bold" if note.bold else "normal"}


def _text(axes: Any, x: float, y: float, note: Note) -> None:
    # a file name may hold a dollar sign, which would start a formula
    axes.text(x, y, note.text, color=_rgb(note.colour), va="center_baseline", parse_math=False, **_style(note))


def _width(note: Note, renderer: Any) -> int:
    """Pixels from the first letter of the note to its last."""
    from matplotlib.font_manager import FontProperties

    style = _style(note)
    properties = FontProperties(weight=style["fontweight"], size=style["fontsize"])
    return int(np.ceil(renderer.get_text_width_height_descent(note.text, properties, False)[0]))


def _flowed(paragraphs: Sequence[Sequence[Note]], width: int, renderer: Any) -> tuple[list[tuple[int, int, Note]], int]:
    """Notes placed from left to right, words wrapped at `width`; also the y below the last line."""
    placed: list[tuple[int, int, Note]] = []
    y = GAP // 2
    for notes in paragraphs:
        x = GAP
        for note in notes:

            def length(text: str, bold: bool = note.bold) -> int:
                return _width(Note(text, bold=bold), renderer)

            words, lead = note.text.split(" "), 18 * note.dot
            if x > GAP and x + lead + length(note.text) > GAP + width:
                x, y = GAP, y + LINE
            while words:
                fitting = max(
                    (n for n in range(1, len(words) + 1) if x + lead + length(" ".join(words[:n])) <= GAP + width),
                    default=1,
                )
                piece = Note(" ".join(words[:fitting]), note.colour, note.bold, note.dot and lead > 0)
                placed.append((x, y + LINE // 2, piece))
                words = words[fitting:]
                x += lead + length(piece.text) + 22
                if words:
                    x, y, lead = GAP, y + LINE, 0
        y += LINE
    return placed, y


def _draw_lines(axes: Any, lines: Lines, first: NDArray[Any], second: NDArray[Any]) -> None:
    from matplotlib.collections import LineCollection

    ends = np.stack([lines.start + first, lines.end + second], axis=1)
    opacity = float(np.clip(40 / max(lines.joined, 1), 0.6, 0.9))
    colour = (*_rgb(lines.colour), opacity)
    axes.add_collection(LineCollection(list(ends[: lines.joined]), colors=[colour], linewidths=0.8))
    for xy in (ends[:, 0], ends[:, 1]):
        # a dark rim keeps the dots apart from bright ground
        axes.plot(*xy.T, "o", color=_rgb(lines.colour), markersize=4.2, markeredgewidth=0.6, markeredgecolor="#202020")
