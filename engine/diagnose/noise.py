"""Effects in the noise: its level, colour, correlation, and forces nobody named."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effect import Effect, Split, identifier, on_base, per_point
from engine.diagnose.more_states import Begin, add_linear_states, beside
from engine.diagnose.origin import Origin
from engine.diagnose.setting import POSITIVE, Kind, Setting, each_output, each_state
from engine.diagnose.units import product
from engine.model import Array, MixedModel, Parameter
from engine.words import with_unit

OSCILLATING = "oscillating"  # the second manner of an unnamed force


def _scaled(S: Array, index: int, factor: Any, M: int) -> Array:
    """S with row and column ``index`` multiplied by a factor, a number or (M,)."""
    S = per_point(S, M, factor)
    S[..., index, :] *= np.reshape(factor, (-1, 1)) if np.ndim(factor) else factor
    S[..., :, index] *= np.reshape(factor, (-1, 1)) if np.ndim(factor) else factor
    return S


def _level(setting: Setting, channel: str) -> Effect | None:
    """The standard deviation of e or w is exp(size) times the model's."""
    model = setting.model
    at_output = channel in model.outputs
    if not at_output and channel not in setting.states:
        return None
    name = identifier("level", channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            f, A, Q = model.transition(a, u, t, dt, own_base)
            index = [*model.nonlinear, *model.linear].index(channel)
            return f, A, _scaled(Q, index, np.exp(own[0]), len(a))

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            h, C, R = model.observation(a, u, t, own_base)
            return h, C, _scaled(R, list(model.outputs).index(channel), np.exp(own[0]), len(a))

        if at_output:
            return on_base(model, split, measurement=measurement)
        return on_base(model, split, dynamics=dynamics)

    return Effect(
        "level",
        channel,
        "noise",
        f"wrong level of the {'measurement' if at_output else 'process'} noise of {channel}",
        f"std of the noise of {channel} times exp({name})",
        (Parameter(name, 0.0, "1", (-5.0, 5.0), "log ratio of standard deviations"),),
        extend,
        look_alikes={"variance": "changes with a signal or with time"},
    )


def _quantisation(setting: Setting, channel: str) -> Effect | None:
    """Readings rounded to steps of q: white noise of variance q^2 / 12 on top, where q is not large.

    By its effect on predictions it is a noise level and nothing else, so it is a candidate only where
    the readings themselves lie on a lattice, and its variance is bounded by twice what that explains.
    """
    model = setting.model
    if channel not in model.outputs:
        return None
    name, unit = identifier("quantisation", channel), setting.unit(channel)
    step = setting.resolution.get(channel)
    most = np.inf if step is None else step**2 / 6.0

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = list(model.outputs).index(channel)

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            h, C, R = model.observation(a, u, t, own_base)
            R = per_point(R, len(a), own[0])
            R[..., row, row] += own[0]
            return h, C, R

        return on_base(model, split, measurement=measurement)

    return Effect(
        "quantisation",
        channel,
        "measurement",
        f"rounding of the readings of {channel}"
        + ("" if step is None else f" to steps of {with_unit(step, unit)}"),
        f"variance of the noise of {channel} + {name},  step^2 / 12",
        (
            Parameter(
                name, 0.0, product((unit, 2.0)), (0.0, most), "variance of the rounding error"
            ),
        ),
        extend,
        look_alikes={"level": "is not seen in the readings: they take any value"},
        one_sided=True,
        readings=_rounded,
    )


def _rounded(y: Array, variance: float) -> Array:
    """Readings rounded to the steps whose rounding error has a variance."""
    step = np.sqrt(12.0 * variance)
    return step * np.round(y / step) if step > 0.0 else y


def _each_lattice(setting: Setting) -> Iterator[str]:
    yield from setting.resolution


def _variance(setting: Setting, channel: str) -> Effect | None:
    """``noise->signal``: the noise grows with |signal| (a nonlinear state or input) or with time."""
    target, _, signal = channel.partition("->")
    model = setting.model
    at_output = target in model.outputs
    if not (at_output or target in setting.states):
        return None
    if signal != "time" and signal not in {**model.nonlinear, **model.inputs}:
        return None
    name = identifier("variance", target, signal)
    first, last = setting.span
    middle, timely = 0.5 * (first + last), signal == "time"
    scale = max(last - first, setting.dt) if timely else setting.size(signal)
    origin = None if timely else Origin(setting, name, signal)

    def factor(model: MixedModel, a: Array, u: Any, t: Any, own: Any) -> Any:
        if origin is None:
            x = t - own[2]
        elif signal in model.nonlinear:
            x = np.abs(a[:, list(model.nonlinear).index(signal)] - origin.of(own))
        else:
            x = np.abs(u[list(model.inputs).index(signal)] - origin.of(own))
        return np.exp(np.clip(0.5 * own[0] * x / own[1], -8.0, 8.0))

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            f, A, Q = model.transition(a, u, t, dt, own_base)
            index = [*model.nonlinear, *model.linear].index(target)
            return f, A, _scaled(Q, index, factor(model, a, u, t, own), len(a))

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            h, C, R = model.observation(a, u, t, own_base)
            index = list(model.outputs).index(target)
            return h, C, _scaled(R, index, factor(model, a, u, t, own), len(a))

        if at_output:
            return on_base(model, split, measurement=measurement)
        return on_base(model, split, dynamics=dynamics)

    unit = "s" if origin is None else setting.unit(signal)
    further = [
        Parameter(f"{name}_per", scale, unit, (POSITIVE, np.inf), "to which the size refers")
    ]
    if origin is None:
        what = f"(t - {name}_middle)"
        further.append(Parameter(f"{name}_middle", middle, "s", description="where it is zero"))
    else:
        what = f"|{origin.text(signal)}|"
        further.extend(origin.parameters)
    return Effect(
        "variance",
        channel,
        "noise",
        f"{'measurement' if at_output else 'process'} noise of {target} that changes with {what}",
        f"log variance of the noise of {target} + {name} * {what} / {name}_per",
        (Parameter(name, 0.0, "1", (-20.0, 20.0), "change of the log variance"), *further),
        extend,
        probes=(tuple(p.default for p in further),),
        look_alikes={"level": "does not change", "heavy-tails": "comes at random times"},
        held=tuple(p.name for p in further),
        zero=None if origin is None else origin.name,
    )


def _each_variance(setting: Setting) -> Iterator[str]:
    model = setting.model
    for target in [*model.outputs, *setting.targets]:
        for signal in [*model.nonlinear, *model.inputs, "time"]:
            yield f"{target}->{signal}"


def _correlation(setting: Setting, channel: str) -> Effect | None:
    """``i,j``: the process noises of two states are correlated (Q_az)."""
    one, _, other = channel.partition(",")
    states = list(setting.states)
    if one not in states or other not in states or one == other:
        return None
    name = identifier("correlation", one, other)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        all_states = [*model.nonlinear, *model.linear]
        i, j = all_states.index(one), all_states.index(other)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            f, A, Q = model.transition(a, u, t, dt, own_base)
            Q = per_point(Q, len(a), own[0])
            both = own[0] * np.sqrt(Q[..., i, i] * Q[..., j, j])
            Q[..., i, j] += both
            Q[..., j, i] += both
            return f, A, Q

        return on_base(model, split, dynamics=dynamics)

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


def _each_correlation(setting: Setting) -> Iterator[str]:
    states = setting.targets
    for i, one in enumerate(states):
        for other in states[i + 1 :]:
            yield f"{one},{other}"


def _colored(setting: Setting, channel: str) -> Effect | None:
    """A part of the noise is first-order autoregressive.

    In a state's equation that is what the unnamed slow force is, so there it goes by name only.
    """
    if channel not in setting.model.outputs:
        force = _latent(setting, channel)
        if force is None:
            return None
        return replace(force, kind="colored", title=f"coloured process noise of {channel}")
    name, unit = identifier("colored", channel), setting.unit(channel)
    scale = setting.size(channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = list(model.outputs).index(channel)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            return _ou(model.transition(a, u, t, dt, own_base), len(a), dt, own)

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            h, C, R = model.observation(a, u, t, split(theta)[0])
            C = np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1)
            C[..., row, -1] = 1.0
            return h, C, R

        return add_linear_states(
            model,
            split,
            {f"noise_{channel}": unit},
            dynamics,
            _stationary(model.nz, 1),
            measurement=measurement,
        )

    return Effect(
        "colored",
        channel,
        "noise",
        f"coloured measurement noise of {channel}",
        f"{channel} = ... + c,  c an Ornstein-Uhlenbeck process of variance {name}",
        (
            Parameter(
                name,
                0.0,
                product((unit, 2.0)),
                setting.limits(0.0, 100.0 * scale**2, 0.0),
                "variance",
            ),
            _time_parameter(name, setting),
        ),
        extend,
        probes=((2.0 * setting.dt,), (10.0 * setting.dt,)),
        look_alikes={"latent": "moves the state", "lag": "is driven by the reading itself"},
        one_sided=True,
    )


def _latent(setting: Setting, channel: str) -> Effect | None:
    """A force nobody named: a random process in one equation; detects "something".

    First-order and slow (Ornstein-Uhlenbeck), or, as ``state,oscillating``, of second order: a noise
    that swings about a frequency and forgets its phase.
    """
    target, _, manner = channel.partition(",")
    if target not in setting.states or manner not in ("", OSCILLATING):
        return None
    name, unit = identifier("latent", channel), setting.rate(target)
    most = setting.limits(0.0, 100.0 * (setting.size(target) / setting.dt) ** 2, 0.0)
    swings = manner == OSCILLATING
    states = {f"force_{target}": unit}
    if swings:
        states = {f"swing_{target}": unit, **states}

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = [*model.nonlinear, *model.linear].index(target)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            step = model.transition(a, u, t, dt, own_base)
            f, A, Q = (_swing if swings else _ou)(step, len(a), dt, own)
            A[..., row, -1] += dt
            return f, A, Q

        return add_linear_states(model, split, states, dynamics, _stationary(model.nz, len(states)))

    parameters = [
        Parameter(name, 0.0, product((unit, 2.0)), most, "variance"),
        _time_parameter(name, setting),
    ]
    probes: tuple[tuple[float, ...], ...] = ((3.0 * setting.dt,), (20.0 * setting.dt,))
    if swings:
        length = max(setting.span[1] - setting.span[0], 10.0 * setting.dt)
        bounds = setting.limits(0.5 / length, 0.48 / setting.dt)
        parameters.append(Parameter(f"{name}_frequency", 0.1 / setting.dt, "Hz", bounds))
        probes = tuple((15.0 * setting.dt, f / setting.dt) for f in (0.02, 0.06, 0.12, 0.25))
    return Effect(
        "latent",
        channel,
        "noise",
        f"unnamed {'oscillating' if swings else 'slow'} force on {target}",
        f"{target}' = ... + dt * d,  d {'a noisy oscillation' if swings else 'an Ornstein-Uhlenbeck process'} "
        f"of variance {name}",
        tuple(parameters),
        extend,
        probes=probes,
        look_alikes={"colored": "does not move the state"},
        one_sided=True,
    )


def _each_latent(setting: Setting) -> Iterator[str]:
    for state in setting.targets:
        yield state
        yield f"{state},{OSCILLATING}"


def _time_parameter(name: str, setting: Setting) -> Parameter:
    longest = max(setting.span[1] - setting.span[0], 10.0 * setting.dt)
    return Parameter(
        f"{name}_time",
        5.0 * setting.dt,
        "s",
        setting.limits(0.3 * setting.dt, longest),
        "correlation time",
    )


def _stationary(nz: int, k: int) -> Begin:
    """k states of the size's variance each, about zero and independent of the rest."""
    return lambda a, record, own: (np.zeros((len(a), k)), np.zeros((k, nz)), own[0])


def _ou(step: tuple[Array, Array, Array], M: int, dt: Any, own: Any) -> tuple[Array, Array, Array]:
    """One more linear state d' = exp(-dt/tau) d + w of stationary variance own[0]."""
    keep = np.exp(-dt / own[1])
    return beside(step, M, [[keep]], own[0] * (1.0 - keep * keep))


def _swing(
    step: tuple[Array, Array, Array], M: int, dt: Any, own: Any
) -> tuple[Array, Array, Array]:
    """Two more linear states that rotate at own[2] Hz and fade with own[1], of variance own[0] each."""
    keep = np.exp(-dt / own[1])
    angle = 2.0 * np.pi * own[2] * dt
    c, s = keep * np.cos(angle), keep * np.sin(angle)
    return beside(step, M, [[c, s], [-s, c]], own[0] * (1.0 - keep * keep))


KINDS: list[Kind] = [
    ("level", _level, lambda s: iter([*each_output(s), *each_state(s)])),
    ("quantisation", _quantisation, _each_lattice),
    ("variance", _variance, _each_variance),
    ("correlation", _correlation, _each_correlation),
    ("colored", _colored, each_output),
    ("latent", _latent, _each_latent),
]
