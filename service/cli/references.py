"""Models as they are named on the command line: registered, from a file, with effects."""

from __future__ import annotations

from collections.abc import Sequence

from engine.data.series import Series
from engine.diagnose.effects.catalogue import extend
from engine.diagnose.effects.setting import Setting
from engine.errors import EngineError
from engine.models.files import in_file, model_from
from engine.models.registry import get_model, model_names
from engine.statespace.model import MixedModel
from service.cli.ending import wrong
from service.cli.values import about


def model_of(reference: str) -> MixedModel:
    """A registered model by name, or ``path/to/file.py:name`` from a file of the user's."""
    if in_file(reference) is not None:
        try:
            return model_from(reference)
        except EngineError as error:
            raise wrong(f"--model {error}") from None
    if reference not in model_names():
        there = ", ".join(model_names())
        raise wrong(
            f"--model {reference}: there is no such model. Registered are {there}; a model of your "
            "own is given as path/to/file.py:name"
        )
    return get_model(reference)


def absolute(reference: str) -> str:
    """The reference as it is understood from any folder."""
    file = in_file(reference)
    return reference if file is None else f"{file[0].absolute()}:{file[1]}".rstrip(":")


def with_effects(model: MixedModel, effects: Sequence[str], series: Series | None) -> MixedModel:
    """The model with effects of the catalogue put in, made for the series' times."""
    with about("--with"):
        return extend(model, effects, None if series is None else setting_of(model, series))


def setting_of(model: MixedModel, series: Series) -> Setting:
    """What effects need to know of the data that they are made for."""
    t, k = series.t, series.substeps
    span, clock = (float(t[0]), float(t[-1])), series.time_unit
    return Setting(model, {}, span, float(t[k] - t[0]), substeps=k, time_unit=clock)
