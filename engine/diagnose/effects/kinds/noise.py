"""Effects in the noise: its level, what it changes with, a share of the reading, rounding, correlation."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_outputs, at_signals, each_signal
from engine.diagnose.effects.effect import (
    Effect,
    Split,
    change_output,
    change_step,
    on_base,
    per_point,
)
from engine.diagnose.effects.kinds.measurement import observers
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import POSITIVE, Setting
from engine.diagnose.effects.traits import ANY, Traits
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import promote
from engine.units import product
from engine.words import with_unit

RELATIVE = "relative-noise"
VARIES = 1.5  # times as far from its zero is a reading at times as at others


def _scaled(S: Array, index: int, factor: Any, M: int) -> Array:
    """S with row and column ``index`` multiplied by a factor, a number or (M,)."""
    S = per_point(S, M, factor)
    S[..., index, :] *= np.reshape(factor, (-1, 1)) if np.ndim(factor) else factor
    S[..., :, index] *= np.reshape(factor, (-1, 1)) if np.ndim(factor) else factor
    return S


def _with_noise(
    model: MixedModel, channel: str, factor: Callable[[MixedModel, Array, Any, Any, Any], Any]
) -> MixedModel:
    """Standard deviation of e or w in ``channel`` times ``factor(model, a, u, t, own values)``."""
    at_output = channel in model.outputs
    names = list(model.outputs) if at_output else [*model.nonlinear, *model.linear]
    index = names.index(channel)

    def change(a: Array, u: Any, t: Any, f: Array, A: Array, S: Array, own: Any) -> Any:
        return f, A, _scaled(S, index, factor(model, a, u, t, own), len(a))

    return (change_output if at_output else change_step)(model, Split(model), change)


def _level(setting: Setting, channel: str, name: str) -> Effect:
    """The standard deviation of e or w is exp(size) times the model's."""
    what = "measurement" if channel in setting.model.outputs else "process"
    return Effect(
        "level",
        channel,
        "noise",
        f"wrong level of the {what} noise of {channel}",
        f"std of the noise of {channel} times exp({name})",
        (Parameter(name, 0.0, "1", (-5.0, 5.0), "log ratio of standard deviations"),),
        lambda model: _with_noise(model, channel, lambda m, a, u, t, own: np.exp(own[0])),
        look_alikes={
            "variance": "changes with a signal or with time",
            RELATIVE: "grows with the reading",
        },
        traits=Traits(noise_level=True),
    )


def _quantisation(setting: Setting, channel: str, name: str) -> Effect:
    """Readings rounded to steps of q: white noise of variance q^2 / 12 on top, where q is not large.

    By its effect on predictions it is a noise level and nothing else, so it is a candidate only where
    the readings themselves lie on a lattice. That shows its variance, which is bounded by twice as much.
    """
    unit, step = setting.unit(channel), setting.resolution.get(channel)
    most = np.inf if step is None else step**2 / 6.0
    what = "variance of the rounding error"

    def extend(model: MixedModel) -> MixedModel:
        row = list(model.outputs).index(channel)

        def change(a: Array, u: Any, t: Any, h: Array, C: Array, R: Array, own: Any) -> Any:
            R = per_point(R, len(a), own[0])
            R[..., row, row] += own[0]
            return h, C, R

        return change_output(model, Split(model), change)

    return Effect(
        "quantisation",
        channel,
        "measurement",
        f"rounding of the readings of {channel}"
        + ("" if step is None else f" to steps of {with_unit(step, unit)}"),
        f"variance of the noise of {channel} + {name},  step^2 / 12",
        (Parameter(name, 0.0, product((unit, 2.0)), (0.0, most), what),),
        extend,
        look_alikes={"level": "is not seen in the readings: they take any value"},
        traits=Traits(plainness=4),
        one_sided=True,
        readings=_rounded,
        shown=None if step is None else step**2 / 12.0,
    )


