"""``rbps diagnose``: what a model leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.ending import guarded, wrong
from service.cli.options import (
    DATA,
    Columns,
    Effects,
    Fixed,
    Free,
    Hold,
    Json,
    Model,
    Name,
    Out,
    Plot,
    Quiet,
    Report,
    Seed,
    Step,
    Tags,
    Test,
    TimeColumn,
    TimeUnit,
    Values,
    absolute_paths,
    given,
    model_named,
    only_output,
)


def diagnose(
    ctx: typer.Context,
    data: Annotated[
        list[Path] | None, typer.Argument(metavar="DATA", help=DATA, exists=True, dir_okay=False)
    ] = None,
    model: Model = "",
    effects: Effects = [],  # noqa: B006
    values: Values = [],  # noqa: B006
    fixed: Fixed = [],  # noqa: B006
    free: Free = [],  # noqa: B006
    columns: Columns = [],  # noqa: B006
    time: TimeColumn = None,
    dt: Step = None,
    time_unit: TimeUnit = None,
    hold: Hold = None,
    extra: Annotated[
        list[str],
        typer.Option(
            metavar="COLUMN,...",
            help="Columns that the model does not use; tests whether it should.",
        ),
    ] = [],  # noqa: B006
    test: Test = [],  # noqa: B006
    alpha: Annotated[
        float,
        typer.Option(metavar="P", help="Probability of a false alarm, where nothing is wrong."),
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
    bootstrap: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=0,
            help="Simulated series for a second p-value of the first alarm, 99 or more; takes long.",
        ),
    ] = 0,
    seed: Seed = 0,
    name: Name = "",
    tags: Tags = [],  # noqa: B006
    out: Out = None,
    report: Report = None,
    plot: Plot = None,
    every: Annotated[
        bool, typer.Option("--all", help="List every effect that would have been found.")
    ] = False,
    exit_code: Annotated[
        bool, typer.Option("--exit-code", help="Exit with 3 where the model leaves something out.")
    ] = False,
    state: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.state",
            help="Keep what is finished here.  [in .rbps/ beside --out, until the diagnosis has ended]",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.state",
            help="Go on with an interrupted diagnosis, as if it had never stopped. Only the "
            "options of output may be given with it.",
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find out what a model leaves out: what is wrong, the cause, the extension, the gain.

    The exit code is 0 whatever is found, unless --exit-code is given. The same seed gives the same
    answer. Ctrl-C stops it and keeps what is done; 'rbps diagnose --resume FILE.state' goes on and gives
    the same answer as a run that was never stopped.
    """
    with guarded(as_json):
        from service.cli import diagnose as work
        from service.cli.experiment import parsed
        from service.cli.values import names

        paths = absolute_paths(out=out, report=report, plot=plot)
        if resume is not None:
            only_output(ctx, {"every", "exit_code"})
            changes: dict[str, Any] = {**paths}
            for option, value in (("every", every), ("exit_code", exit_code)):
                if given(ctx, option):
                    changes[option] = value
            work.resume(resume, changes, as_json, quiet)
            return
        if not data:
            raise wrong("DATA is missing: name one or more data files")
        model = model_named(model)
        clock = {"time": time, "dt": dt, "time_unit": time_unit}
        asked = work.Asked(
            data=[str(one.absolute()) for one in data],
            name=name,
            tags=names(tags),
            **parsed(model, effects, values, fixed, free, columns, clock, hold, seed, paths),
            extra=names(extra),
            test=[str(one.absolute()) for one in test],
            alpha=alpha,
            consider=names(consider),
            max_effects=max_effects,
            bootstrap=bootstrap,
            every=every,
            exit_code=exit_code,
        )
        work.diagnose(asked, state, as_json, quiet)
