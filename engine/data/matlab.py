"""The arrays of a MATLAB file (version 5 to 7) that SciPy can be trusted with.

SciPy looks up the data types that a file names in a C table without asking how long the table is: one
wrong byte ends the process. So the elements are walked through before, and only what is needed is read:
arrays of numbers or characters, and cells of them.
"""

from __future__ import annotations

import math
import struct
import zlib

MATRIX, COMPRESSED = 14, 15
NUMBERS = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))  # types of elements: integers, single, double
TEXT = NUMBERS | {16, 17, 18}  # UTF-8, 16, 32
CELL, CHARACTERS, NUMERIC, OPAQUE = 1, 4, range(6, 16), 17  # classes of arrays
LARGEST = 4 << 30  # bytes an array may unpack to


def readable(data: bytes) -> tuple[list[str], list[str]]:
    """Names of the arrays that can be read, and of other things; ValueError for a broken file."""
    order = "<" if data[126:128] == b"IM" else ">"
    found: dict[str, bool] = {}
    at = 128
    while at < len(data):
        kind, size = _unpack(order + "II", data, at)
        content = data[at + 8 : at + 8 + size]
        at += 8 + size
        if len(content) < size:
            raise ValueError("it ends within an array")
        if kind == COMPRESSED:
            content = zlib.decompressobj().decompress(content, LARGEST)
            kind, size = _unpack(order + "II", content, 0)
            content = content[8 : 8 + size]
        if kind != MATRIX:
            raise ValueError(f"{kind} is no type of a variable")
        name, plain = _array(content, order)
        found[name] = plain and found.get(name, True)
    return [n for n, plain in found.items() if plain], [
        n for n, plain in found.items() if not plain
    ]


def _array(body: bytes, order: str, within: bool = False) -> tuple[str, bool]:
    """Name, and whether it can be read; ``within`` a cell, no further cell can."""
    (flags,) = _unpack(order + "I", body, 8)
    what = flags & 0xFF
    if what == OPAQUE:  # has no name
        return "None", False
    _, sizes, at = _element(body, 16, order)
    if len(sizes) < 8 or len(sizes) % 4:
        raise ValueError("an array has fewer than two dimensions")
    dims = _unpack(f"{order}{len(sizes) // 4}i", sizes, 0)
    _, name, at = _element(body, at, order)
    plain = what in (CELL, CHARACTERS, *NUMERIC) and not (within and what == CELL)
    if plain and what == CELL:
        for _ in range(math.prod(dims)):
            kind, content, at = _element(body, at, order)
            if kind != MATRIX:
                raise ValueError(f"{kind} is no type of a cell")
            plain = plain and (not content or _array(content, order, within=True)[1])
    elif plain:
        known = TEXT if what == CHARACTERS else NUMBERS
        for _ in range(1 + (what != CHARACTERS and flags >> 11 & 1)):  # real, and imaginary
            kind, _, at = _element(body, at, order)
            if kind not in known:
                raise ValueError(f"{kind} is no type of numbers")
    return name.decode("latin1"), plain


def _element(body: bytes, at: int, order: str) -> tuple[int, bytes, int]:
    """Type and content of the element at a place, and the place after it."""
    (kind,) = _unpack(order + "I", body, at)
    if kind >> 16:  # up to four bytes are kept in the place of the size
        size, start, after = kind >> 16, at + 4, at + 8
        kind &= 0xFFFF
        if size > 4:
            raise ValueError(f"a small element of {size} bytes")
    else:
        (size,) = _unpack(order + "I", body, at + 4)
        start = at + 8
        after = start + size + -size % 8
    content = body[start : start + size]
    if len(content) < size:
        raise ValueError("it ends within an array")
    return kind, content, after


def _unpack(form: str, body: bytes, at: int) -> tuple[int, ...]:
    try:
        return struct.unpack_from(form, body, at)
    except struct.error:
        raise ValueError("it ends within an array") from None
