"""How a drift bends: the rest of a course that is no straight line.

What wears, ages or fouls seldom does so evenly. Beside a drift that was found, which is straight, the rest of
a course that bends looks like a step of another parameter, a cycle, or a force that comes and goes. So what
drifts may bend as well, as an exponential of time does about the line between its ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_parameters, at_signals
from engine.diagnose.effects.effect import Effect, add_to_output, add_to_state
from engine.diagnose.effects.kinds.parameters import running_parameter, unit_of
from engine.diagnose.effects.kinds.time import over_the_record
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Course, Traits
from engine.statespace.model import MixedModel, Parameter

OF_PARAMETER, OF_SIGNAL = "parameter-bend", "bend"
STRAIGHT = {OF_PARAMETER: ("parameter-drift",), OF_SIGNAL: ("drift", "ramp")}
DRIFTS = frozenset(kind for kinds in STRAIGHT.values() for kind in kinds)
EVEN = 1e-3  # of a sharpness so small the bend is as good as a parabola
SHARPEST = 30.0  # within a thirtieth of the record nearly all is over
# Sharpness that is tried: a weak bend does not tell it, and what is no parabola is near one of the others.
PROBED = (0.0, 2.0, -2.0, 4.0, -4.0, 8.0, -8.0, 16.0, -16.0)

CourseOf = Callable[[Any, Sequence[Any]], Any]


def bend(s: Any, sharpness: Any) -> Any:
    """How far a course lies from the line between its ends, 1 in its middle; s from -1/2 to 1/2.

    The course is exp(-sharpness s): it changes most at the beginning where that is positive, else at the end.
    """
    even = np.abs(sharpness) < EVEN
    k = np.where(even, 1.0, sharpness)
    line = np.cosh(0.5 * k) - 2.0 * s * np.sinh(0.5 * k)
    sharp = (line - np.exp(-k * s)) / (2.0 * np.sinh(0.25 * k) ** 2)
    return np.where(even, (1.0 - 4.0 * s * s) * (1.0 - sharpness * s / 3.0), sharp)


def straight_of(kind: str, channel: str) -> set[str]:
    """The drifts, by kind and by name, beside which a bend is looked for; none of other kinds."""
    return {
        name for straight in STRAIGHT.get(kind, ()) for name in (straight, f"{straight}:{channel}")
    }


def _bend(
    setting: Setting,
    kind: str,
    channel: str,
    name: str,
    unit: str,
    adding: Callable[[CourseOf], Callable[[MixedModel], MixedModel]],
    at_rate: bool = False,
) -> Effect:
    """A bend that ``adding`` adds to a model."""
    of_parameter = kind == OF_PARAMETER
    sharp = Parameter(
        f"{name}_sharpness",
        PROBED[0],
        "1",
        (-SHARPEST, SHARPEST),
        "of exp(-sharpness s): above 0 it changes most at first, below 0 at last",
    )
    times, clock = over_the_record(name, setting), setting.anew

    def course(t: Any, own: Sequence[Any]) -> Any:
        return own[0] * bend((clock(t) - own[2]) / own[3], own[1])

    return Effect(
        kind,
        channel,
        "time",
        f"bend of the drift of {'the parameter ' if of_parameter else ''}{channel}",
        f"{channel} {'->' if of_parameter else '='} {channel if of_parameter else '...'} + "
        f"{'dt * ' if at_rate else ''}{name} * b(s), s = (t - {name}_middle) / {name}_per{setting.counted}, "
        f"b how far exp(-{name}_sharpness s) is from the line between its ends, 1 at s = 0",
        (
            Parameter(name, 0.0, unit, description="in the middle, off the straight line"),
            sharp,
            *times,
        ),
        adding(course),
        probes=tuple((k, *(p.default for p in times)) for k in PROBED),
        held=(sharp.name, *(p.name for p in times)),
        look_alikes={
            "parameter-step": "comes at once",
            "step": "comes at once",
            "harmonic": "comes again",
        },
        runs=(lambda t, u, own: course(t, own)) if of_parameter else None,
        traits=Traits(Course.BEND if of_parameter else None, of_parameter=of_parameter, bends=True),
    )


def _of_parameter(setting: Setting, channel: str, name: str) -> Effect:
    def adding(course: CourseOf) -> Callable[[MixedModel], MixedModel]:
        return running_parameter(
            setting, channel, lambda t, u, own: course(t, own), within_steps=True
        )

    return _bend(setting, OF_PARAMETER, channel, name, unit_of(setting, channel), adding)


def _of_signal(setting: Setting, channel: str, name: str) -> Effect:
    at_output = channel in setting.model.outputs
    unit = setting.unit(channel) if at_output else setting.rate(channel)
    add = add_to_output if at_output else add_to_state

    def adding(course: CourseOf) -> Callable[[MixedModel], MixedModel]:
        return lambda model: add(model, channel, lambda v, own: course(v.t, own))

    return _bend(setting, OF_SIGNAL, channel, name, unit, adding, at_rate=not at_output)


def _drifting(
    kind: str, channels: Callable[[Setting], Sequence[str]]
) -> Callable[[Setting], list[str]]:
    """Channels of which a drift was found, in the model as it was given or beyond it."""

    def drifting(setting: Setting) -> list[str]:
        there = {*setting.model.parameter_names, *setting.found}
        return [
            channel
            for channel in channels(setting)
            if any(setting.identifier(straight, channel) in there for straight in STRAIGHT[kind])
        ]

    return drifting


KINDS: list[Kind] = [
    at_parameters(
        OF_PARAMETER, _of_parameter, _drifting(OF_PARAMETER, lambda s: s.model.parameter_names)
    ),
    at_signals(
        OF_SIGNAL, _of_signal, _drifting(OF_SIGNAL, lambda s: [*s.model.outputs, *s.targets])
    ),
]
