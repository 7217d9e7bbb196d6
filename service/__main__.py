"""``python -m service``: the service with its embedded defaults, or as ``RBPS_*`` say."""

from __future__ import annotations

import sys

import uvicorn

from service.app import create_app
from service.logs import configure
from service.server import server_config
from service.settings import Settings


def main() -> None:
    """Serve until a signal comes."""
    configure()
    try:
        settings = Settings.from_env()
        app = create_app(settings)
    except (ValueError, OSError) as error:
        sys.exit(f"rbps: {error}")
    uvicorn.Server(server_config(app, settings)).run()


if __name__ == "__main__":
    main()
