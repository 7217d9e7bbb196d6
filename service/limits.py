"""Limits on the size and the pace of request bodies, before anything reads them."""

from __future__ import annotations

import asyncio

from fastapi import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.problems import Problem

WHOLE = 20  # pauses that a body may be made of


class BodyLimit:
    """ASGI middleware: 413 for bodies above ``max_body`` bytes, 408 for pauses above ``seconds``.

    A body that takes WHOLE times as long altogether is a 408 too, however short its pauses are.
    """

    def __init__(self, app: ASGIApp, max_body: int, seconds: float) -> None:
        self.app, self.max_body, self.seconds = app, max_body, seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on with a receive that counts."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        detail = f"the body is larger than the {self.max_body} bytes this service takes"
        length = dict(scope["headers"]).get(b"content-length", b"0")
        if length.isdigit() and int(length[:20]) > self.max_body:
            return await Problem(413, "body-too-large", detail).response()(scope, receive, send)
        seen, more, clock = 0, True, asyncio.get_running_loop().time
        end = clock() + WHOLE * self.seconds

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
                    slow = f"the body took longer than {WHOLE * self.seconds:g} s"
                raise HTTPException(408, slow, {"Connection": "close"}) from None
            more = message.get("more_body", False)
            seen += len(message.get("body", b""))
            if seen > self.max_body:
                raise HTTPException(413, detail)
            return message

        return await self.app(scope, counted, send)
