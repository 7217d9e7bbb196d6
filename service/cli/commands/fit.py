"""``rbps fit``: estimate a model's parameters."""

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


def fit(
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
    test: Test = [],  # noqa: B006
    method: Annotated[
        str,
        typer.Option(
            metavar="METHOD",
            help="quasi-newton, maximum likelihood in few iterations; rbps-em, EM as in the paper; ps-em, "
            "without Rao-Blackwellization; rts-em, exact for linear models; "
            "simulation, least squares on the simulation without noise.",
        ),
    ] = "quasi-newton",
    first: Annotated[
        str,
        typer.Option(
            metavar="none|simulation",
            help="Let the iterations leave from the fit of the simulation.",
        ),
    ] = "none",
    iterations: Annotated[
        int,
        typer.Option("--iterations", "-n", metavar="N", min=1, help="Upper limit on iterations."),
    ] = 100,
    particles: Annotated[
        int, typer.Option(metavar="N", min=2, help="How many particles the filter has.")
    ] = 50,
    trajectories: Annotated[
        int | None,
        typer.Option(metavar="N", min=2, help="Smoothed trajectories.  [as many as particles]"),
    ] = None,
    seed: Seed = 0,
    standard_errors: Annotated[
        bool,
        typer.Option(
            "--standard-errors/--no-standard-errors",
            help="Compute standard errors and intervals; may take longer than the iterations.",
        ),
    ] = True,
    intervals: Annotated[
        str,
        typer.Option(
            metavar="symmetric|likelihood-ratio",
            help="How the 95 % intervals are computed. By the likelihood ratio they cover better where the "
            "log-likelihood is far from quadratic, and take several times as long as all the rest.",
        ),
    ] = "symmetric",
    starts: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=1,
            help="Take the best of N starts: yours, and others drawn within +-50 % of it.",
        ),
    ] = 1,
    bootstrap: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=0,
            help="Standard errors and intervals from N estimations on simulated data instead.",
        ),
    ] = 0,
    name: Name = "",
    tags: Tags = [],  # noqa: B006
    out: Out = None,
    report: Report = None,
    plot: Plot = None,
    state: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.state",
            help="Keep the iterations here.  [in .rbps/ beside --out, until the estimation has ended]",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.state",
            help="Go on with an interrupted estimation, as if it had never stopped. Only "
            "--iterations and the options of output may be given with it.",
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate a model's parameters by maximum likelihood.

    Ctrl-C stops it and keeps what is done; 'rbps fit --resume FILE.state' goes on and gives the same
    numbers as a run that was never stopped.
    """
    with guarded(as_json):
        from service.cli import fit as work
        from service.cli.experiment import parsed
        from service.cli.state import Asked
        from service.cli.values import names, one_of

        paths = absolute_paths(out=out, report=report, plot=plot)
        if resume is not None:
            only_output(ctx, {"iterations"})
            changes: dict[str, Any] = {**paths}
            if given(ctx, "iterations"):
                changes["iterations"] = iterations
            work.resume(resume, changes, as_json, quiet)
            return
        if not data:
            raise wrong("DATA is missing: name one or more data files")
        one_of("--method", method, ("quasi-newton", "rbps-em", "ps-em", "rts-em", "simulation"))
        one_of("--first", first, ("none", "simulation"))
        one_of("--intervals", intervals, ("symmetric", "likelihood-ratio"))
        if method == "simulation":
            for option, parameter in (
                ("--first", "first"),
                ("--starts", "starts"),
                ("--bootstrap", "bootstrap"),
                ("--iterations", "iterations"),
                ("--particles", "particles"),
                ("--trajectories", "trajectories"),
                ("--intervals", "intervals"),
            ):
                if given(ctx, parameter):
                    raise wrong(
                        f"{option} is not for --method simulation, which has starts of its own"
                    )
        model = model_named(model)
        clock = {"time": time, "dt": dt, "time_unit": time_unit}
        asked = Asked(
            data=[str(path.absolute()) for path in data],
            test=[str(path.absolute()) for path in test],
            name=name,
            tags=names(tags),
            **parsed(model, effects, values, fixed, free, columns, clock, hold, seed, paths),
            method=method,
            first=first,
            particles=particles,
            trajectories=trajectories,
            iterations=iterations,
            standard_errors=standard_errors,
            intervals=intervals,
            starts=starts,
            bootstrap=bootstrap,
        )
        work.fit(asked, state, as_json, quiet)