def _relative(setting: Setting, channel: str, name: str) -> Effect:
    """Noise that is a share of the reading, as data sheets say: 2 % of it. Or of a state, in a unit of time.

    The size is the square of that share, for the likelihood has no slope by the share where it is 0.
    """
    origin = Origin(setting, name, channel)
    if channel in setting.states:
        return _relative_in_time(setting, channel, name, origin)

    def extend(model: MixedModel) -> MixedModel:
        base = promote(model, observers(setting, model, channel))  # variances depend on these only
        row = list(base.outputs).index(channel)

        def change(a: Array, u: Any, t: Any, h: Array, C: Array, R: Array, own: Any) -> Any:
            added = own[0] * (h[:, row] - origin.of(own)) ** 2
            R = per_point(R, len(a), added)
            R[..., row, row] += added
            return h, C, R

        return change_output(base, Split(model), change)

    what = "square of the noise's share of the reading"
    return Effect(
        RELATIVE,
        channel,
        "noise",
        f"measurement noise of {channel} in proportion to its reading",
        f"variance of the noise of {channel} + {name} * {origin.text('y')}^2,  (share of the reading)^2",
        extend=extend,
        look_alikes={
            "level": "does not change with the reading",
            "variance": "grows e-fold with a signal, not in proportion",
            "heavy-tails": "comes at any reading",
        },
        traits=Traits(noise_level=True, plainness=ANY - 1, contains=("level",)),
        one_sided=True,
        **origin.counted(Parameter(name, 0.0, "1", (0.0, 1.0), what)),
    )


def _relative_in_time(setting: Setting, channel: str, name: str, origin: Origin) -> Effect:
    """Process noise that is a share of its state, as of a population, a river or a price."""

    def extend(model: MixedModel) -> MixedModel:
        base = promote(model, _linear(model, channel))  # variances depend on these only
        row, split = list(base.nonlinear).index(channel), Split(model)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            f, A, Q = base.transition(a, u, t, dt, own_base)
            zero, ends = origin.of(own), [a[:, row]]
            if base.continuous and not A[..., row, :].any():  # else its end is not known here
                ends.append(f[:, row])
            added = dt * own[0] * np.mean([(x - zero) ** 2 for x in ends], axis=0)
            Q = per_point(Q, len(a), added)
            Q[..., row, row] += added
            return f, A, Q

        return on_base(base, split, dynamics=dynamics)

    unit, what = setting.per_time, "square of the noise's share of the state, per unit of time"
    return Effect(
        RELATIVE,
        channel,
        "noise",
        f"process noise of {channel} in proportion to it",
        f"variance of the noise of {channel} + {name} * {origin.text(channel)}^2 in each {setting.time_unit}",
        extend=extend,
        look_alikes={
            "level": "does not change with the state",
            "variance": "grows e-fold with a signal, not in proportion",
            "heavy-tails": "comes at any state",
        },
        traits=Traits(noise_level=True, plainness=ANY - 1, contains=("level",)),
        one_sided=True,
        **origin.counted(Parameter(name, 0.0, unit, (0.0, np.inf), what)),
    )


def _varying(setting: Setting) -> list[str]:
    """Signals that have a zero and whose distance from it varies: a share of it is else a level."""

    def varies(signal: str) -> bool:
        usual, most = (setting.distance(signal, level) for level in (0.1, 0.9))
        return setting.may_be_off(signal) and most > VARIES * usual

    return [signal for signal in each_signal(setting) if varies(signal)]


def _rounded(y: Array, variance: float) -> Array:
    """Readings rounded to the steps whose rounding error has a variance."""
    step = np.sqrt(12.0 * variance)
    return step * np.round(y / step) if step > 0.0 else y


