"""XML of files of others: no entity of their own is taken from them, in whatever encoding they are written."""

from __future__ import annotations

from xml.etree import ElementTree


class DoctypeError(ValueError):
    """A document has a DOCTYPE: entities could name other files, or grow without end."""


class _Builder(ElementTree.TreeBuilder):
    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise DoctypeError("it has a DOCTYPE")


def root_of(content: bytes) -> ElementTree.Element:
    """Return the root of a document.

    Raises
    ------
    DoctypeError
        It has a DOCTYPE.
    xml.etree.ElementTree.ParseError, ValueError, LookupError
        It is no XML, or of an unknown encoding.
    """
    root: ElementTree.Element = ElementTree.fromstring(content, ElementTree.XMLParser(target=_Builder()))
    return root
