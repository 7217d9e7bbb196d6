"""Short HTML for notebooks: headings, lines and tables; every text is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from engine.words import number


def show(title: str, *parts: str) -> str:
    """A heading and what follows it; ``parts`` are HTML already."""
    return f"<div><p><b>{escape(title)}</b></p>{''.join(parts)}</div>"


def line(text: str) -> str:
    """One paragraph."""
    return f"<p>{escape(text)}</p>" if text else ""


def lines(texts: Sequence[str]) -> str:
    """Lines that keep their spaces, such as equations."""
    return f"<pre>{escape(chr(10).join(texts))}</pre>" if texts else ""


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; numbers with four digits to the right, everything else as text to the left."""
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    if not body:
        return ""
    titles = "".join(f"<th style='text-align:left'>{escape(name)}</th>" for name in head)
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>"


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"<td style='text-align:right'>{escape(number(value, 4))}</td>"
    return f"<td style='text-align:left'>{escape(str(value))}</td>"
