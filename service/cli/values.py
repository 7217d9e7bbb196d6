"""What the options of names, numbers and paths stand for."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from engine.errors import EngineError
from engine.model import MixedModel, Theta
from engine.plots import axes
from service.cli.ending import wrong


def pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """``["a=1", "b=2"]`` as a dict."""
    out = {}
    for text in texts:
        name, equals, value = text.rpartition("=")
        if not (equals and name.strip() and value.strip()):
            raise wrong(f"{option} {text}: NAME=VALUE is needed")
        out[name.strip()] = value.strip()
    return out


def numbers(option: str, texts: Sequence[str]) -> dict[str, float]:
    """The same with numbers for values."""
    out = {}
    for name, value in pairs(option, texts).items():
        try:
            out[name] = float(value)
        except ValueError:
            raise wrong(f"{option} {name}={value}: '{value}' is not a number") from None
    return out


def names(texts: Sequence[str]) -> list[str]:
    """``["a,b", "c"]`` as a list of names."""
    return [name.strip() for text in texts for name in text.split(",") if name.strip()]


@contextmanager
def about(option: str) -> Iterator[None]:
    """Errors of the engine in here are the user's, about an option."""
    try:
        yield
    except EngineError as error:
        raise wrong(f"{option}: {error}") from None


def theta_of(model: MixedModel, values: dict[str, float], fixed: dict[str, float]) -> Theta:
    """Start values: the defaults, ``--set`` and ``--fix``."""
    with about("--set"):
        model.theta(values)
    with about("--fix"):
        return model.theta(values | fixed)


def free_of(model: MixedModel, free: list[str], fixed: Sequence[str]) -> list[str] | None:
    """Names of the parameters to estimate; None for all."""
    with about("--free"):
        model.free_indices(free)
    both = [name for name in free if name in fixed]
    if both:
        raise wrong(f"--free {both[0]}: it is also given with --fix; choose one")
    if not free and not fixed:
        return None
    left = [name for name in free or model.parameter_names if name not in fixed]
    if not left:
        raise wrong("--fix: no parameter is left to estimate")
    return left


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
        axes(1, 1, (1.0, 1.0))


def check_outputs(out: str | None, report: str | None, plot: str | None) -> None:
    """Refuse ``--out``, ``--report`` and ``--plot`` that cannot be written before any time is spent."""
    output_path("--out", Path(out) if out else None, (".json",))
    output_path("--report", Path(report) if report else None, (".html", ".htm"))
    figure_folder("--plot", Path(plot) if plot else None)


def one_of(option: str, value: str, choices: Sequence[str]) -> str:
    """The value if it is one of the choices."""
    if value not in choices:
        raise wrong(f"{option} {value}: choose one of {', '.join(choices)}")
    return value
