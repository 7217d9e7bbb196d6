"""Options that several commands take, and what can be asked of all options."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.ending import wrong

MOST_PARTICLES = 100_000  # that the memory of a machine holds, over a long record
# of files that are written or read, so that a resumed run finds them from any folder
PATHS = ("out", "report", "plot", "shortest", "diagnosis", "bounds")


def model_names(incomplete: str) -> list[str]:
    """Registered models that begin so, for the shell's completion; it completes files by itself."""
    from engine.models.registry import model_names as registered

    return [name for name in registered() if name.startswith(incomplete)]


Data = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="DATA", exists=True, dir_okay=False,
        help="Data files: .csv with a line of column names, .mat or .npz. Several are several experiments.",
    ),
]  # fmt: skip
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
By = Annotated[
    list[str],
    typer.Option(
        "--by", metavar="COLUMN,...",
        help="Column that names the record of each row, such as a subject or a batch, where several stand in "
        "one file.",
    ),
]  # fmt: skip
TimeColumn = Annotated[
    str | None, typer.Option("--time", metavar="COLUMN", help="Column of times.  [t or time]")
]
Step = Annotated[
    float | None,
    typer.Option("--dt", metavar="STEP", help="Time step, where no column has the times.  [1]"),
]
TimeUnit = Annotated[
    str | None,
    typer.Option(
        "--time-unit", metavar="UNIT",
        help="What times count, such as min or year. Where the file says another unit they are converted, else "
        "it changes printed units and no number.  [as the file says, else s]",
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
        metavar="N",
        min=0,
        max=2**63 - 1,
        help="Seed of random numbers: the same seed gives the same result.",
    ),
]
Out = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="FILE.json", help="Write the result as JSON.")
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
State = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.state",
        help="Keep what is finished here.  [in .rbps/ beside --out, until all is done]",
    ),
]
Resume = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.state",
        help="Go on with an interrupted run, as if it had never stopped. Only options of output, and the "
        "--iterations of a fit, may be given with it.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]


def check_given(data: Sequence[Path] | None, model: str) -> None:
    """Refuse a command without data, or without a model."""
    if not data:
        raise wrong("DATA is missing: name one or more data files")
    there = [path.resolve() for path in data]
    if twice := [path for path, own in zip(data, there, strict=True) if there.count(own) > 1]:
        raise wrong(
            f"DATA {twice[0]}: the same file is named twice; one experiment is to count once"
        )
    model_named(model)


def model_named(reference: str) -> str:
    """The reference, or an error where there is none."""
    if not reference:
        raise wrong("--model is missing: 'rbps models' lists the models there are")
    return reference


def given(ctx: typer.Context, name: str) -> bool:
    """Whether an option was typed."""
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def full(path: str | Path) -> str:
    """A path as it is understood from any folder."""
    return str(Path(path).absolute())


def changes(ctx: typer.Context, also: Iterable[str]) -> dict[str, Any]:
    """What is given with ``--resume``; refuses all but options of output, and ``also``.

    Others would make the resumed run another one.
    """
    found = {}
    for parameter in ctx.command.params:
        name = parameter.name or ""
        if name in ("resume", "as_json", "quiet") or not given(ctx, name):
            continue
        if name not in {"out", "report", "plot", *also}:
            called = name.upper() if parameter.param_type_name == "argument" else parameter.opts[0]
            raise wrong(f"--resume continues what was asked; {called} cannot be given with it")
        found[name] = full(ctx.params[name]) if name in PATHS else ctx.params[name]
    return found
