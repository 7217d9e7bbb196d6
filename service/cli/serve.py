"""``rbps serve``: the service."""

from __future__ import annotations

import os
from collections.abc import Sequence

from service.__main__ import main
from service.cli.ending import wrong


def run(host: str | None, port: int | None, models: Sequence[str] = ()) -> None:
    """Serve until a signal comes; options go before the environment's settings."""
    given = {"RBPS_HOST": host, "RBPS_PORT": port}
    env = os.environ | {name: str(value) for name, value in given.items() if value is not None}
    if models:
        also = [env["RBPS_MODELS"]] if env.get("RBPS_MODELS") else []
        env["RBPS_MODELS"] = ",".join([*also, *models])
    try:
        main(env)
    except SystemExit as end:
        if isinstance(end.code, str):  # a setting that is wrong
            raise wrong(end.code.removeprefix("rbps: ")) from None
        raise
