"""What SICD and SIDD share: sarkit (the `sicd` extra) where it is there, and the errors it raises on metadata."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from featreg.errors import InputError

#: What comes of metadata that are broken or lack something; an error of syntax is lxml's.
BROKEN = (
    SyntaxError,
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
)


def sarkit_module(name: str, needing: str) -> Any:
    """Return a module of sarkit.

    Parameters
    ----------
    name : of the module below sarkit, such as "sicd.projection"
    needing : what cannot be done without it, for the message

    Raises
    ------
    InputError
        sarkit is not installed.
    """
    try:
        return import_module(f"sarkit.{name}")
    except ImportError as error:
        raise InputError(f"{needing} needs sarkit ({error}); install it with: pip install 'featreg[sicd]'") from error


def tree_of(xml: str) -> Any:
    """Return an lxml element tree of a text, whose entities are not followed."""
    etree: Any = import_module("lxml.etree")
    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    return etree.ElementTree(etree.fromstring(xml.encode(), parser))


@contextmanager
def silent() -> Iterator[None]:
    """Keep sarkit and what it rests on from speaking on stderr of files that deviate from the standard."""
    loggers = [logging.getLogger(name) for name in ("sarkit", "jbpy")]
    before = [one.level for one in loggers]
    try:
        for one in loggers:
            one.setLevel(logging.CRITICAL)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for one, level in zip(loggers, before, strict=True):
            one.setLevel(level)
