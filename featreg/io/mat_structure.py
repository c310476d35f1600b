"""Whether a MATLAB 5 file is whole: scipy's reader trusts its lengths, and damaged ones end the process."""

from __future__ import annotations

import math
import mmap
import struct
from pathlib import Path
from typing import NamedTuple

from featreg.errors import InputError

#: Size of a sample by the type of its element.
SAMPLES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
TEXTS = {1, 2, 4, 16, 17, 18}
INT32, UINT32, MATRIX, COMPRESSED = 5, 6, 14, 15
#: Of dimensions and lengths; some writers take the unsigned one.
WHOLE = (INT32, UINT32)
CELL, STRUCT, OBJECT, CHAR, SPARSE = 1, 2, 3, 4, 5
NUMERIC = range(6, 16)
#: Function handles and opaque objects, which scipy passes over.
OTHER = (16, 17)
DEEPEST = 50


class Element(NamedTuple):
    """Type of an element, where its data lie and where the next one starts."""

    kind: int
    start: int
    size: int
    next: int


class DamageError(ValueError):
    """A length, type or size that cannot be."""


def check_mat(path: str | Path) -> None:
    """Raise where the elements of a MATLAB 5 file do not fit into each other; files of other versions pass.

    Raises
    ------
    InputError
        The file is damaged or cut short.

    Notes
    -----
    What is compressed carries a checksum of its own and is left to the reader.
    """
    with Path(path).open("rb") as file:
        head = file.read(128)
        order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
        if len(head) < 128 or order is None or head[124:126] not in (b"\x00\x01", b"\x01\x00"):
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                walk = _Walk(data, order)
                at = 128
                while at < len(data):
                    element = walk.element(at, len(data))
                    if element.kind == MATRIX:
                        walk.matrix(element, 0)
                    elif element.kind != COMPRESSED:
                        raise DamageError(f"element of type {element.kind} where a variable is needed")
                    # A compressed variable is not padded.
                    at = element.start + element.size if element.kind == COMPRESSED else element.next
            except (DamageError, struct.error) as error:
                text = f"{path}: the MATLAB file is broken or cut short ({error}); a complete file is needed"
                raise InputError(text) from error


class _Walk:
    """A walk over the elements of a file; `order` is the byte order as `struct` writes it."""

    def __init__(self, data: mmap.mmap, order: str) -> None:
        self.data, self.order = data, order

    def numbers(self, at: int, code: str, count: int) -> tuple[int, ...]:
        return struct.unpack_from(f"{self.order}{count}{code}", self.data, at)

    def element(self, at: int, end: int) -> Element:
        """The element at a place, which lies wholly before `end`."""
        if at + 8 > end:
            raise DamageError("an element begins where its parent ends")
        (word,) = self.numbers(at, "I", 1)
        if word >> 16:  # a small one: length and type share a word, the data is the next
            kind, size = word & 0xFFFF, word >> 16
            if size > 4:
                raise DamageError(f"a small element of {size} bytes")
            return Element(kind, at + 4, size, at + 8)
        kind, size = self.numbers(at, "I", 2)
        start = at + 8
        padded = size if kind == COMPRESSED else -(-size // 8) * 8
        if start + size > end:
            raise DamageError(f"an element of {size} bytes where {end - start} are left")
        return Element(kind, start, size, min(start + padded, end))

    def matrix(self, outer: Element, depth: int) -> None:
        """Check a variable, a cell or a field."""
        if not outer.size:
            return
        if depth > DEEPEST:
            raise DamageError(f"cells and structures nested more than {DEEPEST} deep")
        end = outer.start + outer.size
        flags = self.element(outer.start, end)
        if flags.kind != UINT32 or flags.size != 8:
            raise DamageError("a variable without flags")
        (word,) = self.numbers(flags.start, "I", 1)
        what, two = word & 0xFF, bool(word & 0x0800)
        if what in OTHER:
            return
        shape = self.element(flags.next, end)
        if shape.kind not in WHOLE or shape.size < 8 or shape.size % 4 or shape.size > 4 * 32:
            raise DamageError("a variable without dimensions")
        dims = self.numbers(shape.start, "i", shape.size // 4)
        if min(dims) < 0:
            raise DamageError(f"dimensions {dims}")
        name = self.element(shape.next, end)
        if name.kind not in TEXTS:
            raise DamageError("a variable without a name")
        count = math.prod(dims)
        if what == CELL:
            self.cells(name.next, end, count, depth)
        elif what in (STRUCT, OBJECT):
            self.fields(name.next, end, count, depth, named=what == OBJECT)
        elif what == CHAR:
            self.text(name.next, end, count)
        elif what == SPARSE:
            self.sparse(name.next, end, dims, two=two)
        elif what in NUMERIC:
            at = self.samples(name.next, end, count)
            if two:
                self.samples(at, end, count)
        else:
            raise DamageError(f"a variable of class {what}")

    def samples(self, at: int, end: int, count: int) -> int:
        """Check `count` numbers and return where the next element starts."""
        found = self.element(at, end)
        size = SAMPLES.get(found.kind)
        if size is None or found.size != count * size:
            raise DamageError(f"{found.size} bytes of type {found.kind} for {count} samples")
        return found.next

    def text(self, at: int, end: int, count: int) -> None:
        found = self.element(at, end)
        if found.kind not in TEXTS or found.size > 4 * count:
            raise DamageError(f"{found.size} bytes of type {found.kind} for {count} characters")

    def cells(self, at: int, end: int, count: int, depth: int) -> None:
        for _ in range(count):
            found = self.element(at, end)
            if found.kind != MATRIX:
                raise DamageError(f"an element of type {found.kind} in a cell or field")
            self.matrix(found, depth + 1)
            at = found.next

    def fields(self, at: int, end: int, count: int, depth: int, *, named: bool) -> None:
        if named:
            at = self.element(at, end).next
        length = self.element(at, end)
        if length.kind not in WHOLE or length.size != 4:
            raise DamageError("a structure without a length of its names")
        (each,) = self.numbers(length.start, "i", 1)
        names = self.element(length.next, end)
        if each < 1 or names.kind not in TEXTS or names.size % each:
            raise DamageError(f"names of {each} characters in {names.size} bytes")
        self.cells(names.next, end, count * (names.size // each), depth)

    def sparse(self, at: int, end: int, dims: tuple[int, ...], *, two: bool) -> None:
        rows = self.element(at, end)
        columns = self.element(rows.next, end)
        if len(dims) != 2 or rows.kind != INT32 or columns.kind != INT32 or columns.size != 4 * (dims[1] + 1):
            raise DamageError("a sparse matrix whose columns are not counted")
        held = self.numbers(columns.start, "i", dims[1] + 1)
        if list(held) != sorted(held) or held[0] != 0 or 4 * held[-1] > rows.size:
            raise DamageError("a sparse matrix whose columns do not fit its rows")
        at = columns.next
        for _ in range(1 + two):
            found = self.element(at, end)
            size = SAMPLES.get(found.kind)
            if size is None or found.size < size * held[-1]:
                raise DamageError("a sparse matrix with fewer samples than rows")
            at = found.next
