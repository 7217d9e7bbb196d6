"""The only wiring: settings in, application out."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI

from service import problems
from service.api import router
from service.auth import Keys, check_exposure
from service.limits import BodyLimit
from service.runner import LocalRunner, Terms
from service.settings import Settings
from service.store import Store
from service.supervisor import Supervisor


def create_app(settings: Settings | None = None) -> FastAPI:
    """The application; its supervisor runs from startup to shutdown."""
    settings = settings or Settings.from_env()
    keys = Keys(settings.keys_file)
    check_exposure(settings, keys)
    store = Store(settings.store_url)
    runner = LocalRunner(
        store, settings.workers, Terms.of(settings), on_free=lambda: supervisor.wake()
    )
    supervisor = Supervisor(store, runner, settings)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        supervisor.start()
        yield
        supervisor.stop(settings.drain)
        store.close()

    app = FastAPI(
        title="rbps",
        version=version("rbps"),
        summary="Identification of mixed linear/nonlinear state-space models",
        lifespan=lifespan,
        docs_url=None,  # these pages load scripts from other addresses
        redoc_url=None,
    )
    app.add_middleware(BodyLimit, max_body=settings.max_body, seconds=settings.body_seconds)
    app.include_router(router(store, supervisor, settings, keys))
    problems.install(app)
    app.state.supervisor = supervisor
    return app
