"""Parameters that change at a time, or with time; and what any that changes is made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.channels import Kind, at_parameters
from engine.diagnose.effects.differences import value_of
from engine.diagnose.effects.effect import Effect, Split, on_base
from engine.diagnose.effects.kinds.time import (
    during,
    ends,
    from_when,
    lasting,
    over_the_record,
    since,
)
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Course, Traits
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Array, MixedModel, Parameter, Theta

ONTO = "->"
SOUGHT = {Course.STEP: 1, Course.EPISODE: 2, Course.DRIFT: 0}  # times that are estimated
_USUAL = {"cubic": "depends on the state", "step": "changes once, whatever the state"}
LOOK_ALIKES = {
    Course.STEP: _USUAL | {"parameter-episode": "is over again"},
    Course.EPISODE: {"episode": "is the same whatever the state", "parameter-step": "stays"},
    Course.DRIFT: _USUAL,
}

# (t, u, the effect's own values) -> what is added to the parameter
CourseOf = Callable[[Any, Any, Sequence[Any]], Any]


def running_parameter(
    setting: Setting, channel: str, course: CourseOf, within_steps: bool
) -> Callable[[MixedModel], MixedModel]:
    """What adds ``course`` to a parameter of a model, within the parameter's bounds.

    Where it runs ``within_steps``, differential equations have its mean over the step: that of its middle.
    """
    index = setting.model.parameter_names.index(channel)
    bounds = setting.model.parameters[index].bounds

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)

        def at(t: Any, u: Any, theta: Any) -> Any:
            base, own = split(theta)
            value = np.clip(base[index] + course(t, u, own), *bounds)
            return base._replace(**{channel: value})

        later = 0.5 if model.continuous and within_steps else 0.0

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            return model.transition(a, u, t, dt, at(t + later * dt if later else t, u, theta))

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            return model.observation(a, u, t, at(t, u, theta))

        return on_base(model, split, dynamics=dynamics, measurement=measurement)

    return extend


def stopped_share(effect: Effect, model: MixedModel, theta: Theta, series: Series) -> float:
    """The share of rows in which a bound stops the parameter of the ``model`` that an effect changes.

    Without that bound nothing else may be needed; with it, other effects may make up for what it forbids.
    """
    if effect.runs is None:
        return 0.0
    source, _, name = effect.channel.rpartition(ONTO)
    low, high = model.parameters[model.index(name)].bounds
    own = [theta[p.name] for p in effect.parameters]
    signals = series.u.T
    if effect.family == "state":  # as the filter sees it
        states = moment_path(model, np.asarray(theta), series).filtered.T
        channels = [*model.nonlinear, *model.linear, *model.inputs]
        signals = value_of(source, dict(zip(channels, [*states, *series.u.T], strict=True)))
    value = theta[name] + np.broadcast_to(effect.runs(series.t, signals, own), len(series))
    return float(np.mean((value < low) | (value > high)))


def unit_of(setting: Setting, channel: str) -> str:
    """Unit of a parameter."""
    return setting.model.parameters[setting.model.parameter_names.index(channel)].unit


def _change(when: Course, further_of: Callable[[str, Setting], list[Parameter]]) -> Kind:
    """A parameter that steps at a time, is another one for a while, or drifts linearly through the record."""
    title, drifts = when.value, when is Course.DRIFT
    kind = f"parameter-{title}"

    def make(setting: Setting, channel: str, name: str) -> Effect:
        further, clock = further_of(name, setting), setting.anew
        formulas = {
            Course.STEP: f"[t >= {name}_time]{lasting(further)}",
            Course.EPISODE: f"[{name}_time <= t < {name}_end]",
            Course.DRIFT: f"(t - {name}_middle) / {name}_per{setting.counted}",
        }

        def course(t: Any, u: Any, own: Sequence[Any]) -> Any:
            if drifts:
                return own[0] * ((clock(t) - own[1]) / own[2])
            return own[0] * (since if when is Course.STEP else during)(t, own[1:], setting.later)

        return Effect(
            kind,
            channel,
            "time",
            f"{title} of the parameter {channel}",
            f"{channel} -> {channel} + {name} * {formulas[when]}",
            (Parameter(name, 0.0, unit_of(setting, channel), description=title), *further),
            running_parameter(setting, channel, course, within_steps=drifts),
            probes=(tuple(p.default for p in further),),
            held=tuple(p.name for p in further[SOUGHT[when] :]),
            look_alikes=LOOK_ALIKES[when],
            runs=course,
            traits=Traits(
                when,
                of_parameter=True,
                swallowed=when is Course.STEP,
                # one that is not over before the record is
                contains=("parameter-step",) if when is Course.EPISODE else (),
            ),
        )

    return at_parameters(kind, make, lambda setting: setting.model.parameter_names)


KINDS: list[Kind] = [
    _change(Course.STEP, from_when),
    _change(Course.EPISODE, ends),
    _change(Course.DRIFT, over_the_record),
]
