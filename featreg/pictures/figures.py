"""Figures of matplotlib as PNG files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from featreg.runtime.files import write_atomic


def written(figure: Any, path: str | Path) -> None:
    """Write a figure; the file appears whole or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    write_atomic(path, buffer.getbuffer())
