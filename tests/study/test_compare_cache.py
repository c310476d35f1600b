"""A cache of predictions trusts nothing that it cannot prove."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.study.comparison import compare
from featreg.study.table import Table
from made.stand_ins import TRUTH, Calls, Stand, noise_image

pytestmark = pytest.mark.usefixtures("calls")


class Opaque:
    """A method object whose content nobody can know."""


def test_cache_saves_every_call_and_knows_its_inputs(tmp_path: Path, calls: Calls) -> None:
    pair = (noise_image(0), noise_image(1), TRUTH)
    first = compare([pair], ["sharp", "blunt", Stand()], cache=tmp_path / "kept")
    assert len(calls) == 6
    calls.clear()
    assert list(compare([pair], ["sharp", "blunt", Stand()], cache=tmp_path / "kept").rows) == list(first.rows)
    assert calls == []

    def computed(**changes: Any) -> int:
        calls.clear()
        given: dict[str, Any] = {
            "pair": pair,
            "method": "sharp",
            "warm_up": False,
            "cache": tmp_path / "kept",
        } | changes
        compare([given.pop("pair")], [given.pop("method")], **given)
        return len(calls)

    assert computed() == 0
    assert computed(threshold=0.1) == 0
    assert computed(pair=(noise_image(0), noise_image(1))) == 0
    assert computed(pair=(noise_image(0), noise_image(2), TRUTH)) == 1
    assert computed(seed=1) == 1
    assert computed(n_features=100) == 1
    assert computed(reference_mask=np.zeros(3)) == 1
    assert computed(reference_mask=np.ones(3)) == 1
    assert computed(reference_mask=np.ones(3)) == 0
    assert computed(initial=TRUTH) == 1
    assert computed(method=Stand(count=3)) == 1
    assert computed(method=Stand(weights=np.zeros(5000))) == 1
    assert computed(method=Stand(weights=np.arange(5000) == 2500)) == 1
    assert computed(method=Stand(weights=np.arange(5000) == 2501)) == 1


def test_what_has_no_certain_digest_is_not_kept(tmp_path: Path, calls: Calls) -> None:
    for _ in range(2):
        compare([(noise_image(0), noise_image(1))], [Stand(weights=Opaque())], cache=tmp_path, warm_up=False)
        compare([(noise_image(0), noise_image(1))], [("f", {"hook": lambda x: x})], cache=tmp_path, warm_up=False)
    assert len(calls) == 4
    assert list(tmp_path.iterdir()) == []


def test_files_are_known_by_their_bytes(tmp_path: Path, calls: Calls) -> None:
    a, b = tmp_path / "a.npy", tmp_path / "b.npy"
    np.save(a, noise_image(0))
    np.save(b, noise_image(1))
    (row,) = compare([(str(a), b)], ["sharp"], cache=tmp_path / "kept", warm_up=False).rows
    assert row["pair"] == "a / b"
    compare([(a, b)], ["sharp"], cache=tmp_path / "kept", warm_up=False)
    assert len(calls) == 1
    np.save(b, noise_image(2))
    compare([(a, b)], ["sharp"], cache=tmp_path / "kept", warm_up=False)
    assert len(calls) == 2


@pytest.mark.parametrize("harm", ["truncate", "foreign", "empty", "text", "stale key"])
def test_a_poisoned_cache_is_computed_afresh(harm: str, tmp_path: Path, calls: Calls) -> None:
    pair = (noise_image(0), noise_image(1), TRUTH)

    def run(method: str) -> Table:
        return compare([pair], [method], cache=tmp_path, warm_up=False)

    clean = run("sharp")
    (file,) = tmp_path.iterdir()
    content = file.read_bytes()
    if harm == "truncate":
        file.write_bytes(content[: len(content) // 2])
    elif harm == "foreign":
        run("blunt")
        (other,) = (f for f in tmp_path.iterdir() if f != file)
        file.write_bytes(other.read_bytes())
    elif harm == "stale key":
        file.write_text(file.read_text().replace(file.stem, "0" * 64))
    else:
        file.write_bytes(b"" if harm == "empty" else b"\x00\xffnot JSON")
    calls.clear()
    assert [row["nm"] for row in run("sharp").rows] == [row["nm"] for row in clean.rows]
    assert len(calls) == 1
    assert run("sharp").rows[0]["rmse"] == clean.rows[0]["rmse"]
    assert len(calls) == 1


def test_failures_are_not_kept_and_times_of_a_pool_are_not_trusted(tmp_path: Path, calls: Calls) -> None:
    compare([(noise_image(0), noise_image(1))], ["broken"], cache=tmp_path, warm_up=False)
    assert list(tmp_path.iterdir()) == []
    with ThreadPoolExecutor(1) as executor:
        compare([(noise_image(0), noise_image(1))], ["sharp"], cache=tmp_path, executor=executor, timing=False)
    calls.clear()
    (row,) = compare([(noise_image(0), noise_image(1))], ["sharp"], cache=tmp_path, warm_up=False).rows
    assert len(calls) == 1
    assert row["time_s"] == 0.5
