"""API keys: optional, stored as hashes, compared in constant time.

``python -m service.auth NAME`` makes a key and prints the line for the file that the setting
``keys_file`` names: one ``NAME SHA256`` per line. A key sees its own jobs and no others.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import re
import secrets
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from fastapi import Request, Security
from fastapi.security import APIKeyHeader
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.limits import has_body
from service.problems import Problem
from service.settings import Settings

HEADER = APIKeyHeader(name="X-API-Key", auto_error=False)


class Keys:
    """The keys of a service, and the names of those who show them ("" without keys)."""

    def __init__(self, file: Path | None) -> None:
        self._hashes: dict[str, str] = {}
        for i, line in enumerate(file.read_text("utf-8").splitlines() if file else ()):
            if not line.strip() or line.startswith("#"):
                continue
            name, _, digest = line.strip().partition(" ")
            if not re.fullmatch("[0-9a-fA-F]{64}", digest) or len(name) > 64:
                raise ValueError(f"{file}, line {i + 1}: 'NAME SHA256' is needed")
            if name in self._hashes:
                raise ValueError(f"{file}, line {i + 1}: '{name}' is there twice")
            self._hashes[name] = digest.lower()
        if file is not None and not self._hashes:  # else everybody would be let in
            raise ValueError(f"{file} holds no key (python -m service.auth makes one)")

    @property
    def needed(self) -> bool:
        """Whether callers need a key."""
        return bool(self._hashes)

    @property
    def dependency(self) -> Callable[..., str]:
        """FastAPI dependency: the caller's name, or a problem 401. Describes keys only where needed."""

        def known(request: Request, key: Annotated[str | None, Security(HEADER)] = None) -> str:
            return self.caller(request.headers)

        return known if self.needed else lambda: ""

    @property
    def refusals(self) -> tuple[int, ...]:
        """Statuses of refused callers: without a key, or from a foreign page."""
        return (401,) if self.needed else (403, 421)

    def caller(self, headers: Headers) -> str:
        """The name of who sends these headers. Raises Problem 401."""
        if not self.needed:
            return ""
        key = headers.get("X-API-Key")
        if key is None:
            scheme, _, key = headers.get("Authorization", "").partition(" ")
            key = key if scheme.lower() == "bearer" else ""
        presented = digest_of(key)
        # All are compared, so the time tells nothing about which or how many there are.
        matches = [name for name, d in self._hashes.items() if hmac.compare_digest(d, presented)]
        if not matches:
            detail = "a valid API key is needed, as X-API-Key or as Authorization: Bearer"
            raise Problem(401, "unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})
        return matches[0]


class KeyFirst:
    """ASGI middleware: who sends a body shows a key before anything of the body is read."""

    def __init__(self, app: ASGIApp, keys: Keys) -> None:
        self.app, self.keys = app, keys

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or answer 401."""
        if scope["type"] == "http" and has_body(headers := Headers(scope=scope)):
            try:
                self.keys.caller(headers)
            except Problem as problem:
                return await problem.response()(scope, receive, send)
        return await self.app(scope, receive, send)


def digest_of(key: str) -> str:
    """What is stored of a key; keys are long and random, so a fast hash is enough."""
    return hashlib.sha256(key.encode()).hexdigest()


def check_exposure(settings: Settings, keys: Keys) -> None:
    """Raise ValueError for a service that strangers could use."""
    try:
        loopback = ipaddress.ip_address(settings.host).is_loopback
    except ValueError:
        loopback = settings.host == "localhost"
    if not (keys.needed or loopback or settings.open_network):
        raise ValueError(
            f"host {settings.host} can be reached from other machines: set RBPS_KEYS_FILE "
            "(python -m service.auth makes keys), or RBPS_OPEN_NETWORK=yes if something else "
            "guards the port"
        )


if __name__ == "__main__":
    if len(sys.argv) != 2 or not sys.argv[1].isidentifier():
        sys.exit("usage: python -m service.auth NAME  (a name of letters, digits and _)")
    new = secrets.token_urlsafe(32)
    print(f"key, shown only now:       {new}")
    print(f"line for RBPS_KEYS_FILE:   {sys.argv[1]} {digest_of(new)}")
