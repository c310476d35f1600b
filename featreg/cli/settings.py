"""`--set key=value`: what the values stand for."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

from featreg.errors import ParameterError
from featreg.pipeline.keywords import BY_NAME

WORDS = {"true": True, "false": False, "none": None, "inf": float("inf"), "-inf": float("-inf"), "nan": float("nan")}


def parse_settings(given: Sequence[str] | None, offered: Iterable[str]) -> dict[str, Any]:
    """Return the keywords of `--set key=value` options; `offered` are those that the command has options for.

    A value is read as JSON where it is JSON (numbers, true, false, null, lists, quoted text), as a number, or as text;
    `filters` takes names with commas between them.

    Raises
    ------
    ParameterError
        No "=", the same key twice, a key that has an option of its own, or one that no text can stand for.
    """
    offered = set(offered)
    settings: dict[str, Any] = {}
    for text in given or ():
        key, sign, value = text.partition("=")
        key = key.strip()
        if not sign or not key:
            raise ParameterError(f"--set takes KEY=VALUE, as in --set fsc.threshold=2, got '{text}'")
        if key in offered:
            option = BY_NAME[key].option if key in BY_NAME else f"--{key.replace('_', '-')}"
            raise ParameterError(f"'{key}' has an option of its own: write {option} instead of --set {text}")
        if key in ("progress", "cancel"):
            raise ParameterError(f"'{key}' is for Python only: progress is shown on a terminal, Ctrl-C stops the work")
        if key in settings:
            raise ParameterError(f"--set {key} is given twice")
        settings[key] = parse_value(value.strip())
        if key == "filters" and not isinstance(settings[key], list):
            settings[key] = [name.strip() for name in value.split(",") if name.strip()]
    return settings


def parse_value(text: str) -> Any:
    """Return the number, bool, None, list or text that a value on the command line stands for."""
    if text.lower() in WORDS:
        return WORDS[text.lower()]
    for read in (json.loads, float):
        try:
            return read(text)
        except ValueError:
            continue
    return text
