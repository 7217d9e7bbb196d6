"""Options that several commands take, and what can be asked of all options."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from service.cli.ending import wrong

KINDS = ".csv with a line of column names, .mat or .npz."
DATA = f"Data files: {KINDS} Several are several experiments."
MAY_CHANGE = frozenset({"out", "report", "plot", "resume", "as_json", "quiet"})


def model_names(incomplete: str) -> list[str]:
    """Registered models that begin so, for the shell's completion; it completes files by itself."""
    from engine.models.registry import model_names as registered

    return [name for name in registered() if name.startswith(incomplete)]


Model = Annotated[
    str,
    typer.Option(
        "--model", "-m", metavar="MODEL", autocompletion=model_names,
        help="A registered model (see 'rbps models'), or path/to/file.py:name for your own.",
    ),
]  # fmt: skip
Effects = Annotated[
    list[str],
    typer.Option("--with", metavar="EFFECT", help="Add an effect, such as coulomb:velocity."),
]
Values = Annotated[
    list[str], typer.Option("--set", metavar="NAME=VALUE", help="Start value of a parameter.")
]
Fixed = Annotated[
    list[str], typer.Option("--fix", metavar="NAME=VALUE", help="Hold a parameter at a value.")
]
Free = Annotated[
    list[str],
    typer.Option("--free", metavar="NAME,...", help="Estimate these parameters only.  [all]"),
]
Columns = Annotated[
    list[str],
    typer.Option(
        "--map", metavar="CHANNEL=COLUMN",
        help="Column of an output or input.  [the column of the channel's name]",
    ),
]  # fmt: skip
TimeColumn = Annotated[
    str | None,
    typer.Option("--time", metavar="COLUMN", help="Column of times.  [t or time]"),
]
Step = Annotated[
    float | None,
    typer.Option("--dt", metavar="STEP", help="Time step, where no column has the times.  [1]"),
]
TimeUnit = Annotated[
    str | None,
    typer.Option(
        "--time-unit", metavar="UNIT",
        help="What times count, such as min or year: changes printed units and no number.  [as the file "
        "says, else s]",
    ),
]  # fmt: skip
Hold = Annotated[
    str | None,
    typer.Option(
        "--hold", metavar="zoh|foh|past",
        help="Inputs between samples: held (zoh), on a straight line (foh), or held since the row before "
        "(past).  [zoh]",
    ),
]  # fmt: skip
Seed = Annotated[
    int,
    typer.Option(
        metavar="N", min=0, help="Seed of random numbers: the same seed gives the same result."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="FILE.json", help="Write the result as JSON."),
]
Report = Annotated[
    Path | None,
    typer.Option(metavar="FILE.html", help="Write a report, one file that opens anywhere."),
]
Plot = Annotated[
    Path | None,
    typer.Option(metavar="FOLDER", help="Write figures as SVG and PNG (needs rbps[plot])."),
]
Name = Annotated[
    str, typer.Option(metavar="TEXT", help="A name for it, kept in the result and the report.")
]
Tags = Annotated[
    list[str],
    typer.Option("--tag", metavar="WORD,...", help="Words to find it by, kept in the result."),
]
Test = Annotated[
    list[Path],
    typer.Option(
        metavar="FILE", exists=True, dir_okay=False,
        help="Held-out data to measure the error on; repeatable.",
    ),
]  # fmt: skip
Json = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]


def model_named(reference: str) -> str:
    """The reference, or an error where there is none."""
    if not reference:
        raise wrong("--model is missing: 'rbps models' lists the models there are")
    return reference


def given(ctx: typer.Context, name: str) -> bool:
    """Whether an option was typed."""
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def absolute_paths(**paths: Path | None) -> dict[str, str]:
    """Those that are given, as they are understood from any folder."""
    return {key: str(path.absolute()) for key, path in paths.items() if path is not None}


def only_output(ctx: typer.Context, also: Iterable[str]) -> None:
    """Refuse what would make a resumed run another one; options of output and ``also`` would not."""
    for parameter in ctx.command.params:
        name = parameter.name or ""
        if name not in MAY_CHANGE.union(also) and given(ctx, name):
            called = name.upper() if parameter.param_type_name == "argument" else parameter.opts[0]
            raise wrong(f"--resume continues what was asked; {called} cannot be given with it")
