"""Conditional answers: a body the client has already is not sent again."""

from __future__ import annotations

import hashlib

from fastapi import Request, Response


def with_etag(http: Request, body: bytes, headers: dict[str, str] | None = None) -> Response:
    """A JSON answer with an ETag, or 304 if the client has it already.

    Tags are compared weakly (RFC 9110, 13.1.2): a proxy that compresses makes them weak.
    """
    etag = f'"{hashlib.sha256(body).hexdigest()[:24]}"'
    known = [tag.strip() for tag in http.headers.get("If-None-Match", "").split(",")]
    headers = {"ETag": etag, "Cache-Control": "no-cache"} | (headers or {})
    if "*" in known or etag in (tag.removeprefix("W/") for tag in known):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type="application/json")
