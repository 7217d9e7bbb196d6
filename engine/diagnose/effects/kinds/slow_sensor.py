"""A sensor that follows with a lag of first order, its time constant in seconds; or a filter of its readings.

    tau r' = h - r

With h on a straight line from one time to the next, over a step q = dt / tau,

    r_t = K r_(t-1) + (1 - p) h_t + (p - K) h_(t-1),    K = exp(-q),    p = (1 - K) / q,

for any dt, be it short, long or changing; at tau = 0 it is r = h. What is known before h_t is a memory.

A digital filter, as loggers and drives have it, knows h at the samples only:

    r_t = r_(t-1) + dt / (tau + dt) (h_t - r_(t-1)),    which is the same with    p = K = tau / (tau + dt).

Both are late by tau, and the same for a tau of many samples. What is noise of the reading may come after it, or
be smoothed as well: then m has the noise of r_(t-1), less K of it forgotten, and nearly none is left at t.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import WithMemory, add_linear_states, add_memory, beside
from engine.diagnose.effects.channels import Kind, at_outputs
from engine.diagnose.effects.effect import Effect, Split, per_point
from engine.diagnose.effects.noise_inside import LEFT, noise_too, with_part
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.evaluation import hands_rows_on
from engine.statespace.model import Array, MixedModel, Parameter

FIRST = -1.0  # for p at the first time: there is no reading before


def _slow_sensor(setting: Setting, channel: str, name: str) -> Effect:
    slowest = max(0.5 * setting.length, 2.0 * setting.dt)
    return Effect(
        "slow-sensor",
        channel,
        "measurement",
        f"slow sensor {channel}: a lag of first order",
        f"{name} r' = y - r,  {channel} = r; where {name}_digital is 1, "
        f"r_t = (y_t + n r_(t-1)) / (1 + n) with {name} = n samples",
        (
            setting.time(name, 0.0, setting.limits(0.0, slowest, 0.0), "time constant"),
            Parameter(
                f"{name}_digital", 0.0, "1", (0.0, 1.0), "1: a digital filter, 0: the sensor itself"
            ),
            noise_too(name),
        ),
        lambda model: _late(model, setting, channel),
        probes=((0.0, 0.0),),
        held=(f"{name}_digital", f"{name}_noise"),
        manners=(*([f"{name}_digital"] if setting.tells_samples else []), f"{name}_noise"),
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
    steps = setting.substeps if setting.tells_samples else 1

    def share_of(dt: Any, own: Any) -> tuple[Any, Any]:
        """K and p."""
        tau, digital, _ = own
        with np.errstate(divide="ignore"):
            keep = np.exp(-np.divide(dt, tau))
        share = (1.0 - keep) * tau / dt
        filtered = tau / (tau + steps * dt)
        return keep + digital * (filtered - keep), share + digital * (filtered - share)

    def step(a: Array, last: Array, u: Any, t: Any, dt: Any, record: Any, own: Any) -> WithMemory:
        share = np.broadcast_to(share_of(dt, own)[1], (len(a),))
        return *model.transition(a, u, t, dt, record), share

    known = {f"share_{channel}": "1"}
    inner = add_memory(model, split, known, step, lambda own: (FIRST, 0.0))
    # its record has a parameter more than the model has, so that no test of rows can be made
    for function in (inner.dynamics, inner.measurement):
        hands_rows_on(function)
    nx, nz = inner.nx, inner.nz

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        M, own = len(a), split(theta)[1]
        keep, share = share_of(dt, own)
        h, C, R = inner.observation(a, u, t, theta)
        known = a[:, model.na]
        gain = share - keep * np.maximum(known, 0.0)
        if steps > 1:  # between samples a filter waits
            acts = 1.0 - own[1] * (1.0 - setting.at_sample(t))
            keep, gain = 1.0 - acts * (1.0 - keep), acts * gain
        block = [[np.broadcast_to(keep, (M,))]]
        forgotten = np.where(known < 0.0, 1.0, 1.0 - keep * keep)
        noise = own[2] * (1.0 - LEFT) * forgotten * R[..., row, row]
        f, A, Q = beside(inner.transition(a, u, t, dt, theta), M, block, noise)
        f[:, nx] = gain * h[:, row]
        A[:, nx, :nz] = gain[:, None] * C[..., row, :]
        return f, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        h, C, R = inner.observation(a, u, t, theta)
        known = a[:, model.na]
        now, h = 1.0 - np.maximum(known, 0.0), h.copy()
        left = 1.0 - split(theta)[1][2] * (1.0 - LEFT) * (known >= 0.0)
        R = with_part(R, row, left, len(a))
        C = per_point(np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1), len(a), now)
        h[:, row] *= now
        C[:, row] *= now[:, None]
        C[:, row, nz] = 1.0
        return h, C, R

    def parts(theta: Any) -> tuple[Any, Any]:
        return theta, split(theta)[1]  # the inner model takes the effect's values too

    late = {f"late_{channel}": setting.unit(channel)}
    slow = add_linear_states(inner, parts, late, dynamics, measurement=measurement)
    return replace(slow, steps_counted=steps) if setting.tells_samples else slow


KINDS: list[Kind] = [at_outputs("slow-sensor", _slow_sensor)]
