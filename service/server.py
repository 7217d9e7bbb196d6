"""The HTTP server: uvicorn with connections that end and are not more than there is room for.

uvicorn times a connection only between two requests: one that never sends a request, sends half of
its headers, or does not read its answer stays for ever. (Hypercorn times reading, but has no limit of
connections and would be a second server to know.) So its protocol gets three timers and a
limit here; the middleware ``BodyLimit`` times bodies.
"""

from __future__ import annotations

import asyncio
import math
import resource
from types import FrameType
from typing import Any

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from service.settings import Settings

# The loop accepts up to so many connections before it looks at the first of them.
BACKLOG_CONNECTIONS = 32
# Descriptors that are no connections: the store's, the workers' and those accepted but not looked at.
OTHER_FILES = 100
STOP_SECONDS = 10  # how long answers on their way may take when the service stops


class Server(uvicorn.Server):
    """A server that ends once, however often it is told to, and within ``STOP_SECONDS``.

    At a second signal uvicorn would leave without ending what runs beside the answers, which is then
    interrupted, with tracebacks in the log.
    """

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Heed the first signal."""
        if not self.should_exit:
            super().handle_exit(sig, frame)


def server_config(app: ASGIApp, settings: Settings, **more: Any) -> uvicorn.Config:
    """How ``uvicorn.Server`` is to serve the application."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=guarded(settings),
        ws="none",
        backlog=BACKLOG_CONNECTIONS,
        # Longer than clients keep one for a next request (often 5 s, as uvicorn's own default), whose
        # request would else meet a connection that is just being closed.
        timeout_keep_alive=math.ceil(settings.header_seconds),
        timeout_graceful_shutdown=STOP_SECONDS,
        log_config=None,
        **more,
    )


def room(settings: Settings) -> int:
    """How many connections there may be: the setting, or what the limit of open files leaves."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files == resource.RLIM_INFINITY:
        return settings.max_connections
    return min(settings.max_connections, max(files - OTHER_FILES, 10))


def guarded(settings: Settings) -> type[H11Protocol]:
    """The protocol with the settings' limits."""
    most = room(settings)

    class Guarded(H11Protocol):
        """One connection."""

        heard = 0.0  # when the client last sent anything
        _request_timer: asyncio.TimerHandle | None = None
        _write_timer: asyncio.TimerHandle | None = None

        @property
        def computing(self) -> bool:
            """Whether a whole request is here that is not answered yet."""
            return self.answering and not self.cycle.more_body

        @property
        def answering(self) -> bool:
            """Whether a request has begun that is not answered yet."""
            return self.cycle is not None and not self.cycle.response_complete

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            """Where there are too many, the one goes that has been silent longest."""
            super().connection_made(transport)
            self.heard = self.loop.time()
            self._time_request()
            if len(self.connections) > most:
                waiting = [
                    one
                    for one in self.connections
                    if isinstance(one, Guarded) and one is not self and not one.computing
                ]
                leaves = min(waiting, key=lambda one: one.heard, default=self)
                self.connections.discard(leaves)
                leaves.transport.abort()

        def data_received(self, data: bytes) -> None:
            """A request has its time from the first byte to the end of its headers."""
            self.heard = self.loop.time()
            super().data_received(data)
            self._time_request()

        def _time_request(self) -> None:
            if self.answering:
                _cancel(self._request_timer)
                self._request_timer = None
            elif self._request_timer is None:
                self._request_timer = self.loop.call_later(
                    settings.header_seconds, self.transport.abort
                )

        def pause_writing(self) -> None:
            """The client does not read; it has some time to begin again."""
            super().pause_writing()
            self._write_timer = self.loop.call_later(settings.body_seconds, self.transport.abort)

        def resume_writing(self) -> None:
            """The client reads again."""
            _cancel(self._write_timer)
            super().resume_writing()

        def connection_lost(self, exc: Exception | None) -> None:
            """Nothing is left to be timed."""
            _cancel(self._request_timer)
            _cancel(self._write_timer)
            super().connection_lost(exc)

        def shutdown(self) -> None:
            """The service stops: a body that is still on its way is not waited for."""
            if self.answering and not self.computing:
                self.transport.abort()
            super().shutdown()

    return Guarded


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
