"""The Guide: pages in Markdown beside this file, the catalogue of effects, and the API from its docstrings.

Served by the service itself, without a network; the same files are read in the repository.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute, Route

from service.guide import markdown, reference
from service.pages import missing, prefers_html, render
from service.problems import Problem

PAGES = Path(__file__).parent / "pages"
ORDER = (
    "start", "equations", "measured", "diagnosis", "design", "effects", "methods", "shell", "http", "settings",
    "library", "api", "words", "trouble", "reproduction", "contribute",
)  # fmt: skip
MADE = {"effects": reference.effects, "api": reference.api}  # what follows the text of a page


def routes(keys_needed: bool) -> list[BaseRoute]:
    """The pages; they hold no data of users and need no key."""

    def first(request: Request) -> Response:
        return RedirectResponse(f"/guide/{ORDER[0]}")

    def page(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in ORDER and prefers_html(request.headers.get("accept", "")):
            return missing(keys_needed)
        if name not in ORDER:
            detail = f"the Guide has no page '{name}'; it has {', '.join(ORDER)}"
            return Problem(404, "no-such-page", detail).response()
        return render("guide.html", keys_needed, pages=contents(), name=name, text=content(name))

    return [Route("/guide", first), Route("/guide/{name}", page)]


@cache
def contents() -> list[tuple[str, str]]:
    """(name, title) of every page."""
    return [(name, markdown.title(source(name))) for name in ORDER]


@cache
def content(name: str) -> str:
    """The HTML of a page."""
    made = MADE.get(name)
    return markdown.html(source(name)) + (made() if made else "")


def source(name: str) -> str:
    """The Markdown of a page."""
    return (PAGES / f"{name}.md").read_text(encoding="utf-8")
