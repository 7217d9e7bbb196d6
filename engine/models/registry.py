"""Registered models by name: those of ``engine.models`` and those of users' packages.

A package offers models through the entry-point group ``engine.models``; an entry point is a
MixedModel, or a function that returns one or several. A broken one is reported by
``plugin_errors()`` and stops nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.metadata import entry_points
from threading import RLock

from engine.errors import ModelError, OptionError
from engine.statespace.checks import check_model
from engine.statespace.model import MixedModel

GROUP = "engine.models"

_models: dict[str, MixedModel] = {}
_plugin_errors: dict[str, str] = {}
_lock = RLock()
_loaded = False


def register(model: MixedModel, replace: bool = False) -> MixedModel:
    """Check a model and make it known by its name.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    replace : bool
        Whether a model of that name may be replaced.

    Returns
    -------
    MixedModel
        The same model.

    Raises
    ------
    ModelError
        The model's functions, shapes or covariances cannot be used.
    """
    with _lock:
        _load()
        return _register(model, replace)


def get_model(name: str) -> MixedModel:
    """The registered model of that name. Raises OptionError naming those there are."""
    with _lock:
        _load()
        if name not in _models:
            raise OptionError(
                f"no model is registered as '{name}'; there are {', '.join(sorted(_models))}",
                "model",
            )
        return _models[name]


def model_names() -> list[str]:
    """The names of all registered models, sorted.

    Returns
    -------
    list of str
        What :func:`get_model` takes.
    """
    with _lock:
        _load()
        return sorted(_models)


def plugin_errors() -> dict[str, str]:
    """Entry points that could not be used.

    Returns
    -------
    dict
        {name: reason}.
    """
    with _lock:
        _load()
        return dict(_plugin_errors)


def _register(model: MixedModel, replace: bool) -> MixedModel:
    if model.name in _models and not replace:
        raise ModelError(
            f"a model named '{model.name}' is already registered; choose another name or "
            "pass replace=True"
        )
    check_model(model)
    _models[model.name] = model
    return model


def _load() -> None:
    """Register the shipped models once, then those of installed packages."""
    global _loaded
    if _loaded:
        return
    _loaded = True
    from engine.models import SHIPPED

    for model in SHIPPED:
        _register(model, replace=True)
    for point in entry_points(group=GROUP):
        try:
            offered = point.load()
            if callable(offered) and not isinstance(offered, MixedModel):
                offered = offered()
            for model in _several(offered):
                _register(model, replace=False)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's package may do anything
            _plugin_errors[point.name] = f"{type(error).__name__}: {error}"


def _several(offered: MixedModel | Iterable[MixedModel]) -> Sequence[MixedModel]:
    return [offered] if isinstance(offered, MixedModel) else list(offered)
