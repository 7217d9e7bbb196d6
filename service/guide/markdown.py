"""The part of Markdown that the Guide is written in, as HTML in which every text is escaped.

Headings, paragraphs, lists of one level, tables, fenced and indented code; within a line code, bold text and
links. Links to other pages of the Guide lead there; those to files of the repository, which is not
installed, are only named.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from html import escape

_INLINE = re.compile(r"(`[^`]+`|!?\[[^\]]*\]\([^)\s]+\)|\*\*[^*]+\*\*)")
_BLOCK = re.compile(
    r"""
    ^```.*\n (?P<fence> (?:(?!```).*\n)* ) (?:```.*\n)?
    | ^(?P<indented> \ {4}.*\n (?:(?:\ {4}.*|[ ]*)\n)* )
    | ^(?P<heading> \#{1,4}\ +.*\n )
    | ^(?P<table> (?:\|.*\|\n)+ )
    | ^(?P<list> -\ .*\n (?:(?:-\ |\ \ ).*\n)* )
    | ^(?P<paragraph> .*\S.*\n (?:(?!\#|```|\|).*\S.*\n)* )
    """,
    re.MULTILINE | re.VERBOSE,
)


def html(text: str) -> str:
    """The HTML of a page."""
    made: dict[str, Callable[[str], str]] = {
        "fence": _code,
        "indented": lambda block: _code(re.sub(r"^ {1,4}", "", block, flags=re.MULTILINE)),
        "heading": _heading,
        "table": _table,
        "list": _list,
        "paragraph": lambda block: f"<p>{_words(block)}</p>",
    }
    found = _BLOCK.finditer(f"{text}\n")
    return "\n".join(made[kind](one[kind]) for one in found if (kind := one.lastgroup))


def title(text: str) -> str:
    """Its first heading."""
    found = re.search(r"^# +(.*)$", text, re.MULTILINE)
    return found[1] if found else ""


def anchor(heading: str) -> str:
    """The id of a heading."""
    return re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-")


def _words(text: str) -> str:
    return _inline(" ".join(text.split()))


def _code(block: str) -> str:
    return f"<pre><code>{escape(block.rstrip())}</code></pre>"


def _heading(block: str) -> str:
    marks, _, words = block.strip().partition(" ")
    level = f"h{len(marks)}"
    return f'<{level} id="{anchor(words)}">{_words(words)}</{level}>'


def _list(block: str) -> str:
    items = re.split(r"^- ", block, flags=re.MULTILINE)[1:]
    return f"<ul>{''.join(f'<li>{_words(one)}</li>' for one in items)}</ul>"


def _table(block: str) -> str:
    lines = block.splitlines()
    head, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    body = [row for row in rows if not all(re.fullmatch(r":?-+:?", cell) for cell in row)]
    top = "".join(f'<th scope="col">{_inline(cell)}</th>' for cell in head)
    made = "".join(f"<tr>{''.join(f'<td>{_inline(c)}</td>' for c in row)}</tr>" for row in body)
    table = f"<table><thead><tr>{top}</tr></thead><tbody>{made}</tbody></table>"
    return f'<div class="scroll" tabindex="0" role="group" aria-label="table">{table}</div>'


def _inline(text: str) -> str:
    return "".join(_piece(part) for part in _INLINE.split(text))


def _piece(part: str) -> str:
    if not _INLINE.fullmatch(part):
        return escape(part)
    if part.startswith("`"):
        return f"<code>{escape(part[1:-1])}</code>"
    if part.startswith("**"):
        return f"<strong>{escape(part[2:-2])}</strong>"
    found = re.fullmatch(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", part)
    assert found is not None
    picture, words, link = found.groups()
    if picture:
        return ""
    if page := re.fullmatch(r"([a-z]+)\.md(#[a-z0-9-]+)?", link):
        return f'<a href="/guide/{page[1]}{page[2] or ""}">{escape(words)}</a>'
    if re.match(r"(https?://|/|#)", link):
        return f'<a href="{escape(link)}">{escape(words)}</a>'
    return f"{escape(words)} (<code>{escape(link.removeprefix('../../../'))}</code>)"
