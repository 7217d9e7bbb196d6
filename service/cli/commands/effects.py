"""``rbps effects``: what a diagnosis looks for."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli.ending import guarded
from service.cli.options import Json, model_names


def effects(
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            "-m",
            metavar="MODEL",
            autocompletion=model_names,
            help="Those of a model, with its channels and units: a registered one, or path/to/file.py:name.",
        ),
    ] = None,
    kind: Annotated[
        list[str], typer.Option(metavar="KIND,...", help="Of these kinds only, such as coulomb.")
    ] = [],  # noqa: B006
    time_unit: Annotated[
        str,
        typer.Option(
            metavar="UNIT", help="What the model's times count, such as min: rates are per that."
        ),
    ] = "s",
    as_json: Json = False,
) -> None:
    """List the effects that a diagnosis looks for: equation, units, and what each may be taken for.

    Without a model, every kind once, as it enters one of the shipped models.
    """
    with guarded(as_json):
        from service.cli.effects import show
        from service.cli.values import names

        show(model, names(kind), time_unit, as_json)
