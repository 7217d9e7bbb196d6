"""``rbps compare``: two results side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.ending import guarded
from service.cli.options import Json, Report


def compare(
    one: Annotated[
        Path,
        typer.Argument(
            metavar="A.json", exists=True, dir_okay=False, help="A result written with --out."
        ),
    ],
    other: Annotated[
        Path,
        typer.Argument(
            metavar="B.json", exists=True, dir_okay=False, help="Another result written with --out."
        ),
    ],
    report: Report = None,
    as_json: Json = False,
) -> None:
    """Lay two results side by side: parameters with errors, log-likelihoods, held-out errors.

    The report has their curves over one another too.
    """
    with guarded(as_json):
        from service.cli.compare import show

        show(one, other, report, as_json)
