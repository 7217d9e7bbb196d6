"""``rbps models``: what models there are, and one of them."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli.ending import guarded, wrong
from service.cli.options import Effects, Json


def models(
    name: Annotated[
        str | None, typer.Argument(metavar="[MODEL]", help="The model to show.  [list all]")
    ] = None,
    effects: Effects = [],  # noqa: B006 - typer copies
    list_effects: Annotated[
        bool, typer.Option("--effects", help="List the effects that can be added to the model.")
    ] = False,
    as_json: Json = False,
) -> None:
    """List the models, or show one: equations, channels, parameters with units and bounds."""
    with guarded(as_json):
        from service.cli.models import show_all, show_one

        if name is None:
            if effects or list_effects:
                raise wrong("--with and --effects need the name of a model")
            show_all(as_json)
        else:
            show_one(name, effects, list_effects, as_json)
