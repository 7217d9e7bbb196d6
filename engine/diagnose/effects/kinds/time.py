"""Effects of time: steps, ramps, pulses and harmonics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import (
    Channels,
    Kind,
    at_signals,
    each_signal,
    each_state,
)
from engine.diagnose.effects.effect import (
    Effect,
    add_to_output,
    add_to_state,
)
from engine.diagnose.effects.setting import ON_TIME, SOME_TIME, Setting
from engine.diagnose.effects.traits import USUAL, Course, Traits
from engine.statespace.model import MixedModel, Parameter
from engine.units import frequency_in, product


def _signal(
    kind: str,
    title: str,
    formula: str,
    signal: Callable[[Any, Sequence[Any], Sequence[float]], Any],
    shape: Callable[[str, Setting], list[Parameter]],
    look_alikes: dict[str, str],
    held: tuple[str, ...] = (),
    traits: Traits = USUAL,
    channels: Channels = each_signal,
    power: float = 0.0,
) -> Kind:
    """A kind ``size * signal(t)``, the signal of unit time^power, added to a state's equation or an output.

    The signal is a function of t, of the parameters after the size, and of when further records begin. What
    grows with time begins anew with each of them.
    """

    def make(setting: Setting, channel: str, name: str) -> Effect:
        at_output = channel in setting.model.outputs
        unit = setting.unit(channel) if at_output else setting.rate(channel)
        unit = product(unit, (setting.time_unit, -power)) if power else unit
        further = shape(name, setting)
        counted = setting.counted if power else lasting(further)

        def extend(model: MixedModel) -> MixedModel:
            add = add_to_output if at_output else add_to_state
            clock = setting.anew if power else lambda t: t

            def term(v: Any, own: Sequence[Any]) -> Any:
                return own[0] * signal(clock(v.t), own[1:], setting.later)

            return add(model, channel, term)

        return Effect(
            kind,
            channel,
            "time",
            f"{title} {'of the reading' if at_output else 'of the force on'} {channel}",
            f"{channel} = ... + {'' if at_output else 'dt * '}{name} * {formula}{counted}",
            (Parameter(name, 0.0, unit, description=title), *further),
            extend,
            probes=(tuple(p.default for p in further),),
            look_alikes=look_alikes,
            held=tuple(p.name for p in further if p.name.rpartition("_")[2] in held),
            traits=traits,
        )

    return at_signals(kind, make, channels)


def _when(name: str, setting: Setting) -> list[Parameter]:
    first, last = setting.span
    within = setting.limits(first, last, -np.inf)
    return [setting.time(f"{name}_time", 0.5 * (first + last), within, "when")]


def from_when(name: str, setting: Setting) -> list[Parameter]:
    """When it comes; of records that times tell apart, whether it stays in those after its own."""
    what = "1 where it stays in later records, 0 where it ends with its own"
    stays = Parameter(f"{name}_stays", 1.0, "1", (0.0, 1.0), what)
    return [*_when(name, setting), *([stays] if setting.later else [])]


def lasting(further: Sequence[Parameter]) -> str:
    """What an equation says of a step that may end with its record."""
    stays = any(p.name.endswith("_stays") for p in further)
    return ", to the end of that record where stays = 0" if stays else ""


def since(t: Any, own: Sequence[Any], later: Sequence[float]) -> Any:
    """1 from own[0] on: to the end, or where own[1] is 0, to that of the record which own[0] lies in."""
    since = t >= own[0]
    if not later:
        return 1.0 * since
    end = np.append(later, np.inf)[np.searchsorted(later, own[0], side="right")]
    return 1.0 * (since & ((own[1] > 0.5) | (t < end)))


def _harmonic(setting: Setting, channel: str, name: str) -> Effect:
    at_output = channel in setting.model.outputs
    unit = setting.unit(channel) if at_output else setting.rate(channel)
    lowest, highest = 0.5 / max(setting.length, setting.dt), 0.5 / setting.dt
    bounds, per_time = setting.limits(lowest, highest), frequency_in(setting.time_unit)
    usual = min(10.0 * lowest, bounds[1])
    # counted from afar, as years are, the phase would turn many times where the frequency moves by little
    middle = 0.5 * (setting.span[0] + setting.span[1])

    def term(v: Any, own: Sequence[Any]) -> Any:
        angle = 2.0 * np.pi * own[2] * (v.t - own[3])
        return own[0] * np.cos(angle) + own[1] * np.sin(angle)

    def extend(model: MixedModel) -> MixedModel:
        return (add_to_output if at_output else add_to_state)(model, channel, term)

    return Effect(
        "harmonic",
        channel,
        "time",
        f"harmonic {'in the reading' if at_output else 'force on'} {channel}",
        f"{channel} = ... + {'' if at_output else 'dt * '}({name} cos(2 pi f s) + {name}_sine sin(2 pi f s)), "
        f"s = t - {name}_origin",
        (
            Parameter(name, 0.0, unit, description="amplitude of the cosine"),
            Parameter(f"{name}_sine", 0.0, unit, description="amplitude of the sine"),
            Parameter(f"{name}_frequency", usual, per_time, bounds, "frequency"),
            setting.time(f"{name}_origin", middle, what="from when its phase counts"),
        ),
        extend,
        probes=((0.0, usual, middle),),
        held=(f"{name}_origin",),
        look_alikes={"pole": "decays, where a harmonic goes on"},
        traits=Traits(Course.HARMONIC, swallowed=True),
    )


def over_the_record(name: str, setting: Setting) -> list[Parameter]:
    """Where the middle of the longest record is, and how long it is: what a drift counts from, and per."""
    first, last = setting.run
    length = max(min(setting.length, last - first), setting.dt)
    return [
        setting.time(f"{name}_middle", 0.5 * (first + last), what="where it is zero"),
        setting.time(f"{name}_per", length, SOME_TIME, "to which the size refers"),
    ]


def _pulse(t: Any, own: Sequence[Any], later: Sequence[float]) -> Any:
    """1 from the sample at own[0] on for own[1] seconds; ends may be off by their rounding."""
    since = (t - own[0]) / own[1]
    return 1.0 * ((since > -ON_TIME) & (since < 1.0 - ON_TIME))


def _width(name: str, setting: Setting) -> list[Parameter]:
    width = setting.time(f"{name}_width", setting.dt, SOME_TIME, "how long")
    return [*_when(name, setting), width]


def during(t: Any, own: Sequence[Any], later: Sequence[float]) -> Any:
    """1 from the sample at own[0] on, to before the one at own[1]."""
    return 1.0 * ((t >= own[0]) & (t < own[1]))


def ends(name: str, setting: Setting) -> list[Parameter]:
    """When an episode begins, and when it is over."""
    first, last = setting.span
    within = setting.limits(first, last, -np.inf)
    begin, end = (first + share * (last - first) for share in (0.45, 0.55))
    return [
        setting.time(f"{name}_time", begin, within, "when it begins"),
        setting.time(f"{name}_end", end, within, "when it is over"),
    ]


def _start(name: str, setting: Setting) -> list[Parameter]:
    return [setting.time(f"{name}_start", setting.run[0], what="when it is zero")]


KINDS: list[Kind] = [
    _signal(
        "step",
        "step",
        "[t >= time]",
        since,
        from_when,
        {"ramp": "goes on growing", "pulse": "lasts one sample", "episode": "is over again"},
        held=("stays",),
        traits=Traits(Course.STEP, swallowed=True, plainness=1),
    ),
    _signal(
        "pulse",
        "pulse",
        "[time <= t < time + width]",
        _pulse,
        _width,
        {"step": "stays", "heavy-tails": "comes again"},
        held=("width",),
        traits=Traits(Course.PULSE),
    ),
    _signal(
        "episode",
        "episode",
        "[time <= t < end]",
        during,
        ends,
        {
            "step": "stays",
            "pulse": "lasts one sample",
            "parameter-episode": "alters how the model answers",
        },
        # one that is not over before the record is, or that lasts a sample
        traits=Traits(Course.EPISODE, contains=("step", "pulse")),
    ),
    _signal(
        "ramp",
        "ramp",
        "(t - start)",
        lambda t, own, later: t - own[0],
        _start,
        {"drift": "moves the reading only", "step": "comes at once"},
        held=("start",),
        traits=Traits(swallowed=True),
        channels=each_state,
        power=1.0,
    ),
    at_signals("harmonic", _harmonic),
]
