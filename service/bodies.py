"""JSON bodies: counted as they arrive, parsed and validated in a thread, large ones in turn.

FastAPI parses and validates on the event loop, where one large body keeps every other request
waiting, and an array of a million elements takes some hundred bytes for each. So what a body may hold is
counted before anything is made of it, and what then takes long is done elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from contextlib import nullcontext
from typing import Any

from anyio import CapacityLimiter, to_thread
from fastapi import Request, Response, params
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute

from service.problems import Problem
from service.strict_json import loads

Handler = Callable[[Request], Coroutine[Any, Any, Response]]

# Bytes; larger bodies are worked on one after the other, from parsing to answer.
LARGE_BYTES = 1 << 20
# Of all objects in a body; a job has some ten, and one for each parameter and channel.
MEMBERS = 20_000


def json_route(max_values: int) -> type[APIRoute]:
    """The class of routes whose JSON bodies hold at most so many values."""
    turns = CapacityLimiter(1)

    class JsonRoute(APIRoute):
        """A route that reads its body before FastAPI would."""

        def get_route_handler(self) -> Handler:
            """The handler, behind the reading."""
            answer = super().get_route_handler()
            field = self.body_field
            if field is None or isinstance(field.field_info, params.Form):
                return answer

            def parse(body: bytes) -> Any:
                try:
                    value = loads(body)
                except (ValueError, RecursionError) as error:
                    raise Problem(400, "not-json", f"the body is not JSON: {error}") from None
                found, errors = field.validate(value, loc=("body",))
                if errors:
                    raise RequestValidationError(errors)
                return found

            async def read_first(request: Request) -> Response:
                body = await _counted(request, max_values)
                if not body:
                    return await answer(_Read(request, None, b""))  # says that one is needed
                async with turns if len(body) >= LARGE_BYTES else nullcontext():
                    value = await to_thread.run_sync(parse, body)
                    return await answer(_Read(request, value))

            return read_first

    return JsonRoute


class _Read(Request):
    """A request whose body is an object already, which validates at once."""

    def __init__(self, request: Request, value: Any, body: bytes = b" ") -> None:
        super().__init__(request.scope, request.receive)
        self._value, self._bytes = value, body

    async def body(self) -> bytes:
        """Something, so that ``json`` is asked; or nothing."""
        return self._bytes

    async def json(self) -> Any:
        """The object."""
        return self._value


async def _counted(request: Request, max_values: int) -> bytes:
    """The body. Raises Problem 415 for other media, 413 as soon as there are too many values."""
    media = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    chunks, values, members = [], 0, 0
    async for chunk in request.stream():
        if chunk and media != "application/json":
            detail = f"a body of type {media[:80] or '?'} is not understood; send application/json"
            raise Problem(415, "unsupported-media-type", detail)
        # Each value but the first of its list or object follows a comma; commas in strings count too.
        values += chunk.count(b",") + chunk.count(b"[") + chunk.count(b"{")
        members += chunk.count(b":")
        if values > max_values or members > MEMBERS:
            most = f"{max_values} values" if values > max_values else f"{MEMBERS} named members"
            detail = f"the body holds more than the {most} this service takes in one request"
            raise Problem(413, "body-too-large", detail)
        chunks.append(chunk)
    return b"".join(chunks)
