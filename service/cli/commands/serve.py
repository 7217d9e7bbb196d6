"""``rbps serve``: the service."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli.ending import guarded


def serve(
    host: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Address to listen on.  [RBPS_HOST or 127.0.0.1]"),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=65535, help="Port to listen on.  [RBPS_PORT or 8000]"),
    ] = None,
    models: Annotated[
        list[str],
        typer.Option(
            "--model",
            "-m",
            metavar="MODEL",
            help="Models of your own: path/to/file.py:name, a file, or a folder of files; again for more. "
            "They are read again when their files change.",
        ),
    ] = [],  # noqa: B006
) -> None:
    """Serve the HTTP interface and its pages, as 'python -m service' does."""
    with guarded(False):
        from service.cli.serve import run

        run(host, port, models)
