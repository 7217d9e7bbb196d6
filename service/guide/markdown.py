"""The part of Markdown that the Guide is written in, as HTML in which every text is escaped.

Headings, paragraphs, lists of one level, tables, fenced and indented code; within a line code, bold text and
links. Links to other pages of the Guide lead there; those to files of the repository, which is not
installed, are only named.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import escape

_INLINE = re.compile(r"(`[^`]+`|!?\[[^\]]*\]\([^)\s]+\)|\*\*[^*]+\*\*)")
_ROW = re.compile(r"^\|.*\|$")
_HEADING = re.compile(r"^(#{1,4}) +(.*)$")


def html(text: str) -> str:
    """The HTML of a page."""
    return "\n".join(_blocks(text.splitlines()))


def title(text: str) -> str:
    """Its first heading."""
    found = re.search(r"^# +(.*)$", text, re.MULTILINE)
    return found[1] if found else ""


def anchor(heading: str) -> str:
    """The id of a heading."""
    return re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-")


def _blocks(lines: list[str]) -> Iterator[str]:
    i = 0
    while i < len(lines):
        line = lines[i]
        if line.startswith("```"):
            end = next(
                (k for k in range(i + 1, len(lines)) if lines[k].startswith("```")), len(lines)
            )
            yield _code(lines[i + 1 : end])
            i = end + 1
        elif line.startswith("    "):
            end = _while(lines, i, lambda one: one.startswith("    ") or not one.strip())
            yield _code([one[4:] for one in lines[i:end]])
            i = end
        elif found := _HEADING.match(line):
            level, words = len(found[1]), found[2]
            yield f'<h{level} id="{anchor(words)}">{_inline(words)}</h{level}>'
            i += 1
        elif _ROW.match(line):
            end = _while(lines, i, lambda one: bool(_ROW.match(one)))
            yield _table(lines[i:end])
            i = end
        elif line.startswith("- "):
            end = _while(lines, i, lambda one: one.startswith(("- ", "  ")))
            items = re.split(r"^- ", "\n".join(lines[i:end]), flags=re.MULTILINE)[1:]
            yield f"<ul>{''.join(f'<li>{_inline(_joined(one))}</li>' for one in items)}</ul>"
            i = end
        elif line.strip():
            end = _while(
                lines, i, lambda one: bool(one.strip()) and not one.startswith(("#", "```", "|"))
            )
            yield f"<p>{_inline(_joined(' '.join(lines[i:end])))}</p>"
            i = end
        else:
            i += 1


def _while(lines: list[str], i: int, holds: object) -> int:
    """The first line from i + 1 on for which it does not hold."""
    assert callable(holds)
    return next((k for k in range(i + 1, len(lines)) if not holds(lines[k])), len(lines))


def _joined(text: str) -> str:
    return " ".join(text.split())


def _code(lines: list[str]) -> str:
    return f"<pre><code>{escape(chr(10).join(lines).rstrip())}</code></pre>"


def _table(lines: list[str]) -> str:
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    head, body = (
        rows[0],
        [row for row in rows[1:] if not all(re.fullmatch(r":?-+:?", c) for c in row)],
    )
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
