"""Extended models: by the name of a registered model, and how that of a diagnosis is got again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from engine.diagnose.effects.catalogue import extend
from engine.estimation.quasi_ml import QuasiFit
from engine.models import registry
from engine.statespace.model import MixedModel

if TYPE_CHECKING:
    from engine.diagnose.diagnosis import Diagnosis


def get_model(name: str, effects: Sequence[str] | None = None) -> MixedModel:
    """Return the registered model of a name, with effects added where asked for.

    Parameters
    ----------
    name : str
        One of :func:`model_names`.
    effects : sequence of str, optional
        Effects to add, such as ``["coulomb:velocity"]``; what a diagnosis found is an ordinary model.

    Returns
    -------
    MixedModel
        The registered model, or a new one with the effects in it.

    Raises
    ------
    OptionError
        There is no such model, effect or channel; names those there are.
    """
    return extend(registry.get_model(name), effects or ())


def at_bounds(fit: QuasiFit) -> list[str]:
    """Free parameters that a bound has stopped: their standard errors say nothing."""
    return list(fit.model.at_bounds(fit.theta, fit.free))


def in_the_library(d: Diagnosis) -> str:
    """How the extended model is got again: by its name if it is registered, else from the model itself."""
    effects = [cause.effect for cause in d.causes]
    steps = f" Run it on series.refined({d.substeps})." if d.substeps > 1 else ""
    if is_registered(d):
        return f"In the library: engine.get_model({d.model.name!r}, effects={effects!r}).{steps}"
    return (
        "In the library: .extended and .theta of this diagnosis, or extend(model, "
        f"{effects!r}) from engine.diagnose.{steps}"
    )


def is_registered(d: Diagnosis) -> bool:
    """Whether the library knows the diagnosed model by its name, wherever it is asked: not from a file here."""
    name = d.model.name
    known = name in registry.model_names() and registry.source_of(name) is None
    return known and registry.get_model(name).dynamics is d.model.dynamics
