"""``rbps design``: the experiment that tells causes apart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli import options
from service.cli.ending import guarded


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
    model: options.Model = "",
    causes: Annotated[
        list[str],
        typer.Option(
            "--cause",
            metavar="EFFECT[=SIZE]",
            help="A cause of the diagnosis, or with its size before any experiment; again for more.",
        ),
    ] = [],  # noqa: B006
    values: options.Values = [],  # noqa: B006
    free: options.Free = [],  # noqa: B006
    length: Annotated[
        int, typer.Option("--length", "-n", metavar="N", min=30, help="Samples of the experiment.")
    ] = 500,
    dt: options.Step = None,
    inputs: Annotated[
        list[str],
        typer.Option(
            "--input",
            metavar="NAME=LOW:HIGH[:RATE]",
            help="Range of an input, change per unit of time (s).",
        ),
    ] = [],  # noqa: B006
    stopbands: Annotated[
        list[str],
        typer.Option(
            "--stopband",
            metavar="INPUT=LOW:HIGH",
            help="Frequencies, cycles per unit of time (Hz), that an input must not excite; again for more.",
        ),
    ] = [],  # noqa: B006
    states: Annotated[
        list[str],
        typer.Option("--limit", metavar="STATE=LOW:HIGH", help="What a state must not leave."),
    ] = [],  # noqa: B006
    outputs: Annotated[
        list[str],
        typer.Option(
            "--limit-output", metavar="OUTPUT=LOW:HIGH", help="What an output must not leave."
        ),
    ] = [],  # noqa: B006
    bounds: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.json",
            exists=True,
            dir_okay=False,
            help="The same and more as JSON: inputs (low, high, rate, forbidden, stopbands, start), states, "
            "outputs, dt, time_unit, sigmas, hold, substeps.",
        ),
    ] = None,
    tries: Annotated[int, typer.Option(metavar="N", min=1, help="Inputs that are tried.")] = 400,
    seed: options.Seed = 0,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.csv", help="Write the input.")
    ] = None,
    shortest: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Write the shortest input that reaches 95 %."),
    ] = None,
    report: options.Report = None,
    plot: options.Plot = None,
    state: options.State = None,
    resume: options.Resume = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Design the experiment that tells the causes of a diagnosis apart.

    Searches over steps, ramps with reversals, multisines and random binary inputs within the bounds; says how
    surely a diagnosis of the new record names the true cause, how short it may be, and which causes no input
    tells apart. Ctrl-C stops it and keeps what is done; 'rbps design --resume FILE.state' goes on and ends with
    the same input.
    """
    with guarded(as_json):
        from service.cli import design as work
        from service.cli.experiment import asked_of

        if resume is not None:
            work.resume(resume, options.changes(ctx, {"shortest"}), as_json, quiet)
            return
        work.design(asked_of(work.Asked, ctx.params), state, as_json, quiet)
