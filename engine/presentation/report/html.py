"""HTML as text: everything that is put into it is escaped here, and only what is made here is not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from typing import Any


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def text(value: object) -> Html:
    """Anything as HTML: escaped, unless it is HTML already."""
    return value if isinstance(value, Html) else Html(escape(str(value), quote=True))


def tag(name: str, *inner: object, **attributes: object) -> Html:
    """One element; ``class_`` is written ``class``, other underscores as hyphens, None left out."""
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(str(value), quote=True)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Html(f"<{name}{written}>{''.join(text(part) for part in inner)}</{name}>")


def join(parts: Iterable[object]) -> Html:
    """Parts one after the other."""
    return Html("".join(text(part) for part in parts))


def table(
    head: Sequence[object], rows: Iterable[Sequence[object]], class_: str | None = None
) -> Html:
    """A table whose first column holds the rows' names; it scrolls by itself where it is too wide.

    Columns in which nothing stands are left out.
    """
    rows = list(rows)
    kept = [k for k in range(len(head)) if k == 0 or any(row[k] != "" for row in rows)]
    head, rows = [head[k] for k in kept], [[row[k] for k in kept] for row in rows]
    body = [
        tag("tr", tag("th", first, scope="row"), *(tag("td", cell) for cell in cells))
        for first, *cells in rows
    ]
    top = tag("tr", *(tag("th", cell, scope="col") for cell in head))
    made = tag("table", tag("thead", top), tag("tbody", *body), class_=class_)
    return tag("div", made, class_="scroll", tabindex="0", role="group", aria_label="table")


def table_of(
    items: Iterable[Any], columns: Mapping[str, Callable[[Any], object]], class_: str = "numbers"
) -> Html:
    """A table with a row for each item, nothing where there is none; ``columns`` are cells by their titles."""
    rows = [[cell(item) for cell in columns.values()] for item in items]
    return table(list(columns), rows, class_) if rows else Html("")


def bullets(items: Iterable[object], class_: str | None = None) -> Html:
    """A list, or nothing where there is nothing to list."""
    made = [tag("li", item) for item in items]
    return tag("ul", *made, class_=class_) if made else Html("")
