"""A sensor that follows with a lag of first order, its time constant in seconds.

    tau r' = h - r

With h on a straight line from one time to the next, over a step q = dt / tau,

    r_t = K r_(t-1) + (1 - p) h_t + (p - K) h_(t-1),    K = exp(-q),    p = (1 - K) / q,

for any dt, be it short, long or changing; at tau = 0 it is r = h. What is known before h_t is a memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import WithMemory, add_linear_states, add_memory, beside
from engine.diagnose.effects.channels import Kind, at_outputs
from engine.diagnose.effects.effect import Effect, Split, per_point
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.evaluation import hands_rows_on
from engine.statespace.model import Array, MixedModel


def _slow_sensor(setting: Setting, channel: str, name: str) -> Effect:
    slowest = max(0.5 * setting.length, 2.0 * setting.dt)
    return Effect(
        "slow-sensor",
        channel,
        "measurement",
        f"slow sensor {channel}: a lag of first order",
        f"{name} r' = y - r,  {channel} = r",
        (setting.time(name, 0.0, setting.limits(0.0, slowest, 0.0), "time constant"),),
        lambda model: _late(model, setting, channel),
        look_alikes={
            "lag": "is over after one sample",
            "delay": "comes late as a whole",
            "pole": "changes the motion itself",
            "path": "follows the input, not the reading",
        },
        one_sided=True,
        traits=Traits(contains=("lag",)),  # of less than a sample, it is one
    )


def _late(model: MixedModel, setting: Setting, channel: str) -> MixedModel:
    """m = K r_(t-1) + (p - K) h_(t-1), linear, and p, which is known: a measurement does not know its dt.

    Neither is there at first, as of a sensor that has settled.
    """
    split, row = Split(model), list(model.outputs).index(channel)

    def share_of(dt: Any, own: Any) -> tuple[Any, Any]:
        """K and p."""
        with np.errstate(divide="ignore"):
            keep = np.exp(-np.divide(dt, own[0]))
        return keep, (1.0 - keep) * own[0] / dt

    def step(a: Array, last: Array, u: Any, t: Any, dt: Any, record: Any, own: Any) -> WithMemory:
        share = np.broadcast_to(share_of(dt, own)[1], (len(a),))
        return *model.transition(a, u, t, dt, record), share

    known = {f"share_{channel}": "1"}
    inner = add_memory(model, split, known, step, lambda own: (0.0, 0.0))
    # its record has a parameter more than the model has, so that no test of rows can be made
    for function in (inner.dynamics, inner.measurement):
        hands_rows_on(function)
    nx, nz = inner.nx, inner.nz

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        M, (keep, share) = len(a), share_of(dt, split(theta)[1])
        h, C, _ = inner.observation(a, u, t, theta)
        block = [[np.broadcast_to(keep, (M,))]]
        f, A, Q = beside(inner.transition(a, u, t, dt, theta), M, block, 0.0)
        gain = share - keep * a[:, model.na]
        f[:, nx] = gain * h[:, row]
        A[:, nx, :nz] = gain[:, None] * C[..., row, :]
        return f, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        h, C, R = inner.observation(a, u, t, theta)
        now, h = 1.0 - a[:, model.na], h.copy()
        C = per_point(np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1), len(a), now)
        h[:, row] *= now
        C[:, row] *= now[:, None]
        C[:, row, nz] = 1.0
        return h, C, R

    def parts(theta: Any) -> tuple[Any, Any]:
        return theta, split(theta)[1]  # the inner model takes the effect's values too

    late = {f"late_{channel}": setting.unit(channel)}
    return add_linear_states(inner, parts, late, dynamics, measurement=measurement)


KINDS: list[Kind] = [at_outputs("slow-sensor", _slow_sensor)]
