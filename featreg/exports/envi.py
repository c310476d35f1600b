"""ENVI image-to-image ground control points (``.pts``): base and warp pixels, first pixel's centre at (1.5, 1.5)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from featreg.errors import InputError
from featreg.exports.columns import lines_of, matches_of_array, numbers
from featreg.exports.content import Content
from featreg.types import Matches

PIXEL_OFFSET = 1.5


def write(content: Content, path: Path) -> None:
    """Write the reference as base image and the secondary as warp image."""
    both = np.hstack([content.matches.reference_xy, content.matches.secondary_xy]) + PIXEL_OFFSET
    head = [
        "; ENVI Image to Image GCP File",
        f"; base file: {content.reference.path}",
        f"; warp file: {content.secondary.path}",
        "; Base Image (x,y), Warp Image (x,y)",
        ";",
    ]
    rows = [" ".join(f"{value:16.6f}" for value in row) for row in both.tolist()]
    path.write_text("\n".join(head + rows) + "\n", encoding="utf-8", errors="backslashreplace")


def read(path: Path) -> Matches:
    """Read the base image as the reference and the warp image as the secondary."""
    lines = lines_of(path)
    comments = " ".join(line for line in lines if line.startswith(";")).lower()
    if "image to map" in comments or "map (x,y)" in comments:
        raise InputError("holds ENVI map coordinates; image to image points (base x, y, warp x, y) are needed")
    rows = [re.split(r"[,\s]+", line) for line in lines if not line.startswith(";")]
    values = numbers(rows).reshape(len(rows), -1) if rows else np.zeros((0, 4))
    return matches_of_array(values[:, :4] - PIXEL_OFFSET)