def _variance(setting: Setting, channel: str) -> Effect | None:
    """``noise->signal``: the noise grows with |signal| (a nonlinear state or input) or with time.

    That of an output may grow with a linear state that it reads: with the reading, as of many a sensor. That of
    a linear state may grow with the state itself, as of a population or a river.
    """
    target, _, signal = channel.partition("->")
    model = setting.model
    at_output = target in model.outputs
    if not (at_output or target in setting.states) or signal not in _signals(setting, target):
        return None
    name = setting.identifier("variance", target, signal)
    first, last = setting.run
    middle, timely = 0.5 * (first + last), signal == "time"
    scale = max(last - first, setting.dt) if timely else setting.size(signal)
    origin, clock = None if timely else Origin(setting, name, signal), setting.anew

    def factor(model: MixedModel, a: Array, u: Any, t: Any, own: Any) -> Any:
        if origin is None:
            x = clock(t) - own[2]
        elif signal in model.nonlinear:
            x = np.abs(a[:, list(model.nonlinear).index(signal)] - origin.of(own))
        else:
            x = np.abs(u[list(model.inputs).index(signal)] - origin.of(own))
        return np.exp(np.clip(0.5 * own[0] * x / own[1], -8.0, 8.0))

    unit = setting.time_unit if origin is None else setting.unit(signal)
    noise = "measurement" if at_output else "process"
    further = [
        Parameter(f"{name}_per", scale, unit, (POSITIVE, np.inf), "to which the size refers")
    ]
    if origin is None:
        what = f"(t - {name}_middle)"
        further.append(setting.time(f"{name}_middle", middle, what="where it is zero"))
    else:
        what = f"|{origin.text(signal)}|"
        further.extend(origin.parameters)
    return Effect(
        "variance",
        channel,
        "noise",
        f"{noise} noise of {target} that changes with {'time' if origin is None else what}",
        f"log variance of the noise of {target} + {name} * {what} / {name}_per"
        + (setting.counted if origin is None else ""),
        (Parameter(name, 0.0, "1", (-20.0, 20.0), "change of the log variance"), *further),
        lambda model: _with_noise(promote(model, _linear(model, signal)), target, factor),
        probes=(tuple(p.default for p in further),),
        look_alikes={
            "level": "does not change",
            "heavy-tails": "comes at random times",
            RELATIVE: "is a share of the reading, or state, beside a noise that is always there",
        },
        traits=Traits(noise_level=True, contains=("level",)),
        held=tuple(p.name for p in further),
        zero=None if origin is None else origin.name,
    )


def _signals(setting: Setting, target: str) -> list[str]:
    """What the noise of an output or a state may grow with."""
    model = setting.model
    read = observers(setting, model, target) if target in model.outputs else (target,)
    linear = [name for name in read if name in model.linear]
    return [*model.nonlinear, *linear, *model.inputs, "time"]


def _linear(model: MixedModel, signal: str) -> list[str]:
    """The signal, where it is a linear state: variances depend on nonlinear ones only."""
    return [signal] if signal in model.linear else []


def _each_variance(setting: Setting) -> list[str]:
    noises = each_signal(setting)
    return [f"{noise}->{signal}" for noise in noises for signal in _signals(setting, noise)]


def _correlation(setting: Setting, channel: str) -> Effect | None:
    """``i,j``: the process noises of two states are correlated (Q_az)."""
    one, _, other = channel.partition(",")
    states = list(setting.states)
    if one not in states or other not in states or one == other:
        return None
    name = setting.identifier("correlation", one, other)

    def extend(model: MixedModel) -> MixedModel:
        all_states = [*model.nonlinear, *model.linear]
        i, j = all_states.index(one), all_states.index(other)

        def change(a: Array, u: Any, t: Any, f: Array, A: Array, Q: Array, own: Any) -> Any:
            Q = per_point(Q, len(a), own[0])
            both = own[0] * np.sqrt(Q[..., i, i] * Q[..., j, j])
            Q[..., i, j] += both
            Q[..., j, i] += both
            return f, A, Q

        return change_step(model, Split(model), change)

    return Effect(
        "correlation",
        channel,
        "noise",
        f"correlated process noise of {one} and {other}",
        f"Q[{one},{other}] += {name} * std * std",
        (Parameter(name, 0.0, "1", (-0.95, 0.95), "correlation"),),
        extend,
        look_alikes={"coupling": "carries the state over, not its noise"},
    )


def _each_correlation(setting: Setting) -> list[str]:
    return [f"{one},{other}" for one, other in combinations(setting.targets, 2)]


KINDS: list[Kind] = [
    at_signals("level", _level),
    at_signals(RELATIVE, _relative, _varying),
    at_outputs("quantisation", _quantisation, lambda setting: setting.resolution),
    ("variance", _variance, _each_variance),
    ("correlation", _correlation, _each_correlation),
]
