"""A parameter that the model has and that was held: its value may be the wrong one."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.diagnose.effects.effect import Effect, Split, identifier, on_base
from engine.diagnose.effects.setting import Kind, Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import MixedModel, Parameter


def _held(setting: Setting, channel: str) -> Effect | None:
    """``parameter -> parameter + size``, within the parameter's own bounds."""
    model = setting.model
    if channel not in model.parameter_names:
        return None
    index = model.index(channel)
    parameter = model.parameters[index]
    value = parameter.default if setting.record is None else float(setting.record.theta[index])
    name = identifier("held", channel)
    low, high = parameter.bounds

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)

        def other(theta: Any) -> tuple[Any, Any]:
            base, own = split(theta)
            return base._replace(**{channel: base[index] + own[0]}), own

        return on_base(model, other)

    return Effect(
        "held",
        channel,
        "parameter",
        f"the parameter {channel}, held at {value:g} {parameter.unit}".rstrip(),
        f"{channel} -> {channel} + {name}",
        (
            Parameter(
                name,
                0.0,
                parameter.unit,
                setting.limits(low - value, high - value, -np.inf),
                parameter.description,
            ),
        ),
        extend,
        one_sided=setting.record is not None and value <= low,
        traits=Traits(plainness=0),
    )


KINDS: list[Kind] = [("held", _held, lambda setting: setting.held)]
