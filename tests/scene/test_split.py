"""The secondary of a scene divided in proportion, as section 2.2 of the SAR-ORB paper has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.cli.main import main
from featreg.errors import ParameterError
from featreg.io.window import Window
from featreg.scene.blocks import plan_blocks, proportional_part


def test_parts_tile_the_other_rectangle_in_the_same_order() -> None:
    area, other = Window(7, 3, 1234, 777), Window(100, -4, 1301, 700)
    owned = np.zeros((700, 1301), np.int64)
    for block in plan_blocks(area, 200):
        part = proportional_part(block.window, area, other)
        owned[part.y + 4 : part.y + 4 + part.height, part.x - 100 : part.x - 100 + part.width] += 1
        assert abs(part.width / block.window.width - 1301 / 1234) < 0.01
    assert (owned == 1).all()


def test_blocks_divided_in_proportion_find_the_truth_without_a_margin(located_pair: Any) -> None:
    images = located_pair.reference, located_pair.secondary
    made = featreg.match(*images, method="sar-orb-paper", block=350, split="proportional", workers=1)
    assert made.status == "ok", made.reason
    assert made.provenance["blocks"]["halo"] == 0
    scores = featreg.evaluate(made, located_pair.truth)
    assert (scores.stage, made.provenance["blocks"]["total"]) == ("gms", 4)
    assert scores.ncm > 150
    assert scores.grid_rmse < 0.6
    # The windows overlap nowhere: what lies across a rim of the secondary's parts is not found.
    wide = featreg.match(*images, method="sar-orb-paper", block=350, workers=1)
    assert wide.provenance["blocks"]["halo"] > 0
    assert featreg.evaluate(wide, located_pair.truth).precision >= 0.9 * scores.precision


def test_what_does_not_go_with_it_is_said(pair: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ParameterError, match="split must be 'prior' or 'proportional', got 'equal'"):
        featreg.match(pair.reference, pair.secondary, split="equal")
    with pytest.raises(ParameterError, match="split is for blocks"):
        featreg.match(pair.reference, pair.secondary, split="proportional", block=False)
    assert main(["match", "a.tif", "b.tif", "--split", "prior", "--whole"]) == 2
    assert "--whole works on the whole images, --split is for blocks" in capsys.readouterr().err
