"""``python -m service``: the service with its embedded defaults, or as ``RBPS_*`` say."""

from __future__ import annotations

import sys

import uvicorn

from service.app import create_app
from service.logs import configure
from service.settings import Settings


def main() -> None:
    """Serve until a signal comes."""
    configure()
    try:
        settings = Settings.from_env()
        app = create_app(settings)
    except (ValueError, OSError) as error:
        sys.exit(f"rbps: {error}")
    uvicorn.run(app, host=settings.host, port=settings.port, log_config=None)


if __name__ == "__main__":
    main()
