"""Models as they are named on the command line: registered, from a file, with effects."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from engine.data.series import Series
from engine.diagnose.effects.catalogue import extend
from engine.diagnose.effects.setting import Setting
from engine.models.registry import get_model, model_names
from engine.statespace.checks import check_model
from engine.statespace.model import MixedModel
from service.cli.ending import wrong
from service.cli.values import about


def model_of(reference: str, option: str = "--model") -> MixedModel:
    """A registered model by name, or ``path/to/file.py:name`` from a file of the user's."""
    file = in_file(reference)
    if file is not None:
        return _from_file(*file)
    if reference not in model_names():
        there = ", ".join(model_names())
        raise wrong(
            f"--model {reference}: there is no such model. Registered are {there}; a model of your "
            "own is given as path/to/file.py:name"
        )
    return get_model(reference)


def in_file(reference: str) -> tuple[Path, str] | None:
    """File and name of a model that comes from a file; the name may be empty."""
    path, colon, name = reference.rpartition(":")
    path, name = (path, name) if colon else (reference, "")
    return (Path(path), name) if path.endswith(".py") else None


def absolute(reference: str) -> str:
    """The reference as it is understood from any folder."""
    file = in_file(reference)
    return reference if file is None else f"{file[0].absolute()}:{file[1]}".rstrip(":")


def _from_file(path: Path, name: str) -> MixedModel:
    where = f"--model {path}{':' if name else ''}{name}"
    if not path.is_file():
        raise wrong(f"{where}: there is no such file")
    module = _imported(path, where)
    models = {key: value for key, value in vars(module).items() if isinstance(value, MixedModel)}
    there = f"its models are {', '.join(models)}" if models else "it holds no MixedModel"
    if not name and len(models) != 1:
        raise wrong(f"{where}: name one, as in {path}:NAME; {there}")
    found: Any = getattr(module, name, None) if name else next(iter(models.values()))
    if found is None:
        raise wrong(f"{where}: the file has no '{name}'; {there}")
    if not isinstance(found, MixedModel):
        raise wrong(f"{where}: '{name}' is a {type(found).__name__}; a MixedModel is needed")
    with about(where):
        check_model(found)
    return found


def _imported(path: Path, where: str) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path.absolute())
    if spec is None or spec.loader is None:
        raise wrong(f"{where}: Python cannot import this file")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.absolute().parent))  # the file may import its neighbours
    sys.modules.setdefault(path.stem, module)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # noqa: BLE001 - a user's file may raise anything
        line = _line_in(error, path)
        raise wrong(f"{where}: {type(error).__name__}: {error}{line}") from None
    return module


def _line_in(error: BaseException, path: Path) -> str:
    trace, line = error.__traceback__, None
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path.absolute():
            line = trace.tb_lineno
        trace = trace.tb_next
    return "" if line is None else f" (line {line})"


def with_effects(model: MixedModel, effects: Sequence[str], series: Series | None) -> MixedModel:
    """The model with effects of the catalogue put in, made for the series' times."""
    setting = None
    if series is not None:
        span = (float(series.t[0]), float(series.t[-1]))
        setting = Setting(model, {}, span, float(series.steps[0]))
    with about("--with"):
        return extend(model, effects, setting)
