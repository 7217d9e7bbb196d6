"""What a result shows of itself: a heading and parts, as text for a terminal and as HTML for a notebook."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Protocol

from engine.words import number

WIDTH = 88  # of a line of text
GAP = "  "  # between columns of text


class Part(Protocol):
    """Something below the heading."""

    def text(self) -> str:
        """As text, "" where there is nothing to show."""

    def html(self) -> str:
        """As HTML, in which every text is escaped."""


@dataclass(frozen=True)
class View:
    """A heading and what follows it."""

    title: str
    parts: tuple[Part, ...]

    def text(self) -> str:
        """As text."""
        shown = [part.text() for part in self.parts]
        return "\n".join([self.title, *(one for one in shown if one)])

    def html(self) -> str:
        """As HTML."""
        parts = "".join(part.html() for part in self.parts)
        return f"<div><p><b>{escape(self.title)}</b></p>{parts}</div>"


@dataclass(frozen=True)
class Paragraph:
    """One paragraph."""

    words: str

    def text(self) -> str:
        """Wrapped."""
        return textwrap.fill(self.words, WIDTH)

    def html(self) -> str:
        """A paragraph."""
        return f"<p>{escape(self.words)}</p>" if self.words else ""


@dataclass(frozen=True)
class Lines:
    """Lines that keep their spaces, such as equations."""

    texts: tuple[str, ...]

    def text(self) -> str:
        """Indented."""
        return "\n".join(f"  {one}" for one in self.texts)

    def html(self) -> str:
        """Preformatted."""
        return f"<pre>{escape(chr(10).join(self.texts))}</pre>" if self.texts else ""


@dataclass(frozen=True)
class Grid:
    """A table; numbers with some digits, or their own, to the right, everything else as text to the left."""

    head: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]

    def text(self) -> str:
        """Columns beneath their names, between two rules."""
        if not self.rows:
            return ""
        cells = [self.head, *(tuple(map(_cell, row)) for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        right = [
            any(isinstance(value, float) for value in column)
            for column in zip(*self.rows, strict=True)
        ]
        lines = [
            GAP.join(
                text.rjust(width) if to_right else text.ljust(width)
                for text, width, to_right in zip(row, widths, right, strict=True)
            ).rstrip()
            for row in cells
        ]
        rule = "-" * min(max(map(len, lines)), WIDTH)
        return "\n".join([rule, lines[0], rule, *lines[1:], rule])

    def html(self) -> str:
        """A table."""
        if not self.rows:
            return ""
        body = "".join(f"<tr>{''.join(map(_html_cell, row))}</tr>" for row in self.rows)
        titles = "".join(f"<th style='text-align:left'>{escape(name)}</th>" for name in self.head)
        return f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>"


def show(title: str, *parts: Part) -> View:
    """A heading and what follows it."""
    return View(title, parts)


def line(text: str) -> Part:
    """One paragraph."""
    return Paragraph(text)


def lines(texts: Sequence[str]) -> Part:
    """Lines that keep their spaces, such as equations."""
    return Lines(tuple(texts))


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> Part:
    """A table."""
    return Grid(tuple(head), tuple(map(tuple, rows)))


def _cell(value: object) -> str:
    return number(value, getattr(value, "digits", 4)) if isinstance(value, float) else str(value)


def _html_cell(value: object) -> str:
    side = "right" if isinstance(value, float) else "left"
    return f"<td style='text-align:{side}'>{escape(_cell(value))}</td>"
