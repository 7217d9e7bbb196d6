"""``rbps simulate``: data from a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli import options
from service.cli.ending import guarded


def simulate(
    model: options.Model = "",
    effects: Annotated[
        list[str],
        typer.Option(
            "--with", metavar="EFFECT=SIZE", help="Hide an effect, such as coulomb:velocity=0.5."
        ),
    ] = [],  # noqa: B006
    values: Annotated[
        list[str], typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter.")
    ] = [],  # noqa: B006
    samples: Annotated[
        int | None,
        typer.Option("--samples", "-n", metavar="N", min=2, help="Length.  [the inputs' length]"),
    ] = None,
    dt: options.Step = None,
    time_unit: options.TimeUnit = None,
    hold: options.Hold = None,
    inputs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", exists=True, dir_okay=False, help="Data file with the inputs."
        ),
    ] = None,
    columns: options.Columns = [],  # noqa: B006
    time: options.TimeColumn = None,
    excite: Annotated[
        list[str],
        typer.Option(
            metavar="INPUT=KIND:SIZE:SECONDS",
            help="Make an input: 'steps' to random levels within +-SIZE every SECONDS, 'square' "
            "or 'sine' of that amplitude and period.",
        ),
    ] = [],  # noqa: B006
    noise: Annotated[
        bool, typer.Option("--noise/--no-noise", help="Draw the model's noise, or none.")
    ] = True,
    seed: options.Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Write t, outputs and inputs to a .csv, .mat or .npz.  [CSV on stdout]",
        ),
    ] = None,
    plot: options.Plot = None,
    as_json: options.Json = False,
) -> None:
    """Simulate a model, with an effect hidden in it if you like."""
    with guarded(as_json):
        from service.cli.files import Columns
        from service.cli.simulate import Wanted, run
        from service.cli.values import numbers, pairs

        run(
            Wanted(
                model=options.model_named(model),
                effects=numbers("--with", effects),
                values=numbers("--set", values),
                samples=samples,
                inputs=inputs,
                columns=Columns(pairs("--map", columns), time, dt, hold=hold, time_unit=time_unit),
                excite=pairs("--excite", excite),
                noise=noise,
                seed=seed,
                out=out,
                plot=plot,
            ),
            as_json,
        )
