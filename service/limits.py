"""Limits on the size and the pace of request bodies, before anything reads them."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from fastapi import HTTPException
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.problems import Problem

WHOLE_PAUSES = 20  # pauses that a body may be made of
LARGEST_BODIES = 4  # largest bodies that may be on their way at once
LINGER_SECONDS, LINGER_BYTES = 5.0, 1 << 30  # how long what an answer did not wait for is read on


def has_body(headers: Headers) -> bool:
    """Whether a request brings a body."""
    return "transfer-encoding" in headers or headers.get("content-length", "0") != "0"


class BodyLimit:
    """ASGI middleware: 413 for bodies above ``max_body`` bytes, 408 for pauses above ``seconds``.

    A body that takes WHOLE_PAUSES times as long altogether is a 408 too, however short its pauses are; one
    that is encoded is a 415, for nothing here unpacks it; one that finds too many others on their way
    is a 503. An answer that did not need the whole body is sent at once and the rest of the body read and
    dropped for a while: a connection closed before would be reset, and the answer lost.
    """

    def __init__(self, app: ASGIApp, max_body: int, seconds: float) -> None:
        self.app, self.max_body, self.seconds = app, max_body, seconds
        self.held = 0  # bytes of all bodies whose requests are not answered yet

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on with a receive that counts."""
        if scope["type"] != "http" or not has_body(Headers(scope=scope)):
            return await self.app(scope, receive, send)
        seen, more, clock = 0, True, asyncio.get_running_loop().time
        end = clock() + WHOLE_PAUSES * self.seconds

        async def counted() -> Message:
            nonlocal seen, more
            if not more:  # the whole body is here; what is awaited now is the client's leaving
                return await receive()
            try:
                left = min(self.seconds, max(0.0, end - clock()))
                message = await asyncio.wait_for(receive(), left)
            except TimeoutError:
                slow = f"the body paused for more than {self.seconds:g} s"
                if clock() > end:
                    slow = f"the body took longer than {WHOLE_PAUSES * self.seconds:g} s"
                raise HTTPException(408, slow, {"Connection": "close"}) from None
            more = message.get("more_body", False)
            size = len(message.get("body", b""))
            seen, self.held = seen + size, self.held + size
            if seen > self.max_body:
                raise HTTPException(413, self._too_large())
            if self.held > LARGEST_BODIES * self.max_body:
                many = "too many large bodies are on their way; try again later"
                raise HTTPException(503, many, {"Retry-After": "5"})
            return message

        async def answered(message: Message) -> None:
            if message["type"] == "http.response.body" and not message.get("more_body") and more:
                await send({**message, "more_body": True})
                await _drop(receive)
                message = {"type": "http.response.body", "body": b"", "more_body": False}
            await send(message)

        try:
            if refusal := self._refusal(Headers(scope=scope)):
                await refusal.response()(scope, receive, answered)
            else:
                await self.app(scope, counted, answered)
        finally:
            self.held -= seen

    def _refusal(self, headers: Headers) -> Problem | None:
        """What the headers tell already."""
        length = headers.get("content-length", "0")
        if length.isdigit() and int(length[:20]) > self.max_body:
            return Problem(413, "body-too-large", self._too_large())
        coding = headers.get("content-encoding", "identity")
        if coding != "identity":
            detail = f"a body in the encoding {coding[:40]} is not understood; send it without an encoding"
            refused = {"Accept-Encoding": "identity"}
            return Problem(415, "unsupported-media-type", detail, headers=refused)
        return None

    def _too_large(self) -> str:
        return f"the body is larger than the {self.max_body} bytes this service takes"


async def _drop(receive: Receive) -> None:
    """Read what a client still sends, within limits."""
    left = LINGER_BYTES
    with suppress(TimeoutError):
        async with asyncio.timeout(LINGER_SECONDS):
            while left > 0:
                message = await receive()
                if not message.get("more_body", False):  # the end, or the client has gone
                    return
                left -= len(message.get("body", b""))
