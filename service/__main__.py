"""``python -m service``: the service with its embedded defaults, or as ``RBPS_*`` say."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from sqlalchemy import make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from engine.errors import EngineError
from service.app import create_app
from service.logs import configure
from service.server import Server, server_config
from service.settings import Settings
from service.usage import told

# How long a thread that works on a large body may go on while the event loop waits for its turn, which it
# does several times for each answer; Python's own 5 ms add up where many ask.
SWITCH_SECONDS = 0.0005
WRONG_ARGUMENT = 2  # exit code


def main(env: Mapping[str, str] | None = None) -> None:
    """Serve until a signal comes, with settings from ``env`` (None: this process's environment)."""
    configure()
    sys.setswitchinterval(SWITCH_SECONDS)
    try:
        settings = Settings.from_env(env)
        app = create_app(settings)
    except (ValueError, OSError, EngineError) as error:
        sys.exit(f"rbps: {error}")
    except ArgumentError as error:  # it may hold a password, so it is not shown
        sys.exit(f"rbps: RBPS_DATABASE_URL cannot be used: {error}")
    except SQLAlchemyError as error:
        reason = str(error.__cause__ or error).splitlines()[0]
        sys.exit(f"rbps: the store {make_url(settings.store_url)!r} cannot be used: {reason}")
    try:
        Server(server_config(app, settings)).run()
    except KeyboardInterrupt:  # passed on by uvicorn, which at the second one has not stopped all
        app.state.supervisor.stop()
        sys.exit(130)


def command(arguments: Sequence[str]) -> None:
    """Serve, or print the help that is asked for; an argument that is not known is refused."""
    try:
        asked = told(arguments)
    except ValueError as error:
        print(f"rbps: {error}", file=sys.stderr)
        sys.exit(WRONG_ARGUMENT)
    if asked is None:
        main()
    else:
        print(asked)


if __name__ == "__main__":
    command(sys.argv[1:])
