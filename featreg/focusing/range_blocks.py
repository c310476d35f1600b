"""Autofocus with an error that changes over range: one phase per block of range cells, aligned from block to block."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.focusing.azimuth_filter import apply_phase, image_entropy
from featreg.focusing.phase_error import Band
from featreg.focusing.pulse_spectra import pulse_spectra
from featreg.focusing.range_cells import cell_energies
from featreg.focusing.result import FocusResult
from featreg.types import BoolArray, FloatArray, Gate, read_only, verdict

Whole = Callable[[NDArray[Any], FloatArray, float], FocusResult]


def focus_blocks(
    pixels: NDArray[Any],
    mask: BoolArray | None,
    azimuth_axis: int,
    edges: Sequence[int],
    before: float,
    workers: int,
    whole: Whole,
) -> FocusResult:
    """Focus every block of range cells by itself.

    Parameters
    ----------
    pixels, mask : (H, W) complex, and which samples are data (None = all)
    azimuth_axis : 0 or 1
    edges : (B + 1,) first range cell of every block, and the end
    before : entropy of the image
    workers : threads
    whole : focuses one block from its samples, energies and entropy

    Returns
    -------
    FocusResult
        `phase` (B, N). A block that is empty, or whose own phase is not trusted, gets that of its nearest trusted
        neighbour; the result is unreliable where fewer than half of the blocks are trusted.

    Notes
    -----
    Constant and linear phase of a block cannot be observed, and would shift blocks against each other: each block's
    are chosen so that its phase differs least from that of the trusted block before it.
    """

    def block(array: NDArray[Any], number: int) -> NDArray[Any]:
        part = slice(edges[number], edges[number + 1])
        return array[:, part] if azimuth_axis == 0 else array[part]

    count = len(edges) - 1
    found: list[FocusResult | None] = []
    for number in range(count):
        here = block(pixels, number)
        energy = cell_energies(here, azimuth_axis, None if mask is None else block(mask, number), workers=workers)
        if not energy.any():
            found.append(None)
            continue
        result = whole(here, energy, image_entropy(here, workers=workers))
        # The blocks' own images are formed again from aligned phases: none is kept.
        found.append(replace(result, image=np.zeros((1, 1), np.complex64)))
    trusted = [i for i, result in enumerate(found) if result is not None and result.status == "ok"]
    used = trusted or [i for i, result in enumerate(found) if result is not None]
    phases = _aligned(pixels, azimuth_axis, edges, [found[i] for i in used], used)
    rows = [int(np.abs(np.array(used) - number).argmin()) for number in range(count)]
    phase = np.array([phases[row] for row in rows])
    out = np.empty(pixels.shape, np.complex64)
    for number in range(count):
        apply_phase(block(pixels, number), phase[number], azimuth_axis, block(out, number), workers=workers)
    after = image_entropy(out, workers=workers)
    gates = {
        "blocks": Gate(len(trusted), count / 2, None, "blocks with a trusted phase"),
        "entropy": Gate(after - before, None, 0.01, "rise of the image's entropy, nats"),
    }
    results = [found[i] for i in used]

    def reason(failed: Mapping[str, Gate]) -> str:
        if "blocks" not in failed:
            return f"the entropy of the image rose: {after - before:.2f}"
        reasons = [result.reason for result in found if result is not None and result.reason]
        first = reasons[0] if reasons else "they are empty"
        return f"only {len(trusted)} of {count} range blocks have a trusted phase; {first}"

    cells = [result.cells + edges[i] for i, result in zip(used, results, strict=True) if result is not None]
    known = [result for result in results if result is not None]
    return FocusResult(
        read_only(out), phase, _mean_entropy(known), max(result.iterations for result in known), np.concatenate(cells),
        *verdict(gates, reason), max(result.deviation for result in known), (before, after), gates,
        known[0].method, tuple(edges),
    )  # fmt: skip


def _aligned(
    pixels: NDArray[Any], axis: int, edges: Sequence[int], found: Sequence[FocusResult | None], used: Sequence[int]
) -> list[FloatArray]:
    """The phases of the blocks, constant and linear terms chosen so that each differs least from the one before."""
    phases: list[FloatArray] = []
    for result, number in zip(found, used, strict=True):
        phase = result.phase if result is not None else np.zeros(pixels.shape[axis])
        if phases and result is not None:
            cells = pulse_spectra(pixels, axis, result.cells + edges[number])
            band = Band.of(cells.power())
            rest = band.without_line(phase - phases[-1])
            phase = band.spread(np.angle(np.exp(1j * (phases[-1][band.order] + rest))))
        phases.append(phase)
    return phases


def _mean_entropy(results: Sequence[FocusResult]) -> FloatArray:
    """Mean over the blocks, each kept at its last value once it has ended."""
    longest = max(len(result.entropy) for result in results)
    padded = [np.pad(result.entropy, (0, longest - len(result.entropy)), "edge") for result in results]
    return np.asarray(np.mean(padded, axis=0))
