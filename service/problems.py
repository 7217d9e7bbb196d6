"""Errors as RFC 9457 problem documents (``application/problem+json``), every one of them."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.routing import Match
from starlette.types import Scope

log = logging.getLogger("service")

MEDIA_TYPE = "application/problem+json"
# The two problems that OGC API - Processes names keep the identifiers clients know.
_OGC = "http://www.opengis.net/def/exceptions/ogcapi-processes-1/1.0/"
_TYPES = {kind: _OGC + kind for kind in ("no-such-job", "result-not-ready")}

# What the owner of a failed job can do; DIVERGED and COLLAPSED say so themselves.
ADVICE = {
    "computation-failed": "Check the start values, the units of the data and the time step; if they are "
    "right, start elsewhere or hold some parameters fixed.",
    "no-start-succeeded": "Give ranges (parameters.ranges) around values that are physically plausible, or "
    "use more particles.",
    "not-finite": "Check the parameter values, the scale of the inputs and the time step.",
    "out-of-memory": "Use fewer particles or trajectories, or split the data into shorter series.",
    "run-time-exceeded": "Use fewer iterations, particles or starts, or allow more time (run_seconds).",
    "worker-lost": "Send the job again; if it is lost again, it probably needs more memory than the machine "
    "has: use fewer particles.",
}


class Problem(Exception):  # noqa: N818 - the RFC's own word
    """An error the client is told about.

    ``kind`` ends the problem's type; ``errors`` lists {field, message, row?, channel?}.
    """

    def __init__(
        self,
        status: int,
        kind: str,
        detail: str,
        errors: Sequence[dict[str, Any]] = (),
        retry_after: float | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status, self.kind, self.detail = status, kind, detail
        self.errors, self.headers = list(errors), dict(headers or {})
        if retry_after is not None:
            self.headers["Retry-After"] = str(max(1, round(retry_after)))

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Problem:
        """The problem of a stored document."""
        kind = str(document["type"]).rpartition(":")[2]
        return cls(document["status"], kind, document["detail"], document.get("errors", ()))

    def document(self) -> dict[str, Any]:
        """The JSON body."""
        body: dict[str, Any] = {
            "type": _TYPES.get(self.kind, f"urn:rbps:problem:{self.kind}"),
            "title": self.kind.replace("-", " "),
            "status": self.status,
            "detail": self.detail,
        }
        if self.kind in ADVICE:
            body["advice"] = ADVICE[self.kind]
        return body | ({"errors": self.errors} if self.errors else {})

    def response(self) -> JSONResponse:
        """The HTTP answer."""
        return JSONResponse(self.document(), self.status, self.headers, MEDIA_TYPE)


def invalid(field: str, message: str, **more: Any) -> Problem:
    """422 about one field; ``more`` may hold row and channel."""
    error = {"field": field, "message": message} | more
    return Problem(422, "validation", f"{field}: {message}" if field else message, [error])


def field_path(location: Sequence[str | int]) -> str:
    """('body', 'series', 0, 'y') -> 'series[0].y'."""
    path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return path.removeprefix(".body").removeprefix(".")


def _from_validation(error: RequestValidationError) -> Problem:
    errors = []
    for item in error.errors()[:20]:
        location = list(item["loc"])
        if str(item.get("type", "")).startswith("union_tag"):
            location.append("kind")
        if location[:1] == ["body"] and len(location) > 1 and item.get("type") != "json_invalid":
            location = [part for i, part in enumerate(location) if i != 1 or part not in _KINDS]
        message = re.sub(r"^Value error, ", "", str(item["msg"]))
        entry = {"field": field_path(location), "message": message}
        context = item.get("ctx", {})
        entry |= {key: context[key] for key in ("row", "channel") if key in context}
        errors.append(entry)
    detail = "; ".join(f"{e['field']}: {e['message']}" if e["field"] else e["message"]
                       for e in errors[:3])  # fmt: skip
    broken = any(item.get("type") == "json_invalid" for item in error.errors())
    return Problem(400 if broken else 422, "not-json" if broken else "validation", detail, errors)


def _methods(app: FastAPI, scope: Scope) -> set[str]:
    """What an address can be asked with; several routes may share it, one of each method."""
    every = ("GET", "POST", "DELETE", "PUT", "PATCH")
    found = {
        method
        for method in every
        for route in app.routes
        if route.matches({**scope, "method": method})[0] is Match.FULL
    }
    return found | {"HEAD"} if "GET" in found else found


_BODIES = ("application/json", "multipart/form-data")
_KINDS = frozenset({"estimate", "smooth", "simulate", "diagnose"})  # tags of the body's union


def install(app: FastAPI) -> None:
    """Make every error of the application a problem document."""

    @app.exception_handler(Problem)
    async def _problem(request: Request, error: Problem) -> JSONResponse:
        return error.response()

    @app.exception_handler(RequestValidationError)
    async def _validation(request: Request, error: RequestValidationError) -> JSONResponse:
        media = request.headers.get("content-type", "application/json")
        if request.method == "POST" and not media.startswith(_BODIES):
            detail = f"a body of type {media[:80]} is not understood; send application/json"
            return Problem(415, "unsupported-media-type", detail).response()
        return _from_validation(error).response()

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        kind = HTTPStatus(error.status_code).phrase.lower().replace(" ", "-")
        response = Problem(error.status_code, kind, str(error.detail)).response()
        response.headers.update(error.headers or {})
        if error.status_code == 405:
            response.headers["Allow"] = ", ".join(sorted(_methods(app, request.scope)))
        return response

    @app.exception_handler(SQLAlchemyError)
    async def _store(request: Request, error: SQLAlchemyError) -> JSONResponse:
        log.error("%s %s: the store failed", request.method, request.url.path, exc_info=error)
        reason = str(error.__cause__ or error).splitlines()[0]
        detail = f"the store cannot be used now: {reason}"
        return Problem(503, "store-unavailable", detail, retry_after=5).response()

    @app.exception_handler(Exception)
    async def _unexpected(request: Request, error: Exception) -> JSONResponse:
        log.exception("%s %s failed", request.method, request.url.path, exc_info=error)
        detail = "the service met an error of its own; its log has the details"
        return Problem(500, "internal", detail).response()
