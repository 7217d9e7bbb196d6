"""Results kept in files: estimates and diagnoses with their model, by its name or its file.

A file is one JSON document. Functions are not in it: a registered model is found again by its name, one of a
user's file by that file, which must be the same to the last byte, and one with outliers by the model that they
were added to. Numbers that the functions return are in it, and a model that returns others is refused. The text
of the file is kept too, and is run only where that is asked for; what it imports from beside it is not. A
diagnosis is kept as what was asked with the parts that it has finished, and goes through them again in seconds
when it is loaded.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose import Diagnosis, again
from engine.diagnose.extended import get_model
from engine.errors import EngineError, OptionError
from engine.estimation.em_result import EmResult
from engine.estimation.outcome import Outcome
from engine.estimation.uncertainty.observed_result import StandardErrors
from engine.filters.heavy_tails import with_mixture, with_student_t
from engine.json_values import plain
from engine.models.files import ModelFile, read_models
from engine.models.registry import model_names
from engine.simulation.fit import SimulationFit, with_runs
from engine.statespace.fingerprint import differences, fingerprint, parameters_in
from engine.statespace.model import MixedModel
from engine.units import Suffix
from engine.words import enumerated

FORMAT = 1
ARRAYS = ("trace", "log_likelihood", "ess", "seconds", "collapsed", "memory")  # of an EmResult
ERRORS = ("covariance", "score", "score_error", "relative_error")  # of StandardErrors
SAID = ("decrement", "settled", "warning", "note")
MAKERS = {one.__name__: one for one in (with_mixture, with_student_t)}
Kept = EmResult | StandardErrors | SimulationFit | Diagnosis


def save(found: Kept, path: str | Path) -> Path:
    """Write a result and how its model is found again.

    Parameters
    ----------
    found : EmResult, StandardErrors, SimulationFit or Diagnosis
        The result to keep, with the name, file or text of its model.
    path : str or Path
        The file to write.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    OptionError
        The result is of another kind.
    OSError
        The file cannot be written.
    """
    kind, content = _content(found)
    document = {
        "rbps": FORMAT,
        "version": version("rbps"),
        "kind": kind,
        "model": _reference(found.model),
        "result": content,
    }
    path = Path(path)
    path.write_text(json.dumps(document) + "\n", encoding="utf-8")
    return path


def load(path: str | Path, model: Any = None, run_source: bool = False) -> Kept:
    """Read a result that was written by ``save``.

    Parameters
    ----------
    path : str or Path
        The file that ``save`` wrote.
    model : MixedModel, optional
        The model, where it cannot be found by name or file, such as one that was written in a notebook. It must
        be the one of the result: its functions must return the same numbers.
    run_source : bool
        Whether to run the kept text of the model's file where that file no longer exists. The text can do
        anything that you can do, so allow it only for files of people whom you trust.

    Returns
    -------
    EmResult, StandardErrors, SimulationFit or Diagnosis
        The result as it was saved, with its model.

    Raises
    ------
    OptionError
        The file was not written by ``save``, or its model is not found or has changed.
    """
    path = Path(path)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        kind, reference, content = (document[key] for key in ("kind", "model", "result"))
    except FileNotFoundError:
        raise OptionError(f"{path}: there is no such file", "path") from None
    except (ValueError, KeyError, TypeError) as error:
        raise OptionError(
            f"{path}: this is not a result that save() wrote ({error}); the documents of 'rbps ... --out' are "
            "JSON to be read as such, or given to 'rbps compare'",
            "path",
        ) from None
    if document.get("rbps") != FORMAT:
        raise OptionError(
            f"{path}: it was saved by rbps {document.get('version')}, which has another format"
        )
    found = _model(path, reference, run_source) if model is None else model
    if [p.name for p in found.parameters] != reference["parameters"]:
        raise OptionError(
            f"{path}: the result has the parameters {', '.join(reference['parameters'])}; model "
            f"'{found.name}' has {', '.join(found.parameter_names)}",
            "model",
        )
    mark = reference.get("fingerprint")  # files of earlier versions have none
    if mark and (others := differences(found, mark)):
        raise OptionError(
            f"{path}: model '{found.name}' is not the one of this result, whose {enumerated(others)} "
            f"{'is' if len(others) == 1 else 'are'} different; load(path, model=...) takes the model as it was",
            "model",
        )
    if kind == "em":
        return _em(found, content)
    if kind == "errors":
        return _errors(found, content)
    series = [_series(one) for one in content["series"]]
    if kind == "simulation":
        return with_runs(found, series, content)
    parts = content["parts"] if document["version"] == version("rbps") else {}
    test = [_series(one) for one in content["test"]]
    return again(found, series, test, content["options"], parts)


# ---- contents -----------------------------------------------------------------------------------


def _content(found: Kept) -> tuple[str, dict[str, Any]]:
    if isinstance(found, EmResult):
        out: dict[str, Any] = {name: getattr(found, name).tolist() for name in ARRAYS}
        out |= {name: list(getattr(found, name)) for name in ("free", "not_estimated", "theta")}
        return "em", out | {"outcome": found.outcome.name, "message": found.message}
    if isinstance(found, StandardErrors):
        out = {name: getattr(found, name).tolist() for name in (*ERRORS, "theta")}
        out |= {name: getattr(found, name) for name in SAID}
        return "errors", out | {name: list(getattr(found, name)) for name in ("names", "tied")}
    if isinstance(found, SimulationFit):
        return "simulation", {
            "series": [_arrays(run.series) for run in found.runs],
            "theta": found.theta.tolist(),
            "a1": found.a1.tolist(),
            "z1": found.z1.tolist(),
            "covariance": found.covariance.tolist(),
            **{name: list(getattr(found, name)) for name in ("estimated", "silent", "tied")},
            **{n: getattr(found, n) for n in ("evaluations", "seconds", "success", "message")},
        }
    if isinstance(found, Diagnosis) and found.asked is not None:
        asked = found.asked
        return "diagnosis", {
            "series": [_arrays(one) for one in _several(asked.series)],
            "test": [_arrays(one) for one in _several(asked.test)],
            "options": dict(asked.options),
            "parts": dict(asked.parts),
        }
    raise OptionError(f"a {type(found).__name__} cannot be saved", "found")


def _em(model: Any, content: Mapping[str, Any]) -> EmResult:
    content = {"memory": [[]] * len(content["ess"]), **content}  # an earlier version has none
    arrays: dict[str, Any] = {name: np.array(content[name], dtype=float) for name in ARRAYS}
    arrays["trace"] = arrays["trace"].reshape(-1, len(model.parameters))
    return EmResult(
        model=model,
        theta=model.theta(content["theta"]),
        outcome=Outcome[content["outcome"]],
        message=content["message"],
        free=tuple(content["free"]),
        not_estimated=tuple(content["not_estimated"]),
        **arrays,
    )


def _errors(model: Any, content: Mapping[str, Any]) -> StandardErrors:
    names = tuple(content["names"])
    parts: dict[str, Any] = {one: content[one] for one in SAID}
    parts |= {one: np.array(content[one], dtype=float) for one in ERRORS}
    parts["covariance"] = parts["covariance"].reshape(len(names), len(names))
    return StandardErrors(
        model, model.theta(content["theta"]), names, tied=tuple(content["tied"]), **parts
    )


def _arrays(series: Series) -> dict[str, Any]:
    """A series as JSON values; a missing reading is None."""
    out = {name: getattr(series, name).tolist() for name in ("u", "t", "extra")}
    out["y"] = [[None if v != v else v for v in row] for row in series.y.tolist()]
    names = ("y_names", "u_names", "extra_names")
    out |= {name: list(getattr(series, name)) for name in names}
    return out | {
        "substeps": series.substeps,
        "hold": series.hold,
        "time_unit": series.time_unit,
        # a suffix may be no unit at all, and a file cannot tell it from one
        "units": {k: v for k, v in series.units.items() if not isinstance(v, Suffix)},
    }


def _several(series: Series | Sequence[Series] | None) -> list[Series]:
    return [series] if isinstance(series, Series) else list(series or ())


def _series(content: Mapping[str, Any]) -> Series:
    T = len(content["t"])
    tables = {
        name: np.array(content[name], dtype=float).reshape(T, -1) for name in ("y", "u", "extra")
    }
    return Series(**{**content, **tables})


# ---- models -------------------------------------------------------------------------------------


def _reference(model: Any) -> dict[str, Any]:
    """How the model is found again, if it is, and by what it is known to be the same."""
    mark = fingerprint(model)
    out = {"name": model.name, "parameters": list(model.parameter_names), "fingerprint": mark}
    return out | _found_by(model, mark) if isinstance(model, MixedModel) else out


def _found_by(model: MixedModel, mark: Mapping[str, Any]) -> dict[str, Any]:
    """By name with effects, by what it was made of, by file, or not at all."""
    name, *effects = model.name.split("+")
    if name in model_names():
        try:
            known = get_model(name, effects)
        except EngineError:
            known = None
        if known is not None and _gives(known, mark):
            return {"registered": {"name": name, "effects": effects}}
    if made := getattr(model.dynamics, "made", None):
        maker, (base, *given) = made
        if _gives(maker(base, *given), mark):
            return {"made": {"by": maker.__name__, "of": _reference(base), "given": plain(given)}}
    if (own := _file_of(model, mark)) is not None:
        file, variable = own
        text = file.path.read_text(encoding="utf-8")
        return {
            "file": {
                "path": str(file.path),
                "variable": variable,
                "sha256": file.digest,
                "source": text,
            }
        }
    return {}


def _gives(known: MixedModel, mark: Mapping[str, Any]) -> bool:
    """Whether a model is that of the fingerprint, but for defaults, bounds and the like, which are kept."""
    return not differences(_with_parameters(known, mark), mark)


def _with_parameters(model: MixedModel, mark: Mapping[str, Any]) -> MixedModel:
    """The model with defaults, bounds and the like as they were, if its parameters have the same names."""
    kept = parameters_in(mark)
    same = model.parameter_names == tuple(p.name for p in kept)
    return model.with_parameters(kept) if same and kept != model.parameters else model


def _file_of(model: MixedModel, mark: Mapping[str, Any]) -> tuple[ModelFile, str] | None:
    """The file that a model comes from and its name there, if importing the file gives it again."""
    function = getattr(model.dynamics, "drift", model.dynamics)
    name = getattr(getattr(function, "__code__", None), "co_filename", "")
    path = Path(name)
    if path.suffix != ".py" or not path.is_file():
        return None
    modules = [one for one in list(sys.modules.values()) if _is_of(one, path)]
    variables = [key for one in modules for key, value in vars(one).items() if value is model]
    try:
        file = read_models(path)
    except EngineError:
        return None
    found = file.models
    for key in variables or [key for key, one in found.items() if one.name == model.name]:
        if key in found and _gives(found[key], mark):
            return file, key
    return None


def _is_of(module: ModuleType | None, path: Path) -> bool:
    file = getattr(module, "__file__", None)
    return bool(file) and Path(str(file)).absolute() == path.absolute()


def _model(path: Path, reference: Mapping[str, Any], run_source: bool) -> MixedModel:
    """The model of a saved result. Raises OptionError that says what to do where it is not found."""
    found, mark = _found(path, reference, run_source), reference.get("fingerprint")
    return _with_parameters(found, mark) if mark else found


def _found(path: Path, reference: Mapping[str, Any], run_source: bool) -> MixedModel:
    """The model by name, by what it was made of, or by file."""
    name = reference["name"]
    if registered := reference.get("registered"):
        return get_model(registered["name"], registered["effects"])
    if made := reference.get("made"):
        return MAKERS[made["by"]](_model(path, made["of"], run_source), *made["given"])
    own = reference.get("file")
    if own is None:
        unlike, mark = "", reference.get("fingerprint")
        if mark and name in model_names():
            known = _with_parameters(get_model(name), mark)
            if not (others := differences(known, mark)):
                return known
            unlike = f" (the registered one differs in {enumerated(others)})"
        raise OptionError(
            f"{path}: model '{name}' is neither registered nor from a file that gives it again{unlike}; "
            "load(path, model=...) takes it",
            "model",
        )
    file = Path(own["path"])
    if file.is_file():
        found = read_models(file)
        if found.digest == own["sha256"]:
            return found.model(own["variable"])
        raise OptionError(
            f"{path}: {file} is not what it was when this was saved; load(path, model=...) takes a model "
            "that you know to be the same",
            "model",
        )
    if not run_source:
        raise OptionError(
            f"{path}: {file}, where model '{name}' comes from, has gone; load(path, model=...) takes it from "
            "elsewhere, load(path, run_source=True) runs the text of the file that was kept",
            "model",
        )
    module = ModuleType(file.stem)
    exec(compile(own["source"], str(file), "exec"), vars(module))
    return ModelFile(file, module, (), ()).model(own["variable"])
