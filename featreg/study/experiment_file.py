"""Experiments as YAML or TOML: read with errors that name the place, written so that they read back equal."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from featreg.errors import FeatregError, InputError, suggest
from featreg.runtime.files import write_atomic
from featreg.study.image_pairs import pairs_in, parts
from featreg.study.metrics import check_metrics
from featreg.study.protocol import Protocol
from featreg.study.truth import WORDS

KEYS = ("title", "pairs", "methods", "parameters", "grid", "seeds", "protocol", "metrics")
SUFFIXES = (".yaml", ".yml", ".toml")
#: Most values of a file, and how deep they may be nested.
MOST_VALUES, DEEPEST = 100_000, 30


def read_experiment(path: Path) -> dict[str, Any]:
    """Return the arguments of `Experiment` that a file holds, its paths resolved.

    Raises
    ------
    InputError
        The file cannot be read, or something in it is not known.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"experiment '{path}' must be a {', '.join(SUFFIXES)} file")
    try:
        data = _parse(path)
    except OSError as error:
        raise InputError(f"experiment '{path}' cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"experiment '{path}' cannot be read: {' '.join(str(error).split())}") from error
    try:
        return _arguments(data, path.parent)
    except FeatregError as error:
        raise InputError(f"experiment '{path}': {error}") from error


def write_experiment(data: Mapping[str, Any], path: Path) -> None:
    """Write what `Experiment.to_dict` gives; relative paths are rewritten as seen from the file's folder.

    Raises
    ------
    InputError
        The file cannot be written, has another ending, or would have to hold an array or an object.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"experiment '{path}' must be a {', '.join(SUFFIXES)} file")
    whole = {key: _plain(value, key) for key, value in data.items()}
    if "protocol" in whole:
        whole["protocol"] = _with_dem(whole["protocol"], lambda p: _relative(p, path.parent))
    whole["pairs"] = [_moved(pair, lambda p: _relative(p, path.parent)) for pair in whole.get("pairs", [])]
    if path.suffix.lower() == ".toml":
        import tomli_w

        text = tomli_w.dumps(whole)
    else:
        import yaml

        text = yaml.safe_dump(whole, sort_keys=False, allow_unicode=True)
    write_atomic(path, text.encode())


def _parse(path: Path) -> Any:
    if path.suffix.lower() == ".toml":
        return tomllib.loads(path.read_text(encoding="utf-8"))
    import yaml

    text, depth = path.read_text(encoding="utf-8"), 0
    try:
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise ValueError(f"lists and mappings nested more than {DEEPEST} deep")
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error
    if _values(data, {}) > MOST_VALUES:
        raise ValueError(f"its aliases (&name, *name) unfold to more than {MOST_VALUES} values")
    return data


def _values(value: Any, known: dict[int, int | None]) -> int:
    """How many values a tree holds whose branches may be shared: a few lines of aliases can stand for billions."""
    if not isinstance(value, dict | list):
        return 1
    if id(value) not in known:
        known[id(value)] = None
        known[id(value)] = 1 + sum(_values(v, known) for v in (value.values() if isinstance(value, dict) else value))
    count = known[id(value)]
    if count is None:
        raise ValueError("an alias (*name) that holds itself")
    return count


def _arguments(data: Any, folder: Path) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise InputError(f"it must hold the keys {', '.join(KEYS)}, got {type(data).__name__}")
    for key in data:
        if key not in KEYS:
            raise InputError(f"unknown key '{key}', {suggest(str(key), KEYS)}")
    for key in ("pairs", "methods"):
        if key not in data:
            raise InputError(f"it has no {key}")
    found = dict(data)
    kinds: tuple[tuple[str, type, str], ...] = (
        ("pairs", list, "a list"), ("methods", list, "a list"), ("metrics", list, "a list of names"),
        ("parameters", dict, "a mapping of parameters"), ("grid", dict, "a mapping of parameters to lists"),
        ("protocol", dict, "a mapping"), ("title", str, "text"),
    )  # fmt: skip
    for key, kind, words in kinds:
        if key in found and not isinstance(found[key], kind):
            raise InputError(f"{key} must be {words}, got {found[key]!r}")
    if "protocol" in found:
        found["protocol"] = Protocol.from_dict(_with_dem(found["protocol"], lambda p: _beside(p, folder)))
    if "metrics" in found:
        found["metrics"] = check_metrics(found["metrics"])
    found["pairs"] = [pair for i, given in enumerate(data["pairs"], start=1) for pair in _pairs(given, i, folder)]
    for i, method in enumerate(data["methods"], start=1):
        if not isinstance(method, str) and not (isinstance(method, dict) and isinstance(method.get("method"), str)):
            raise InputError(f"method {i} must be a name or a mapping with the key 'method', got {method!r}")
    return found


def _pairs(given: Any, number: int, folder: Path) -> Iterator[Any]:
    where = f"pair {number}"
    if isinstance(given, dict) and "folder" in given:
        more = [key for key in given if key not in ("folder", "truth")]
        if more:
            raise InputError(f"{where}: unknown key '{more[0]}' beside 'folder', known: folder, truth")
        for pair in pairs_in(folder / str(given["folder"])):
            truth = given.get("truth")
            yield pair if truth is None else {**pair, "truth": _path(truth, lambda p: _beside(p, folder))}
        return
    parts(given, where)
    yield _moved(given, lambda p: _beside(p, folder))


def _with_dem(protocol: Mapping[str, Any], move: Callable[[str], str]) -> dict[str, Any]:
    """The protocol with the path of its elevation model rewritten."""
    dem = protocol.get("dem")
    return {**protocol, "dem": move(dem)} if isinstance(dem, str) else {**protocol}


def _moved(pair: Any, move: Callable[[str], str]) -> Any:
    """The pair with its paths rewritten."""
    if isinstance(pair, Mapping):
        return {key: value if key == "name" else _path(value, move) for key, value in pair.items()}
    return [_path(value, move) for value in pair]


def _path(value: Any, move: Callable[[str], str]) -> Any:
    return move(value) if isinstance(value, str) and value not in WORDS else value


def _beside(path: str, folder: Path) -> str:
    return path if Path(path).is_absolute() else str(folder / path)


def _relative(path: str, folder: Path) -> str:
    return path if Path(path).is_absolute() else Path(os.path.relpath(path, folder)).as_posix()


def _plain(value: Any, where: str) -> Any:
    """The value in the types that both formats know."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(k): _plain(v, f"{where}.{k}") for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_plain(v, f"{where}[{i}]") for i, v in enumerate(value, start=1) if v is not None]
    if isinstance(value, bool | int | float | str):
        return value
    if hasattr(value, "item") and getattr(value, "ndim", 1) == 0:
        return value.item()
    raise InputError(f"{where} is a {type(value).__name__}: a file holds names, numbers and paths only")
