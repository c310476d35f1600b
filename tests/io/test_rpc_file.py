"""RPC files beside images of formats for which GDAL does not look for them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geolocation import RpcSensor
from featreg.io import as_image
from featreg.io.rpc_file import read_rpc, rpc_beside, write_rpc
from featreg.simulate.orbit import RangeDoppler

SHAPE = (64, 80)


@pytest.fixture(scope="module")
def rpc() -> RpcSensor:
    view = RangeDoppler.over((12.0, 47.0), SHAPE, incidence_deg=35.0, heading_deg=-12.0, pixel=3.0, height=400.0)
    return view.rpc(SHAPE, 0.0, 800.0, 15.0)


@pytest.mark.parametrize("name", ["scene_RPC.TXT", "scene_rpc.txt", "scene.RPB", "scene.rpb"])
def test_what_was_written_is_read_beside_a_png(tmp_path: Path, rpc: RpcSensor, name: str) -> None:
    write_rpc(tmp_path / name, rpc.rpcs)
    assert read_rpc(tmp_path / name) == rpc.rpcs
    assert rpc_beside(tmp_path / "scene.png") == rpc.rpcs
    assert rpc_beside(tmp_path / "other.png") is None
    samples = np.random.default_rng(0).integers(1, 255, SHAPE).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "scene.png"), samples)
    place = as_image(tmp_path / "scene.png").geolocation
    assert place is not None
    assert place.rpcs == rpc.rpcs


def test_unknown_errors(tmp_path: Path, rpc: RpcSensor) -> None:
    write_rpc(tmp_path / "a.RPB", {**rpc.rpcs, "err_bias": None, "err_rand": None})
    assert read_rpc(tmp_path / "a.RPB")["err_bias"] is None


@pytest.mark.parametrize("name", ["a_RPC.TXT", "a.RPB"])
def test_broken_files_are_named(tmp_path: Path, rpc: RpcSensor, name: str) -> None:
    write_rpc(tmp_path / name, rpc.rpcs)
    text = (tmp_path / name).read_text()
    (tmp_path / name).write_text(text[: len(text) // 2])
    with pytest.raises(InputError, match="is no whole RPC file"):
        read_rpc(tmp_path / name)
    with pytest.raises(InputError, match="cannot be read"):
        read_rpc(tmp_path / f"other{name}")
