"""The only wiring: settings in, application out."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from importlib.metadata import version

from fastapi import FastAPI

from engine.models.registry import register_files
from service import comparison, guide, job_pages, pages, problem_handlers
from service.api import router
from service.auth import KeyFirst, Keys, check_exposure
from service.limits import BodyLimit
from service.origins import Origins
from service.own_models import OwnModels
from service.processes import GUARD
from service.runner import LocalRunner, Runner
from service.settings import Settings
from service.store import Store
from service.supervisor import Supervisor


def create_app(settings: Settings | None = None) -> FastAPI:
    """The application; its supervisor runs from startup to shutdown.

    Raises RuntimeError in a worker process that only imports the script it was started from.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise RuntimeError(
            "a worker process imports the script that starts the service, and so starts it again: "
            f"{GUARD}"
        )
    settings = settings or Settings.from_env()
    # a worker on another machine has another working folder
    settings = replace(settings, models=",".join(settings.own_models))
    register_files(settings.own_models, OwnModels(settings).read)
    keys = Keys(settings.keys_file)
    check_exposure(settings, keys)
    store = Store(settings.store_url)
    store.check()
    wake = threading.Event()
    supervisor = Supervisor(store, make_runner(store, settings, wake.set), settings, wake)

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
    app.add_middleware(KeyFirst, keys=keys)
    if not keys.needed:
        app.add_middleware(Origins, settings=settings)
    app.add_middleware(BodyLimit, max_body=settings.max_body, seconds=settings.body_seconds)
    app.add_middleware(pages.PageHeaders)
    app.router.routes.extend(pages.routes(keys.needed))  # before the JSON calls
    app.router.routes.extend(guide.routes(keys.needed))
    app.include_router(router(store, supervisor, settings, keys))
    app.include_router(job_pages.router(store, keys))
    app.include_router(comparison.router(store, keys))
    problem_handlers.install(app, keys.needed)
    app.state.supervisor, app.state.store_url = supervisor, settings.store_url
    return app


def make_runner(store: Store, settings: Settings, on_free: Callable[[], None]) -> Runner:
    """On this machine, or on a Dask cluster."""
    if not settings.dask_scheduler:
        return LocalRunner(store, settings, on_free)
    from service.dask_runner import DaskRunner  # an optional extra

    return DaskRunner(store, settings, on_free)
