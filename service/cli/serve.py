"""``rbps serve``: the service."""

from __future__ import annotations

import os
from collections.abc import Sequence

from service.__main__ import main
from service.cli.ending import wrong


def run(host: str | None, port: int | None, models: Sequence[str] = ()) -> None:
    """Serve until a signal comes; options go before the environment's settings."""
    env = dict(os.environ)
    if host is not None:
        env["RBPS_HOST"] = host
    if port is not None:
        env["RBPS_PORT"] = str(port)
    if models:
        also = [env["RBPS_MODELS"]] if env.get("RBPS_MODELS") else []
        env["RBPS_MODELS"] = ",".join([*also, *models])
    try:
        main(env)
    except SystemExit as end:
        if isinstance(end.code, str):  # a setting that is wrong
            raise wrong(end.code.removeprefix("rbps: ")) from None
        raise
