"""Prepared kernels that serve a test, and bytes that are changed."""

from __future__ import annotations

from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

from featreg.runtime import jit
from featreg.warming import stale_kernels

#: Kernels whose source was changed compile when they are called, until they are translated again.
CHANGED = stale_kernels()


def in_place(module: Any) -> None:
    if module.__name__ in CHANGED:
        pytest.skip(f"{module.__name__} was changed: `make kernels` translates it again")


def changed(kernel: Any, path: Path) -> Any:
    """The same kernel as of another file."""
    code = kernel.function.__code__.replace(co_filename=str(path))
    return jit.Kernel(FunctionType(code, kernel.function.__globals__, kernel.function.__name__), "never")
