"""``rbps serve``: the service."""

from __future__ import annotations

import os

from service.__main__ import main
from service.cli.ending import wrong


def run(host: str | None, port: int | None) -> None:
    """Serve until a signal comes; options go before the environment's settings."""
    env = dict(os.environ)
    if host is not None:
        env["RBPS_HOST"] = host
    if port is not None:
        env["RBPS_PORT"] = str(port)
    try:
        main(env)
    except SystemExit as end:
        if isinstance(end.code, str):  # a setting that is wrong
            raise wrong(end.code.removeprefix("rbps: ")) from None
        raise
