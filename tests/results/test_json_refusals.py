"""The JSON of a registration: files that it did not write, or that are not whole, are refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.results.json_file import MAX_ROWS, registration_to_dict
from featreg.results.registration import Registration
from made.written_results import registration


def test_parquet_file_of_another_result_is_refused(tmp_path: Path) -> None:
    registration(count=MAX_ROWS + 1, refined=0).to_json(tmp_path / "a.json")
    registration(count=MAX_ROWS + 1, refined=0, seed=4).to_json(tmp_path / "b.json")
    (tmp_path / "b.tie_points.parquet").replace(tmp_path / "a.tie_points.parquet")
    with pytest.raises(InputError, match=r"a\.tie_points\.parquet.*written with it"):
        Registration.from_json(tmp_path / "a.json")
    with pytest.raises(InputError, match="cannot read"):
        Registration.from_json(tmp_path / "b.json")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_file_is_refused_in_one_line(share: float, tmp_path: Path) -> None:
    file = tmp_path / "out.json"
    registration().to_json(file)
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"out\.json") as caught:
        Registration.from_json(file)
    assert "\n" not in str(caught.value)


def test_foreign_and_spoiled_files_are_refused(tmp_path: Path) -> None:
    good = registration_to_dict(registration())
    wrong: list[Any] = [
        [],
        3,
        {"hello": 1},
        {**good, "schema_version": 2},
        {k: v for k, v in good.items() if k != "counts"},
        {**good, "counts": {**good["counts"], "gms": 1}},
        {**good, "tie_points": {**good["tie_points"], "rows": [[1, 2], [3]]}},
        {**good, "tie_points": {**good["tie_points"], "columns": ["x"]}},
        {**good, "tie_points": {"file": "../../secret.parquet", "columns": [], "sha256": ""}},
        {**good, "tie_points": None},
        {**good, "model": {"type": "no-such-model", "parameters": {}}},
        {**good, "gates": {"count": {"colour": 1}}},
        {**good, "gates": {"count": {**good["gates"]["count"], "passed": False}}},
        {**good, "status": "perfect"},
    ]
    file = tmp_path / "spoiled.json"
    for data in wrong:
        file.write_text(json.dumps(data))
        with pytest.raises(InputError, match=r"spoiled\.json") as caught:
            Registration.from_json(file)
        assert "\n" not in str(caught.value)
    file.write_bytes(bytes(range(256)))
    with pytest.raises(InputError):
        Registration.from_json(file)
    with pytest.raises(InputError, match="cannot read"):
        Registration.from_json(tmp_path / "missing.json")


def test_a_folder_that_does_not_exist_and_a_reserved_filter_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write"):
        registration().to_json(tmp_path / "nowhere" / "out.json")
    with pytest.raises(InputError, match="putative"):
        registration(stages={"putative": np.ones(75, dtype=bool)}).to_json(tmp_path / "out.json")
    assert list(tmp_path.iterdir()) == []
