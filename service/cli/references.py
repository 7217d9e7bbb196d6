"""Models as they are named on the command line: registered, from a file, with effects."""

from __future__ import annotations

from collections.abc import Sequence

from engine.data.joined import starts_of
from engine.data.series import Series
from engine.diagnose.effects.catalogue import extend
from engine.diagnose.effects.of_series import later_of
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


def with_effects(
    model: MixedModel, effects: Sequence[str], records: Sequence[Series]
) -> MixedModel:
    """The model with effects of the catalogue put in, made for the records' times."""
    with about("--with"):
        return extend(model, effects, setting_of(model, records) if records else None)


def setting_of(model: MixedModel, records: Sequence[Series]) -> Setting:
    """What effects need to know of the data that they are made for."""
    first = records[0]
    t, k = first.t, first.substeps
    return Setting(
        model,
        {},
        (float(min(one.t[0] for one in records)), float(max(one.t[-1] for one in records))),
        float(t[k] - t[0]),
        substeps=k,
        time_unit=first.time_unit,
        later=later_of(records),
        starts=starts_of(records),
    )
