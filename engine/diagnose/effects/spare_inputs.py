"""Inputs that a model takes and does not use: channels that were recorded beside those it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from engine.errors import SeriesError
from engine.statespace.evaluation import hands_rows_on
from engine.statespace.model import Array, MixedModel

UNIT = "1"  # of a channel about which nothing but its name is known


def with_inputs(model: MixedModel, names: Sequence[str]) -> MixedModel:
    """The same model with further inputs behind its own, which nothing depends on.

    Raises SeriesError for a name that the model uses for something else.
    """
    taken = {*model.nonlinear, *model.linear, *model.inputs, *model.outputs}
    for name in names:
        if name in taken:
            raise SeriesError(
                f"the extra channel '{name}' has the name of a channel of model '{model.name}'"
            )
        taken.add(name)
    if not names:
        return model
    own = model.nu

    # by what is known of the model's own functions: as written they may take one row a call, and no tape
    @hands_rows_on
    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        return model.transition(a, u[:own], t, dt, theta)

    @hands_rows_on
    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return model.observation(a, u[:own], t, theta)

    return replace(
        model,
        inputs={**model.inputs, **dict.fromkeys(names, UNIT)},
        dynamics=dynamics,
        measurement=measurement,
    )
