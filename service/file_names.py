"""Names of uploaded files: browsers write three characters of them in another way.

In a multipart body a quotation mark is sent as ``%22``, the ends of lines as ``%0D`` and ``%0A``. A percent
sign stays as it is, so that only the request tells which name is meant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

_SENT = {'"': "%22", "\r": "%0D", "\n": "%0A"}


def sent_by_browsers(name: str) -> str:
    """A file's name as a multipart body of a browser has it."""
    for typed, sent in _SENT.items():
        name = name.replace(typed, sent)
    return name


def as_typed(name: str) -> str:
    """The name that a browser sent so, for people to read."""
    for typed, sent in _SENT.items():
        name = name.replace(sent, typed)
    return name


def as_asked(files: Mapping[str, bytes], body: Mapping[str, Any]) -> dict[str, bytes]:
    """The files by the names that a request gives them."""
    asked = set(named(body))
    known = {sent_by_browsers(name): name for name in asked - set(files)}
    return {known.get(name, name): data for name, data in files.items()}


def named(body: Mapping[str, Any]) -> Iterator[str]:
    """The names of files in a request: those of its series and of its test."""
    for member in ("series", "test"):
        entries = body.get(member)
        for one in entries if isinstance(entries, list) else [entries]:
            if isinstance(one, dict) and isinstance(one.get("file"), str):
                yield one["file"]
