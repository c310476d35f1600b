"""Digests: equal for equal content, another for any other."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.runtime.digests import digest_arrays, digest_bytes, digest_file, digest_json, digest_value


@dataclass
class Part:
    size: int
    name: str = "a"
    memory: list[int] = field(default_factory=list, init=False)


def test_bytes_files_and_arrays_are_plain_sha256(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    right = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert digest_bytes(b"abc") == digest_file(tmp_path / "a") == digest_bytes(np.frombuffer(b"abc", np.uint8)) == right
    with pytest.raises(FileNotFoundError):
        digest_file(tmp_path / "none")


def test_plain_values_in_any_order() -> None:
    assert digest_json({"a": 1, "b": [1.5, None]}) == digest_json({"b": [1.5, None], "a": 1})
    assert digest_json({"a": 1}) == hashlib.sha256(b'{"a":1}').hexdigest()
    with pytest.raises(ValueError, match="not JSON compliant"):
        digest_json(float("nan"))


def test_named_arrays() -> None:
    columns = {"x": np.arange(6.0).reshape(2, 3), "y": np.array([True])}
    right = digest_arrays(columns)
    assert digest_arrays({"y": columns["y"], "x": np.asfortranarray(columns["x"])}) == right
    for other in (columns["x"].T.copy(), columns["x"].astype(np.float32), columns["x"] + 1):
        assert digest_arrays({**columns, "x": other}) != right
    assert digest_arrays({"z": columns["x"], "y": columns["y"]}) != right


def test_nested_values(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    values: list[Any] = [
        None, True, 1, 1.0, 1j, "1", b"1", np.float64(1), [1], (1,), [1, [2]], [[1], 2], {"a": 1}, {"b": 1}, Part(1),
        Part(2), Part, len, np.ones(3), np.ones((1, 3)), np.ones(3, np.float32), tmp_path / "a", tmp_path / "b",
    ]  # fmt: skip
    kept = [v for v in values if v is not len]
    assert len({digest_value(v) for v in kept}) == len(kept)
    assert digest_value({"a": 1, "b": 2}) == digest_value({"b": 2, "a": 1})
    part = Part(1)
    part.memory.append(3)
    assert digest_value(part) == digest_value(Part(1))
    before = digest_value({"file": str(tmp_path / "a")})
    (tmp_path / "a").write_bytes(b"abd")
    assert digest_value({"file": str(tmp_path / "a")}) != before


def test_what_has_no_certain_content_has_no_digest() -> None:
    class Odd:
        pass

    for value in (object(), lambda: 1, Odd(), Odd, [object()], np.array([object()]), iter([])):
        with pytest.raises(TypeError, match="has no digest"):
            digest_value(value)
    assert digest_value(Odd(), lambda value: {"odd": 1}) != digest_value({"odd": 1})


def test_texts_that_can_be_no_name_of_a_file() -> None:
    for text in ("x" * 5000, "a\0b"):
        assert digest_value(text) != digest_value(text + "c")
