"""ENVI image-to-image ground control points (``.pts``): base and warp pixels, first pixel's centre at (1.5, 1.5)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from featreg.exports.content import Content
from featreg.exports.reading import PIXEL_OFFSETS


def write(content: Content, path: Path) -> None:
    """Write the reference as base image and the secondary as warp image."""
    both = np.hstack([content.matches.reference_xy, content.matches.secondary_xy]) + PIXEL_OFFSETS["envi"]
    head = [
        "; ENVI Image to Image GCP File",
        f"; base file: {content.reference.path}",
        f"; warp file: {content.secondary.path}",
        "; Base Image (x,y), Warp Image (x,y)",
        ";",
    ]
    rows = [" ".join(f"{value:16.6f}" for value in row) for row in both.tolist()]
    path.write_text("\n".join(head + rows) + "\n", encoding="utf-8")
