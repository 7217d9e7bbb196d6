"""Effects in the noise: its level, colour, correlation, and forces nobody named."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from engine.diagnose.effect import Effect, Split, identifier, on_base, per_point
from engine.diagnose.more_states import add_linear_state
from engine.diagnose.setting import Kind, Setting, each_output, each_state
from engine.model import Array, MixedModel, Parameter


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
    scale = setting.size(signal) if signal != "time" else max(last - first, setting.dt)

    middle = 0.5 * (first + last)

    def factor(model: MixedModel, a: Array, u: Any, t: Any, own: Any) -> Any:
        if signal == "time":
            x = t - own[2]
        elif signal in model.nonlinear:
            x = np.abs(a[:, list(model.nonlinear).index(signal)])
        else:
            x = np.abs(u[list(model.inputs).index(signal)])
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

    what = f"(t - {name}_middle)" if signal == "time" else f"|{signal}|"
    unit = "s" if signal == "time" else setting.unit(signal)
    further = [Parameter(f"{name}_per", scale, unit, (1e-300, np.inf), "to which the size refers")]
    if signal == "time":
        further.append(Parameter(f"{name}_middle", middle, "s", description="where it is zero"))
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
    )


def _each_variance(setting: Setting) -> Iterator[str]:
    model = setting.model
    for target in [*model.outputs, *setting.states]:
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
    states = list(setting.states)
    for i, one in enumerate(states):
        for other in states[i + 1 :]:
            yield f"{one},{other}"


def _colored(setting: Setting, channel: str) -> Effect | None:
    """A part of the measurement noise is first-order autoregressive."""
    if channel not in setting.model.outputs:
        return None
    name, unit = identifier("colored", channel), setting.unit(channel)
    scale = setting.size(channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = list(model.outputs).index(channel)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            return _with_ou(model.transition(a, u, t, dt, own_base), len(a), dt, own, None)

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            h, C, R = model.observation(a, u, t, split(theta)[0])
            C = np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1)
            C[..., row, -1] = 1.0
            return h, C, R

        return add_linear_state(
            model,
            split,
            f"noise_{channel}",
            unit,
            dynamics,
            lambda own: float(np.ravel(own[0])[0]),
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
                f"({unit})^2",
                setting.limits(0.0, 100.0 * scale**2),
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
    """A force nobody named: an Ornstein-Uhlenbeck process in one equation; detects "something"."""
    if channel not in setting.states:
        return None
    name, unit = identifier("latent", channel), f"{setting.unit(channel)}/s"
    scale = setting.size(channel) / setting.dt

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = [*model.nonlinear, *model.linear].index(channel)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            return _with_ou(model.transition(a, u, t, dt, own_base), len(a), dt, own, row)

        return add_linear_state(
            model, split, f"force_{channel}", unit, dynamics, lambda own: float(np.ravel(own[0])[0])
        )

    return Effect(
        "latent",
        channel,
        "noise",
        f"unnamed slow force on {channel}",
        f"{channel}' = ... + dt * d,  d an Ornstein-Uhlenbeck process of variance {name}",
        (
            Parameter(name, 0.0, f"({unit})^2", (0.0, 100.0 * scale**2), "variance"),
            _time_parameter(name, setting),
        ),
        extend,
        probes=((3.0 * setting.dt,), (20.0 * setting.dt,)),
        look_alikes={"colored": "does not move the state"},
        one_sided=True,
    )


def _time_parameter(name: str, setting: Setting) -> Parameter:
    longest = max(setting.span[1] - setting.span[0], 10.0 * setting.dt)
    return Parameter(
        f"{name}_time",
        5.0 * setting.dt,
        "s",
        setting.limits(0.3 * setting.dt, longest, 1e-12),
        "correlation time",
    )


def _with_ou(
    step: tuple[Array, Array, Array], M: int, dt: Any, own: Any, row: int | None
) -> tuple[Array, Array, Array]:
    """One more linear state d' = exp(-dt/tau) d + w of stationary variance own[0]; into ``row``."""
    f, A, Q = step
    nx = f.shape[1]
    keep = np.exp(-dt / own[1])
    A_all = np.zeros((*A.shape[:-2], nx + 1, A.shape[-1] + 1))
    A_all[..., :nx, :-1] = A
    A_all = per_point(A_all, M, keep)
    A_all[..., nx, -1] = keep
    if row is not None:
        A_all[..., row, -1] += dt
    Q_all = np.zeros((*Q.shape[:-2], nx + 1, nx + 1))
    Q_all[..., :nx, :nx] = Q
    variance = own[0] * (1.0 - keep * keep)
    Q_all = per_point(Q_all, M, variance)
    Q_all[..., nx, nx] = variance
    return np.concatenate([f, np.zeros((M, 1))], axis=1), A_all, Q_all


KINDS: list[Kind] = [
    ("level", _level, lambda s: iter([*each_output(s), *each_state(s)])),
    ("variance", _variance, _each_variance),
    ("correlation", _correlation, _each_correlation),
    ("colored", _colored, each_output),
    ("latent", _latent, each_state),
]
