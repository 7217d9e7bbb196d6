"""The HTML side: the same addresses as the JSON, for clients that prefer text/html.

A page is a shell without data. Its scripts ask the JSON calls of ``api.py`` for what they show, with the
API key where the service has keys; so a page shows nothing that the API would not tell its reader.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, MutableMapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.routing import BaseRoute, Match, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send

import engine.data
from engine.data.files import READERS
from engine.presentation.report import RULES
from service.responses import OUTCOMES, Kind, Status

HERE = Path(__file__).parent
STATIC = HERE / "static"
NILE = Path(engine.data.__file__).parent / "nile.csv"  # for a first try without data of one's own

# The list of jobs: its filters, its columns (what it is sorted by, title), and what else sorts it.
LIST: dict[str, Any] = {
    "statuses": get_args(Status),
    "kinds": get_args(Kind),
    "outcomes": OUTCOMES,
    "columns": (
        ("name", "Name"), ("status", "State"), ("model", "Model"), ("data", "Data"),
        ("created", "Created"), ("duration", "Progress"), ("outcome", "Result"),
    ),
    "sorts": (
        ("", "newest first"), ("created", "oldest first"), ("name", "name"), ("status", "state"),
        ("kind", "kind"), ("model", "model"), ("data", "data"), ("outcome", "verdict or outcome"),
        ("-log_likelihood", "log-likelihood, largest first"), ("duration", "time it took, shortest first"),
        ("-duration", "time it took, longest first"),
    ),
}  # fmt: skip

# Nothing from other addresses, no script or style within the page, no page within another's.
POLICY = (
    "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; "
    "object-src 'none'"
)


class Page(Route):
    """A route that exists only for clients that prefer HTML; others go on to the JSON call."""

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """As a route, if the Accept header prefers HTML."""
        if scope["type"] == "http" and not prefers_html(Headers(scope=scope).get("accept", "")):
            return Match.NONE, {}
        return super().matches(scope)


def routes(keys_needed: bool) -> list[BaseRoute]:
    """The pages but for the Guide, and static files. Goes before the JSON calls."""

    def page(path: str, template: str, **values: Any) -> Page:
        return Page(path, lambda request: render(template, keys_needed, **values))

    def nile(request: Request) -> Response:
        return FileResponse(NILE, media_type="text/csv")

    def icon(request: Request) -> Response:  # browsers ask for it beside a JSON answer
        return FileResponse(STATIC / "icon.svg")

    def style(request: Request) -> Response:  # the rules that results are drawn by
        return Response(RULES, media_type="text/css", headers={"Cache-Control": "no-cache"})

    return [
        page("/", "start.html"),
        page("/jobs", "jobs.html", **LIST),
        page("/jobs/{job_id}", "job.html"),
        page("/compare", "compare.html"),
        Route("/report.css", style),
        Route("/examples/nile.csv", nile),
        Route("/favicon.ico", icon),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]


def render(template: str, keys_needed: bool, **values: Any) -> Response:
    """A page from a template; ``keys_needed`` tells its scripts to ask for an API key."""
    page = environment().get_template(template)
    return HTMLResponse(page.render(values, keys_needed=keys_needed))


def missing(keys_needed: bool) -> Response:
    """The page of an address that has none."""
    page = render("missing.html", keys_needed)
    page.status_code = 404
    return page


@cache
def environment() -> Environment:
    """The templates, with everything put into them escaped."""
    made = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["version"] = version("rbps")
    made.globals["data_endings"] = ",".join(READERS)
    return made


def prefers_html(accept: str) -> bool:
    """Whether an Accept header ranks text/html above application/json."""
    quality: dict[str, float] = {}
    for part in accept.split(","):
        media, *parameters = (piece.strip().lower() for piece in part.split(";"))
        q = next((p[2:] for p in parameters if p.startswith("q=")), "1")
        quality[media] = float(q) if re.fullmatch(r"[0-9]+(\.[0-9]*)?", q) else 0.0
    return _rank(quality, "text/html") > _rank(quality, "application/json")


def _rank(quality: Mapping[str, float], media: str) -> float:
    """The quality of a media type by the most specific range that holds it."""
    ranges = (media, media.partition("/")[0] + "/*", "*/*")
    return next((quality[name] for name in ranges if name in quality), 0.0)


class PageHeaders:
    """ASGI middleware: what browsers need to be told about every answer; HEAD is answered as GET is."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; add headers to the answer."""

        async def with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                _add_headers(MutableHeaders(raw=message["headers"]), scope["path"])
            await send(message)

        if scope["type"] == "http" and scope["method"] == "HEAD":
            scope = {**scope, "method": "GET"}  # the server knows, and sends no body
        await self.app(scope, receive, with_headers if scope["type"] == "http" else send)


def _add_headers(headers: MutableHeaders, path: str) -> None:
    headers.setdefault("Content-Security-Policy", POLICY)
    headers["X-Content-Type-Options"] = "nosniff"
    headers["Referrer-Policy"] = "same-origin"
    headers.add_vary_header("Accept")  # the same address is HTML for some and JSON for others
    if path.startswith("/static/") or headers.get("content-type", "").startswith("text/html"):
        headers["Cache-Control"] = "no-cache"  # ask again: a new version may have been installed
