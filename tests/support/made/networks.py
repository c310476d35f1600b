"""Networks of random weights."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any


def saved(module: Any, path: Path, wrap: str = "") -> str:
    """Random weights of a network in a file, as the authors of networks publish trained ones."""
    import torch

    state = module.state_dict()
    torch.save({wrap: state} if wrap else state, path)
    return str(path)


def seeded(make: Callable[[], Any]) -> Any:
    import torch

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return make()
