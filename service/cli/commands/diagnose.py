"""``rbps diagnose``: what a model leaves out."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli import options
from service.cli.ending import guarded


def diagnose(
    ctx: typer.Context,
    data: options.Data = None,
    model: options.Model = "",
    effects: options.Effects = [],  # noqa: B006
    start: options.Values = [],  # noqa: B006
    fixed: options.Fixed = [],  # noqa: B006
    free: options.Free = [],  # noqa: B006
    columns: options.Columns = [],  # noqa: B006
    time: options.TimeColumn = None,
    by: options.By = [],  # noqa: B006
    dt: options.Step = None,
    time_unit: options.TimeUnit = None,
    hold: options.Hold = None,
    extra: Annotated[
        list[str],
        typer.Option(
            metavar="COLUMN,...",
            help="Columns that the model does not use; tests whether it should.",
        ),
    ] = [],  # noqa: B006
    test: options.Test = [],  # noqa: B006
    alpha: Annotated[
        float,
        typer.Option(
            metavar="P",
            help="Probability of a false alarm, where nothing is wrong.",
        ),
    ] = 0.05,
    consider: Annotated[
        list[str],
        typer.Option("--effects", metavar="EFFECT,...", help="Look for these only.  [all]"),
    ] = [],  # noqa: B006
    max_effects: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=1,
            max=10,
            help="Effects to find, one after the other; more than two mean an unknown cause.",
        ),
    ] = 3,
    held_out: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            min=0.0,
            max=0.5,
            help="Share that judges and is not searched, without --test: of the longest or of many records.",
        ),
    ] = 0.2,
    bootstrap: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=0,
            help="Simulated series for a second p-value of the first alarm, 99 or more; takes long.",
        ),
    ] = 0,
    seed: options.Seed = 0,
    name: options.Name = "",
    tags: options.Tags = [],  # noqa: B006
    out: options.Out = None,
    report: options.Report = None,
    plot: options.Plot = None,
    every: Annotated[
        bool, typer.Option("--all", help="List every effect that would have been found.")
    ] = False,
    exit_code: Annotated[
        bool, typer.Option("--exit-code", help="Exit with 3 where the model leaves something out.")
    ] = False,
    state: options.State = None,
    resume: options.Resume = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Find out what a model leaves out: what is wrong, the cause, the extension, the gain.

    The exit code is 0 whatever is found, unless --exit-code is given. The same seed gives the same
    answer. Ctrl-C stops it and keeps what is done; 'rbps diagnose --resume FILE.state' goes on and gives
    the same answer as a run that was never stopped.
    """
    with guarded(as_json):
        from service.cli import diagnose as work
        from service.cli.experiment import asked_of

        if resume is not None:
            changes = options.changes(ctx, {"every", "exit_code"})
            work.resume(resume, changes, as_json, quiet)
            return
        options.check_given(data, model)
        work.diagnose(asked_of(work.Asked, ctx.params), state, as_json, quiet)
