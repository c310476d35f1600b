"""What a shell offers when the tab key is pressed: names of methods, parts, models and parameters, plugins included.

`featreg --install-completion` sets a shell up for it. Everything is imported when it is asked for.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeAlias

import typer

from featreg.presets import DEFAULT_METHOD

#: A value, and what is said beside it.
Offer: TypeAlias = tuple[str, str]

SHELL = "_FEATREG_COMPLETE"
#: KEY= of the word that Bash completes, of which it wants the rest.
_key = ""
BASH_WORDS, BASH_AT = "COMP_WORDS", "COMP_CWORD"


def asked_words() -> list[str] | None:
    """The words on the line that a shell wants completed, that of the program left out; None where none does.

    Bash parts words at "=", which is put together again for the parser; of KEY=VALUE it completes the value alone.
    """
    global _key
    if SHELL not in os.environ:
        return None
    if BASH_WORDS not in os.environ:
        return os.environ.get("_TYPER_COMPLETE_ARGS", "").split()[1:]
    words, at = _joined(os.environ[BASH_WORDS].split("\n"), int(os.environ.get(BASH_AT, "0")))
    if at < len(words) and "=" in words[at] and not words[at].startswith("-"):
        key, sign, words[at] = words[at].partition("=")
        _key = key + sign
    os.environ[BASH_WORDS], os.environ[BASH_AT] = "\n".join(words), str(at)
    return words[1:]


def _joined(words: list[str], at: int) -> tuple[list[str], int]:
    """Words with KEY = VALUE in one, and where the word at `at` is now."""
    found: list[str] = []
    place = at
    for i, word in enumerate(words):
        if found and i > 1 and (word == "=" or words[i - 1] == "="):
            found[-1] += word
        else:
            found.append(word)
        if i == at:
            place = len(found) - 1
    return found, place if at < len(words) else len(found)


def _fitting(offers: Iterable[Offer], incomplete: str) -> list[Offer]:
    return [offer for offer in offers if offer[0].startswith(incomplete)]


def _of_list(offers: Iterable[Offer], incomplete: str) -> list[Offer]:
    """For names with commas between them: the last one."""
    before, comma, last = incomplete.rpartition(",")
    used = before.split(",")
    return [(before + comma + name, text) for name, text in _fitting(offers, last) if name not in used]


def _methods() -> Iterator[Offer]:
    from featreg.presets import PRESETS

    return ((name, preset.summary) for name, preset in PRESETS.items())


def _named(kind: str) -> Iterator[Offer]:
    from featreg.registry import entries

    return ((e.name, e.summary) for e in entries(kind) if not e.unavailable)


def methods(incomplete: str) -> list[Offer]:
    """Of `--method`."""
    return _fitting(_methods(), incomplete)


def several_methods(incomplete: str) -> list[Offer]:
    """Of `--methods`."""
    return _of_list([("all", "every method that can be used here"), *_methods()], incomplete)


def models(incomplete: str) -> list[Offer]:
    """Of `--model`."""
    return _fitting(_named("model"), incomplete)


def scales(incomplete: str) -> list[Offer]:
    """Of `--scale`."""
    known = [("amplitude", "magnitudes"), ("intensity", "squared magnitudes"), ("db", "decibels")]
    return _fitting(known, incomplete)


def focus_methods(incomplete: str) -> list[Offer]:
    """Of `--focus`."""
    from featreg.focusing import METHODS

    return _fitting([(name, "") for name in METHODS], incomplete)


def words(*known: str) -> Callable[[str], list[Offer]]:
    """Of an option that takes one of a few words."""
    return lambda incomplete: _fitting([(word, "") for word in known], incomplete)


def metrics(incomplete: str) -> list[Offer]:
    """Of `--metrics`."""
    from featreg.study.metrics import METRICS

    plus = "+" if incomplete.startswith("+") else ""
    found = _of_list(((name, metric.meaning) for name, metric in METRICS.items()), incomplete.removeprefix("+"))
    return [(plus + name, text) for name, text in found]


def listed_names(incomplete: str) -> list[Offer]:
    """Of `featreg list`."""
    from featreg.cli.listed import KINDS
    from featreg.registry import KINDS as PARTS

    kinds = [(kind, "all of this kind") for kind in KINDS]
    names = dict([*_methods(), *(offer for kind in PARTS for offer in _named(kind))])
    return _fitting([*kinds, *sorted(names.items())], incomplete)


def settings(ctx: typer.Context, incomplete: str) -> list[Offer]:
    """Of `--set`: parts and parameters of the method that the line names, then what they may be."""
    method = ctx.params.get("method") or DEFAULT_METHOD
    key, sign, value = (_key + incomplete).partition("=")
    if not sign:
        return _fitting(_keys(str(method)), incomplete)
    offers = _of_list(_named("filter"), value) if key == "filters" else _fitting(_values(str(method), key), value)
    return offers if _key else [(f"{key}={text}", said) for text, said in offers]


def _keys(method: str) -> Iterator[Offer]:
    from featreg.cli.listed import Item

    for part in ("detector", "descriptor", "nearest", "matcher", "filters"):
        yield f"{part}=", "replace this part"
    for name, one in _declared(Item("method", method, "", "")).items():
        yield f"{name}=", one.meaning or one.wanted


def _values(method: str, key: str) -> list[Offer]:
    from featreg.cli.listed import Item

    if key in ("detector", "descriptor", "nearest", "matcher"):
        return list(_named(key))
    one = _declared(Item("method", method, "", "")).get(key)
    if one is None:
        return []
    if one.choices:
        return [(str(choice), "") for choice in one.choices]
    return [("true", ""), ("false", "")] if one.kind is bool else []


def _declared(item: Any) -> Any:
    from featreg.presets import PRESETS

    return item.declared() if item.name in PRESETS else {}
