"""A parameter that the model has and that was held: its value may be the wrong one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from engine.diagnose.effects.effect import Effect, Split, identifier, on_base
from engine.diagnose.effects.setting import Kind, Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, MixedModel, Parameter


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

        def other(theta: Any) -> Any:
            base, own = split(theta)
            return base._replace(**{channel: base[index] + own[0]})

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            return model.transition(a, u, t, dt, other(theta))

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            return model.observation(a, u, t, other(theta))

        def initial(theta: Any) -> tuple[Any, Any, Any]:
            return model.initial(other(theta))

        return on_base(model, split, dynamics=dynamics, measurement=measurement, initial=initial)

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


def _each_held(setting: Setting) -> Iterator[str]:
    yield from setting.held


KINDS: list[Kind] = [("held", _held, _each_held)]
