"""Which names the service answers to, and which pages may send it anything.

Without keys, whoever reaches the port may do everything, and a browser on this machine reaches it for
any page it shows: by a name that the page's owner points here (DNS rebinding), or by a form that is sent
across origins. So names other than this machine's own are refused, and changes asked for by other origins.
A caller with a key shows what no foreign page can know.
"""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.problems import Problem
from service.settings import Settings

SAFE = ("GET", "HEAD", "OPTIONS")  # a foreign page may send these, but not read the answer


class Origins:
    """ASGI middleware: 421 for a foreign Host, 403 for a change that a foreign page asks for."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app = app
        self.hosts = {name.strip().lower() for name in settings.hosts.split(",") if name.strip()}
        self.any_host = settings.open_network and not self.hosts  # something else guards the port

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] == "http" and (problem := self._refusal(scope)):
            return await problem.response()(scope, receive, send)
        return await self.app(scope, receive, send)

    def _refusal(self, scope: Scope) -> Problem | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        name = _hostname(f"//{host}")
        if not (self.any_host or name in self.hosts or _is_loopback(name)):
            detail = (
                f"this service does not answer to the name {name[:100]!r}; RBPS_HOSTS may name more"
            )
            return Problem(421, "foreign-host", detail)
        origin = headers.get("origin")
        if origin is None or scope["method"] in SAFE:
            return None
        if urlsplit(origin.lower()).netloc == host.lower() or _hostname(origin) in self.hosts:
            return None
        detail = f"a page of {origin[:100]} may not change anything here"
        return Problem(403, "foreign-origin", detail)


def _hostname(url: str) -> str:
    try:
        return urlsplit(url).hostname or ""
    except ValueError:  # half an IPv6 address
        return ""


def _is_loopback(name: str) -> bool:
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return name == "localhost" or name.endswith(".localhost")
