"""What `featreg.focus` returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from featreg.types import FloatArray, Gate, IntArray, kept


@dataclass(frozen=True, eq=False)
class FocusResult:
    """What `featreg.focus` returns.

    Parameters
    ----------
    image : (H, W) complex64, focused; also where the result is unreliable
    phase : (N,) float64 radians, error of every pulse in the order of `numpy.fft.fft` along the azimuth; 0 for pulses
        that carry no signal. Its constant and linear part cannot be observed: the linear part shifts the image along
        the azimuth. (B, N) where the image was focused in B range blocks
    entropy : (iterations + 1,) nats, Eq. 1 over the range cells used, before the first and after every iteration
    iterations : how many
    cells : (K,) int64 ascending indices of the range cells used
    status : "ok" or "unreliable"
    reason : why it is unreliable; empty when ok
    deviation : expected error of the phase, radians RMS, constant and linear part apart
    image_entropy : nats of the whole image before and after
    gates : name -> Gate, every condition of "ok" with its value
    method : that was asked for
    block_edges : (B + 1,) first range cell of every block, and the end
    """

    image: NDArray[np.complex64]
    phase: FloatArray
    entropy: FloatArray
    iterations: int
    cells: IntArray
    status: str
    reason: str
    deviation: float
    image_entropy: tuple[float, float]
    gates: Mapping[str, Gate] = field(default_factory=dict)
    method: str = "auto"
    block_edges: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in ("image", "phase", "entropy", "cells"):
            object.__setattr__(self, name, kept(getattr(self, name)))
