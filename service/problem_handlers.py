"""Every error of the application becomes a problem document."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any, get_args

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match
from starlette.types import Scope

from service.pages import missing, prefers_html
from service.problems import Problem
from service.responses import Kind

log = logging.getLogger("service")


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
        message = _said(item, location)
        entry = {"field": field_path(location), "message": message}
        context = item.get("ctx", {})
        entry |= {key: context[key] for key in ("row", "channel") if key in context}
        errors.append(entry)
    detail = "; ".join(f"{e['field']}: {e['message']}" if e["field"] else e["message"]
                       for e in errors[:3])  # fmt: skip
    broken = any(item.get("type") == "json_invalid" for item in error.errors())
    return Problem(400 if broken else 422, "not-json" if broken else "validation", detail, errors)


def _said(item: Any, location: Sequence[str | int]) -> str:
    """What is wrong in words of ours where the checker's help nobody."""
    kind, last = str(item.get("type", "")), location[-1] if location else ""
    if kind == "extra_forbidden":
        if last == "file":
            return "a file is sent beside the request with POST /jobs/upload; here are its numbers needed"
        return "there is no such member"
    if kind.startswith("union_tag"):
        return f"the kind of job is needed, one of {', '.join(_KINDS)}"
    if list(location) == ["body"] and kind in ("missing", "model_attributes_type"):
        return "a JSON object is needed"
    if kind.startswith("model_") and last == "model":
        return "the name of a model is needed, or an object with its name"
    return re.sub(r"^Value error, ", "", str(item["msg"]))


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
_KINDS = get_args(Kind)  # tags of the body's union


def install(app: FastAPI, keys_needed: bool) -> None:
    """Make every error of the application a problem document; an address that is none has a page, too."""

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
    async def _http(request: Request, error: HTTPException) -> Response:
        if error.status_code == 404 and prefers_html(request.headers.get("accept", "")):
            return missing(keys_needed)
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
