"""``rbps fit``: estimate a model's parameters."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli import options
from service.cli.ending import guarded, wrong


def fit(
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
    test: options.Test = [],  # noqa: B006
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
        int,
        typer.Option(
            metavar="N",
            min=2,
            max=options.MOST_PARTICLES,
            help="How many particles the filter has.",
        ),
    ] = 50,
    trajectories: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=2,
            max=options.MOST_PARTICLES,
            help="Smoothed trajectories.  [as many as particles]",
        ),
    ] = None,
    seed: options.Seed = 0,
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
            help="Standard errors and intervals from N >= 2 estimations on simulated data instead.",
        ),
    ] = 0,
    substeps: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=1,
            max=64,
            help="Steps that differential equations make from one sample to the next.",
        ),
    ] = 1,
    name: options.Name = "",
    tags: options.Tags = [],  # noqa: B006
    out: options.Out = None,
    report: options.Report = None,
    plot: options.Plot = None,
    state: options.State = None,
    resume: options.Resume = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Estimate a model's parameters by maximum likelihood.

    Ctrl-C stops it and keeps what is done; 'rbps fit --resume FILE.state' goes on and gives the same
    numbers as a run that was never stopped. --iterations may be given with it too.
    """
    with guarded(as_json):
        from service.cli import fit as work
        from service.cli.experiment import asked_of
        from service.cli.state import Asked
        from service.cli.values import one_of

        if resume is not None:
            work.resume(resume, options.changes(ctx, {"iterations"}), as_json, quiet)
            return
        options.check_given(data, model)
        one_of("--method", method, ("quasi-newton", "rbps-em", "ps-em", "rts-em", "simulation"))
        one_of("--first", first, ("none", "simulation"))
        one_of("--intervals", intervals, ("symmetric", "likelihood-ratio"))
        if bootstrap == 1:
            raise wrong(
                "--bootstrap 1: one run shows no spread; 2 or more are needed, or 0 for none"
            )
        if method == "simulation":
            for unused in (
                "first", "starts", "bootstrap", "iterations", "particles", "trajectories", "intervals",
            ):  # fmt: skip
                if options.given(ctx, unused):
                    raise wrong(
                        f"--{unused} is not for --method simulation, which has starts of its own"
                    )
        work.fit(asked_of(Asked, ctx.params), state, as_json, quiet)
