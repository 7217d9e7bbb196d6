"""What there is to type. The engine takes a second to import: each command imports its own module."""

from __future__ import annotations

from importlib.metadata import version as version_of
from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.ending import CODES, guarded, wrong
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
    model_names,
    only_output,
)

TRY = """A first try, with data that are simulated:

\b
  rbps simulate -m oscillator --with coulomb:velocity=1 \\
      --excite drive=steps:1:2 -n 500 --dt 0.02 -o run.csv
  rbps fit run.csv -m oscillator --no-standard-errors
  rbps diagnose run.csv -m oscillator --report run.html
"""

app = typer.Typer(
    help=(
        "Estimate the parameters of a state-space model from measured data, and find out what "
        "the model leaves out."
    ),
    epilog=f"{TRY}\n{CODES}",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _version(asked: bool) -> None:
    if asked:
        print(f"rbps {version_of('rbps')}")
        raise typer.Exit()


@app.callback()
def rbps(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Nothing but the options of ``rbps`` itself."""


@app.command(epilog=CODES, short_help="List the models, or show one.")
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


@app.command(epilog=CODES, short_help="List the effects that a diagnosis looks for.")
def effects(
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            "-m",
            metavar="MODEL",
            autocompletion=model_names,
            help="Those of a model, with its channels and units: a registered one, or path/to/file.py:name.",
        ),
    ] = None,
    kind: Annotated[
        list[str], typer.Option(metavar="KIND,...", help="Of these kinds only, such as coulomb.")
    ] = [],  # noqa: B006
    as_json: Json = False,
) -> None:
    """List the effects that a diagnosis looks for: equation, units, and what each may be taken for.

    Without a model, every kind once, as it enters one of the shipped models.
    """
    with guarded(as_json):
        from service.cli.effects import show
        from service.cli.values import names

        show(model, names(kind), as_json)


@app.command(epilog=CODES, short_help="Estimate a model's parameters by maximum likelihood.")
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
        int, typer.Option("--iterations", "-n", metavar="N", min=1, help="At most.")
    ] = 100,
    particles: Annotated[
        int, typer.Option(metavar="N", min=2, help="Particles of the filter.")
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
            help="And intervals; they may take longer than the iterations.",
        ),
    ] = True,
    intervals: Annotated[
        str,
        typer.Option(
            metavar="symmetric|likelihood-ratio",
            help="Of 95 %. By the likelihood ratio they cover better where the likelihood is no parabola, "
            "and take several times as long as all the rest.",
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


@app.command(epilog=CODES, short_help="Find out what a model leaves out, and why.")
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
            help="Columns that the model does not use; asks whether it should.",
        ),
    ] = [],  # noqa: B006
    test: Test = [],  # noqa: B006
    alpha: Annotated[
        float, typer.Option(metavar="P", help="Chance of an alarm where nothing is wrong.")
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
            help="Found in turn at most; more than two mean an unknown cause.",
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


@app.command(epilog=CODES, short_help="Lay two results side by side.")
def compare(
    one: Annotated[
        Path,
        typer.Argument(
            metavar="A.json", exists=True, dir_okay=False, help="A result written with --out."
        ),
    ],
    other: Annotated[
        Path, typer.Argument(metavar="B.json", exists=True, dir_okay=False, help="Another.")
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


@app.command(epilog=CODES, short_help="List the jobs of the service on this machine.")
def jobs(
    text: Annotated[
        str, typer.Argument(metavar="[TEXT]", help="In name, tags, data, model or message.")
    ] = "",
    tag: Annotated[
        list[str], typer.Option(metavar="WORD,...", help="With all of these tags.")
    ] = [],  # noqa: B006
    kind: Annotated[list[str], typer.Option(metavar="KIND,...", help="Of these kinds.")] = [],  # noqa: B006
    sort: Annotated[
        str,
        typer.Option(
            metavar="KEY",
            help="By what: created, name, model, outcome, ...; -KEY for the other way.",
        ),
    ] = "-created",
    most: Annotated[int, typer.Option("--most", "-n", metavar="N", min=1, help="At most.")] = 20,
    as_json: Json = False,
) -> None:
    """List the jobs of the service on this machine: name, verdict, key values; it need not be running."""
    with guarded(as_json):
        from service.cli.jobs import show
        from service.cli.values import names

        show(text, names(tag), names(kind), sort, most, as_json)


@app.command(epilog=CODES, short_help="Design the experiment that tells causes apart.")
def design(
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
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Design the experiment that tells the causes of a diagnosis apart.

    Searches over steps, ramps with reversals, multisines and random binary inputs within the bounds; says how
    surely a diagnosis of the new record names the true cause, how short it may be, and which causes no input
    tells apart.
    """
    with guarded(as_json):
        from service.cli.design import Wanted, run
        from service.cli.values import names

        run(
            Wanted(
                diagnosis=diagnosis,
                model=model,
                causes=cause,
                values=values,
                free=names(free),
                bounds=bounds,
                inputs=inputs,
                stopbands=stopband,
                states=limit,
                outputs=limit_output,
                dt=dt,
                length=length,
                tries=tries,
                seed=seed,
                out=out,
                shortest=shortest,
                report=report,
                plot=plot,
            ),
            as_json,
            quiet,
        )


@app.command(epilog=CODES, short_help="Simulate a model, with an effect hidden in it if you like.")
def simulate(
    model: Model = "",
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
    dt: Step = None,
    time_unit: TimeUnit = None,
    hold: Hold = None,
    inputs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", exists=True, dir_okay=False, help="Data file with the inputs."
        ),
    ] = None,
    columns: Columns = [],  # noqa: B006
    time: TimeColumn = None,
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
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Write t, outputs and inputs to a .csv, .mat or .npz.  [CSV on stdout]",
        ),
    ] = None,
    plot: Plot = None,
    as_json: Json = False,
) -> None:
    """Simulate a model, with an effect hidden in it if you like."""
    with guarded(as_json):
        from service.cli.files import Columns
        from service.cli.simulate import Wanted, run
        from service.cli.values import numbers, pairs

        run(
            Wanted(
                model=model_named(model),
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


@app.command(epilog=CODES, short_help="Serve the HTTP interface and its pages.")
def serve(
    host: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Address to listen on.  [RBPS_HOST or 127.0.0.1]"),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=65535, help="Port to listen on.  [RBPS_PORT or 8000]"),
    ] = None,
    models: Annotated[
        list[str],
        typer.Option(
            "--model",
            "-m",
            metavar="MODEL",
            help="Models of your own: path/to/file.py:name, a file, or a folder of files; again for more. "
            "They are read again when their files change.",
        ),
    ] = [],  # noqa: B006
) -> None:
    """Serve the HTTP interface and its pages, as 'python -m service' does."""
    with guarded(False):
        from service.cli.serve import run

        run(host, port, models)


@app.command(epilog=CODES, short_help="Write a model of your own to begin with.")
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE.py", help="The file to write.")],
    as_json: Json = False,
) -> None:
    """Write a commented model that runs, to be changed into your own.

    It is a pendulum, from its differential equation to a model. 'rbps models FILE.py' shows it with what
    its check says, 'rbps serve --model FILE.py' has it on the pages.
    """
    with guarded(as_json):
        from service.cli.new import write

        write(file, as_json)


def main() -> None:
    """Entry point of ``rbps``."""
    app(prog_name="rbps")
