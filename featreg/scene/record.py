"""What the result of a scene records: a row for each block."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from featreg.scene.blocks import Block
from featreg.scene.task import BlockResult
from featreg.types import IntArray


def with_final(table: dict[str, list[Any]], owners: IntArray) -> dict[str, list[Any]]:
    """The block table with how many of the final tie points each block owns."""
    return {**table, "final": np.bincount(owners, minlength=len(table["status"])).tolist()}


def block_table(blocks: Sequence[Block], results: Sequence[BlockResult]) -> dict[str, list[Any]]:
    """One row a block, in columns."""
    by_index = {r.index: r for r in results}
    ordered = [by_index[block.index] for block in blocks]
    return {
        "row": [b.row for b in blocks],
        "col": [b.col for b in blocks],
        "x": [b.window.x for b in blocks],
        "y": [b.window.y for b in blocks],
        "width": [b.window.width for b in blocks],
        "height": [b.window.height for b in blocks],
        "status": [r.status for r in ordered],
        "reason": [r.reason for r in ordered],
        "putative": [len(r.matches) for r in ordered],
        "kept": [int(r.supported.sum()) for r in ordered],
        "refined": [len(r.refined) for r in ordered],
    }


def searched_in(results: Sequence[BlockResult]) -> dict[str, list[dict[str, Any]]]:
    """Where tie points were looked for, and in how many blocks so, the most first; empty where nobody tells."""
    ways: dict[str, list[BlockResult]] = {}
    for result in results:
        if result.searched:
            ways.setdefault(json.dumps(result.searched, sort_keys=True), []).append(result)
    ordered = sorted(ways.values(), key=len, reverse=True)
    return {"searched": [{**alike[0].searched, "blocks": len(alike)} for alike in ordered]} if ordered else {}


def seconds_of(results: Sequence[BlockResult]) -> dict[str, float]:
    """Seconds of all blocks computed now together, by stage."""
    total: dict[str, float] = {}
    for result in results:
        for name, seconds in result.seconds.items():
            total[name] = total.get(name, 0.0) + seconds
    return total
