"""An actuator that follows its command with a lag of first order, its time constant in seconds.

    tau l' = u - l

What drives the system is l in place of u. Of an input u that is held over a step q = dt / tau,

    l_(t+1) = K l_t + (1 - K) u_t,   K = exp(-q),   and its mean is   u_t + p (l_t - u_t),   p = (1 - K) / q,

for any dt; at tau = 0 it is u. A path through a lag adds to an input that goes on acting at once; here
nothing does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import (
    WithMemory,
    add_linear_states,
    add_memory,
    beside,
    spread_at_first,
)
from engine.diagnose.effects.channels import Kind, at_inputs
from engine.diagnose.effects.effect import Effect, Split
from engine.diagnose.effects.kinds.delays import adds
from engine.diagnose.effects.setting import Setting
from engine.statespace.model import Array, LinearGaussian, MixedModel, Parameter
from engine.statespace.rows import with_input


def _slow_input(setting: Setting, channel: str, name: str) -> Effect:
    slowest = max(0.5 * setting.length, 2.0 * setting.dt)
    first, unit = setting.first(channel), setting.unit(channel)
    before = Parameter(f"{name}_first", first, unit, description=f"{channel} until the record")
    spread = spread_at_first(setting, name, channel)
    size = setting.time(name, 0.0, setting.limits(0.0, slowest, 0.0), "time constant")

    def extend(model: MixedModel) -> MixedModel:
        return (_late if adds(setting, model, channel) else _late_by_memory)(
            model, setting, channel
        )

    return Effect(
        "slow-input",
        channel,
        "input",
        f"slow actuator: what acts follows the input {channel} with a lag of first order",
        f"{name} l' = {channel} - l,  {channel} -> l",
        (size, before, spread),
        extend,
        probes=((first, spread.default),),
        look_alikes={
            "delay": "comes late as a whole",
            "slow-sensor": "is late in one reading only",
            "path": "adds to what the input does at once",
            "pole": "follows a state, not the input",
        },
        held=(before.name, spread.name),
        one_sided=True,
        spread=spread.name,
        before=before.name if setting.may_be_off(channel) else None,
    )


def _kept(dt: Any, tau: Any) -> tuple[Any, Any]:
    """K, and p: of what l is off the input when a step begins, the shares at its end and over it."""
    with np.errstate(divide="ignore"):
        keep = np.exp(-np.divide(dt, tau))
    return keep, (1.0 - keep) * tau / dt


def _late(model: MixedModel, setting: Setting, channel: str) -> MixedModel:
    """With g the gain of the input, f and h move by g p (l - u); l is a linear state, known but for the first.

    A reading that the input enters at once sees the mean over the sample that begins.
    """
    split, nx, nz = Split(model), model.nx, model.nz
    index, scale = list(model.inputs).index(channel), setting.size(channel)

    def begin(a: Array, record: Any, own: Any) -> tuple[Array, Array, Any]:
        return np.full((len(a), 1), float(own[1])), np.zeros((1, nz)), own[2] ** 2

    def gain(function: Any, here: Array, a: Array, u: Any, *at: Any) -> Array:
        more = with_input(u, index, u[index] + scale)
        return np.asarray((function(a, more, *at)[0] - here) / scale)

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        M, (keep, share) = len(a), _kept(dt, own[0])
        step = model.transition(a, u, t, dt, record)
        g = gain(model.transition, step[0], a, u, t, dt, record) * np.reshape(share, (-1, 1))
        f, A, Q = beside(step, M, [[np.broadcast_to(keep, (M,))]], 0.0)
        f[:, :nx] -= g * np.reshape(u[index], (-1, 1))
        f[:, nx] = (1.0 - keep) * u[index]
        A[:, :nx, nz] = g
        return f, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        h, C, R = model.observation(a, u, t, record)
        g = gain(model.observation, h, a, u, t, record)
        C = np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1)
        if g.any():
            g = g * np.reshape(_kept(setting.dt, own[0])[1], (-1, 1))
            h, C = (
                h - g * np.reshape(u[index], (-1, 1)),
                np.broadcast_to(C, (len(a), *C.shape[-2:])).copy(),
            )
            C[..., nz] = g
        return h, C, R

    late = {f"acting_{channel}": setting.unit(channel)}
    return add_linear_states(model, split, late, dynamics, begin, measurement=measurement)


def _late_by_memory(model: MixedModel, setting: Setting, channel: str) -> MixedModel:
    """For an input that does not simply add: l is a nonlinear state."""
    split, index = Split(model), list(model.inputs).index(channel)

    def driven(last: Array, u: Any, share: Any) -> Any:
        return with_input(u, index, u[index] + share * (last - u[index]))

    def step(a: Array, last: Array, u: Any, t: Any, dt: Any, record: Any, own: Any) -> WithMemory:
        keep, share = _kept(dt, own[0])
        f, A, Q = model.transition(a, driven(last, u, share), t, dt, record)
        return f, A, Q, u[index] + keep * (last - u[index])

    def observe(a: Array, last: Array, u: Any, t: Any, record: Any, own: Any) -> LinearGaussian:
        return model.observation(a, driven(last, u, _kept(setting.dt, own[0])[1]), t, record)

    def begin(own: Any) -> tuple[float, float]:
        return float(own[1]), own[2] ** 2

    late = {f"acting_{channel}": setting.unit(channel)}
    return add_memory(model, split, late, step, begin, observe)


KINDS: list[Kind] = [at_inputs("slow-input", _slow_input)]
