"""``rbps jobs``: the jobs of the service on this machine."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli.ending import guarded
from service.cli.options import Json


def jobs(
    text: Annotated[
        str,
        typer.Argument(
            metavar="[TEXT]", help="Only jobs with this text in name, tags, data, model or message."
        ),
    ] = "",
    tag: Annotated[
        list[str], typer.Option(metavar="WORD,...", help="Only jobs with all of these tags.")
    ] = [],  # noqa: B006
    kind: Annotated[
        list[str],
        typer.Option(metavar="KIND,...", help="Only jobs of these kinds, such as diagnose."),
    ] = [],  # noqa: B006
    sort: Annotated[
        str,
        typer.Option(
            metavar="KEY",
            help="Sort by created, name, model, outcome, ...; -KEY for the other way.",
        ),
    ] = "-created",
    most: Annotated[
        int, typer.Option("--most", "-n", metavar="N", min=1, help="Upper limit on jobs listed.")
    ] = 20,
    as_json: Json = False,
) -> None:
    """List the jobs of the service on this machine: name, verdict, key values; it need not be running."""
    with guarded(as_json):
        from service.cli.jobs import show
        from service.cli.values import names

        show(text, names(tag), names(kind), sort, most, as_json)
