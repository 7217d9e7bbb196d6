"""``rbps new``: a model to begin with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.ending import guarded
from service.cli.options import Json


def new(
    file: Annotated[Path, typer.Argument(metavar="FILE.py", help="The Python file to write.")],
    as_json: Json = False,
) -> None:
    """Write a commented model that runs, to be changed into your own.

    It is a pendulum, from its differential equation to a model. 'rbps models FILE.py' shows it with what
    its check says, 'rbps serve --model FILE.py' has it on the pages.
    """
    with guarded(as_json):
        from service.cli.new import write

        write(file, as_json)
