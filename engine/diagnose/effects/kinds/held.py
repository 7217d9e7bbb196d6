"""A parameter that the model has and that was held: its value may be the wrong one."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from engine.diagnose.effects.channels import Kind, at_parameters
from engine.diagnose.effects.effect import Effect, Split, on_base
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import MixedModel, Parameter


def _held(setting: Setting, channel: str, name: str) -> Effect:
    """``parameter -> parameter + size``, within the parameter's own bounds."""
    model = setting.model
    index = model.index(channel)
    parameter = model.parameters[index]
    value = parameter.default if setting.record is None else float(setting.record.theta[index])
    low, high = parameter.bounds
    further = setting.limits(low - value, high - value, -np.inf)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        last: tuple[Any, Any] = (None, None)

        def other(theta: Any) -> tuple[Any, Any]:
            nonlocal last
            known, parts = last
            if known is not theta:  # one record for all steps, by which the model knows it again
                base, own = split(theta)
                parts = base._replace(**{channel: base[index] + own[0]}), own
                last = theta, parts
            return cast(tuple[Any, Any], parts)

        return on_base(model, other)

    return Effect(
        "held",
        channel,
        "parameter",
        f"the parameter {channel}, held at {value:g} {parameter.unit}".rstrip(),
        f"{channel} -> {channel} + {name}",
        (Parameter(name, 0.0, parameter.unit, further, parameter.description),),
        extend,
        one_sided=setting.record is not None and value <= low,
        traits=Traits(plainness=0),
    )


KINDS: list[Kind] = [at_parameters("held", _held, lambda setting: setting.held)]
