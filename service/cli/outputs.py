"""The files that commands write: refused before any time is spent, written when all is done."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from engine.presentation import plots
from engine.presentation.report import write_report
from service import strict_json
from service.cli.ending import about_file, wrong
from service.cli.experiment import Experiment
from service.cli.state_file import Run, StateFile, beside
from service.cli.values import about


class Kept(Protocol):
    """The state of a run, which can be written and gone on with."""

    file: StateFile

    def save(self) -> None:
        """Write the state."""


def check_outputs(wanted: Run, suffix: str = ".json") -> None:
    """Refuse ``--out``, ``--report`` and ``--plot`` that cannot be written before any time is spent."""
    output_path("--out", Path(wanted.out) if wanted.out else None, (suffix,))
    output_path("--report", Path(wanted.report) if wanted.report else None, (".html", ".htm"))
    figure_folder("--plot", Path(wanted.plot) if wanted.plot else None)


def state_path(wanted: Run, state: Path | None, name: str) -> Path:
    """Where the state of a new run goes: ``state``, else a file of that name beside the output."""
    wanted.keep = state is not None
    path = state or beside(wanted.out, name)
    # its own folder need not be there yet
    output_path("--state", state or path.parent.parent / path.name)
    return path


def write_outputs(wanted: Experiment, document: dict[str, Any], state: Kept) -> list[str]:
    """Write what was asked for; the paths. Where that fails, ``state`` writes it without computing anew."""
    about_run = {"name": wanted.name, "tags": ", ".join(wanted.tags)}
    about_run["data"] = ", ".join(Path(name).name for name in wanted.data)
    written = []
    with kept_if_not_written(state):
        if wanted.out:
            text = strict_json.dumps(wanted.labelled(document))
            Path(wanted.out).write_text(text + "\n", encoding="utf-8")
            written.append(wanted.out)
        plain = json.loads(strict_json.dumps(document))
        written += write_shown(wanted, plain, about_run)
    return written


@contextmanager
def kept_if_not_written(state: Kept) -> Iterator[None]:
    """Save the state where a file cannot be written within, and say how to go on."""
    try:
        yield
    except OSError as error:
        state.save()
        raise wrong(
            f"{about_file(error)}. What was found is kept; once that is corrected:\n  {state.file.again}"
        ) from None


def write_shown(
    wanted: Run, document: dict[str, Any], about_run: Mapping[str, object]
) -> list[str]:
    """Write the report and the figures that were asked for; the paths."""
    written = []
    if wanted.report:
        about_run = {**about_run, "seed": wanted.seed}
        written.append(str(write_report(document, wanted.report, about_run)))
    if wanted.plot:
        plots.of_document(document).save(wanted.plot)
        written.append(wanted.plot)
    return written


def say_written(written: Sequence[str]) -> None:
    """A line for each file."""
    for name in written:
        print(f"Written: {os.path.relpath(name)}")


def output_path(option: str, path: Path | None, suffixes: Sequence[str] = ()) -> None:
    """Refuse a file that cannot be written before hours are spent on its content."""
    if path is None:
        return
    shown = os.path.relpath(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise wrong(f"{option} {shown}: the ending must be {' or '.join(suffixes)}")
    if not path.absolute().parent.is_dir():
        raise wrong(f"{option} {shown}: there is no folder {path.absolute().parent}")
    if path.is_dir():
        raise wrong(f"{option} {shown}: this is a folder; a file is needed")
    if not os.access(path.absolute().parent, os.W_OK):
        raise wrong(f"{option} {shown}: nothing can be written into {path.absolute().parent}")


def figure_folder(option: str, path: Path | None) -> None:
    """Refuse a folder for figures that cannot be, or figures without matplotlib."""
    if path is None:
        return
    if path.exists() and not path.is_dir():
        raise wrong(f"{option} {os.path.relpath(path)}: this is a file; a folder is needed")
    with about(option):
        plots.axes(1, 1, (1.0, 1.0))
