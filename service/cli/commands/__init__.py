"""What there is to type, a module for each command; they import the engine, which takes a second, when run."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version as version_of
from typing import Annotated

import typer

from service.cli.commands.compare import compare
from service.cli.commands.design import design
from service.cli.commands.diagnose import diagnose
from service.cli.commands.effects import effects
from service.cli.commands.fit import fit
from service.cli.commands.jobs import jobs
from service.cli.commands.models import models
from service.cli.commands.new import new
from service.cli.commands.serve import serve
from service.cli.commands.simulate import simulate
from service.cli.ending import CODES

TRY = """A first try, with data that are simulated:

\b
  rbps simulate -m oscillator --with coulomb:velocity=1 \\
      --excite drive=steps:1:2 -n 500 --dt 0.02 -o run.csv
  rbps fit run.csv -m oscillator --no-standard-errors
  rbps diagnose run.csv -m oscillator --report run.html
"""

# as 'rbps --help' lists them
COMMANDS: dict[Callable[..., None], str] = {
    models: "List the models, or show one.",
    effects: "List the effects that a diagnosis looks for.",
    fit: "Estimate a model's parameters by maximum likelihood.",
    diagnose: "Find out what a model leaves out, and why.",
    compare: "Lay two results side by side.",
    jobs: "List the jobs of the service on this machine.",
    design: "Design the experiment that tells causes apart.",
    simulate: "Simulate a model, with an effect hidden in it if you like.",
    serve: "Serve the HTTP interface and its pages.",
    new: "Write a model of your own to begin with.",
}

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


for command, in_a_line in COMMANDS.items():
    app.command(epilog=CODES, short_help=in_a_line)(command)


def main() -> None:
    """Entry point of ``rbps``."""
    app(prog_name="rbps")
