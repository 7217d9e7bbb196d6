"""``rbps design``: the experiment that tells causes apart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.ending import guarded
from service.cli.options import (
    Free,
    Json,
    Model,
    Plot,
    Quiet,
    Report,
    Seed,
    Step,
    Values,
    absolute_paths,
    only_output,
)


def design(
    ctx: typer.Context,
    diagnosis: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DIAGNOSIS]",
            help="The JSON of 'rbps diagnose --out', or a file of Diagnosis.save. Without one: --model and "
            "--cause.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    model: Model = "",
    cause: Annotated[
        list[str],
        typer.Option(
            metavar="EFFECT[=SIZE]",
            help="A cause of the diagnosis, or with its size before any experiment; again for more.",
        ),
    ] = [],  # noqa: B006
    values: Values = [],  # noqa: B006
    free: Free = [],  # noqa: B006
    length: Annotated[
        int, typer.Option("--length", "-n", metavar="N", min=30, help="Samples of the experiment.")
    ] = 500,
    dt: Step = None,
    inputs: Annotated[
        list[str],
        typer.Option(
            "--input", metavar="NAME=LOW:HIGH[:RATE]", help="Range of an input, change per second."
        ),
    ] = [],  # noqa: B006
    stopband: Annotated[
        list[str],
        typer.Option(
            metavar="INPUT=LOW:HIGH",
            help="Frequencies, Hz, that an input must not excite; again for more.",
        ),
    ] = [],  # noqa: B006
    limit: Annotated[
        list[str], typer.Option(metavar="STATE=LOW:HIGH", help="What a state must not leave.")
    ] = [],  # noqa: B006
    limit_output: Annotated[
        list[str], typer.Option(metavar="OUTPUT=LOW:HIGH", help="What an output must not leave.")
    ] = [],  # noqa: B006
    bounds: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.json",
            exists=True,
            dir_okay=False,
            help="The same and more as JSON: inputs (low, high, rate, forbidden, stopbands, start), states, "
            "outputs, dt, sigmas, hold, substeps.",
        ),
    ] = None,
    tries: Annotated[int, typer.Option(metavar="N", min=1, help="Inputs that are tried.")] = 400,
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE.csv", help="Write the input."),
    ] = None,
    shortest: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Write the shortest input that reaches 95 %."),
    ] = None,
    report: Report = None,
    plot: Plot = None,
    state: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.state",
            help="Keep what is finished here.  [in .rbps/ beside --out, until the design has ended]",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.state",
            help="Go on with an interrupted design, as if it had never stopped. Only the options of output "
            "may be given with it.",
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Design the experiment that tells the causes of a diagnosis apart.

    Searches over steps, ramps with reversals, multisines and random binary inputs within the bounds; says how
    surely a diagnosis of the new record names the true cause, how short it may be, and which causes no input
    tells apart. Ctrl-C stops it and keeps what is done; 'rbps design --resume FILE.state' goes on and ends with
    the same input.
    """
    with guarded(as_json):
        from service.cli import design as work
        from service.cli.references import absolute
        from service.cli.values import names

        paths: dict[str, Any] = {
            **absolute_paths(out=out, shortest=shortest, report=report, plot=plot)
        }
        if resume is not None:
            only_output(ctx, {"shortest"})
            work.resume(resume, paths, as_json, quiet)
            return
        paths |= absolute_paths(diagnosis=diagnosis, bounds=bounds)
        asked = work.Asked(
            **paths,
            model=absolute(model),
            causes=cause,
            values=values,
            free=names(free),
            inputs=inputs,
            stopbands=stopband,
            states=limit,
            outputs=limit_output,
            dt=dt,
            length=length,
            tries=tries,
            seed=seed,
        )
        work.design(asked, state, as_json, quiet)
