"""Hysteresis: a force that remembers the way, by Bouc and Wen (Wen 1976, n = 1).

    m' = v - (|v| m + delta v |m|) / w,    force = size m

Over a step in which v is held, q = m sign(v) is a function of the way s = |v| t alone,

    dq/ds = 1 - k q,    k = (1 + delta) / w where q > 0,  (1 - delta) / w where q < 0,

so that a step is exact: two exponentials, the second from where q passes zero.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import WithMemory, add_memory
from engine.diagnose.effects.channels import Channels, Kind, at_pairs, each_moved, each_state
from engine.diagnose.effects.effect import Effect, Split, pushed
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import promote
from engine.units import product

SHAPES = (-0.8, 0.5)  # delta at which the screen looks: loops that stiffen, that soften
MOST_SHAPE = 2.0  # of delta; beyond -1 the force grows with the way
LONGEST = 50.0  # exponent that a growing force may reach within a step


def _bouc_wen(
    shaped: bool, setting: Setting, channel: str, name: str, source: str, target: str
) -> Effect:
    """``shaped``: with delta, which tells the way out from the way back; else delta is 0."""
    unit = product(setting.unit(source), setting.time_unit)
    width = setting.distance(source, 0.7) * 5.0 * setting.dt
    origin = Origin(setting, name, source)
    own_parameters = [
        Parameter(name, 0.0, setting.rate(target, unit)),
        Parameter(f"{name}_width", width, unit, setting.limits(width / 100, width * 100)),
    ]
    probes: list[tuple[float, ...]] = [(width,), (10.0 * width,)]
    kind, shape = "hysteresis", ""
    more = {"coupling": "has no loop", "boucwen": "differs on the way out and on the way back"}
    traits = Traits(suits="rate")
    if shaped:
        own_parameters.append(
            Parameter(f"{name}_delta", 0.0, "1", (-MOST_SHAPE, MOST_SHAPE), "shape of the loop")
        )
        probes = [(10.0 * width, delta) for delta in SHAPES]
        kind, shape = "boucwen", f" - {name}_delta v |m| / w"
        more = {"hysteresis": "is as stiff on the way out as on the way back"}
        traits = replace(traits, contains=("hysteresis",))

    def extend(model: MixedModel) -> MixedModel:
        base = promote(model, (source,))
        split = Split(model)
        column = list(base.nonlinear).index(source)
        row = [*base.nonlinear, *base.linear].index(target)

        def step(a: Array, m: Array, u: Any, t: Any, dt: Any, record: Any, own: Any) -> WithMemory:
            delta = own[2] if shaped else 0.0
            if not base.continuous:
                f, A, Q = pushed(base, {row: dt * own[0] * m}, a, u, t, dt, record)
                way = dt * (a[:, column] - origin.of(own))
                return f, A, Q, _after(m, way, own[1], delta)
            half = 0.5 * dt * own[0]  # of the push comes before the step, half after it
            push = half * m
            f, A, Q = pushed(base, {row: push}, a, u, t, dt, record)
            speed = a[:, column] + push if row == column else a[:, column]
            way = dt * (speed - origin.of(own))
            gained = 0.5 * dt * (f[:, column] - speed)  # of the way, but for what linear states add
            moved = np.broadcast_to(A[..., column, :].any(axis=-1), (len(a),))
            way = np.where(moved, way, way + gained)
            after = _after(m, way, own[1], delta)
            if moved.any():
                # straight from where the speed stays as it is: z may be counted from anywhere
                slope = np.where(moved, _slope(after, way, own[1], delta), 0.0)
                after = after + slope * gained
                A = np.broadcast_to(A, (len(a), *A.shape[-2:]))
                by_linear = np.reshape(0.5 * dt * slope, (-1, 1)) * A[:, column]
                A = np.concatenate([A, by_linear[:, None]], axis=1)
                A[:, row] += np.reshape(half, (-1, 1)) * by_linear
            f[:, row] += half * after
            return f, A, Q, after

        def begin(own: Any) -> tuple[float, float]:
            return 0.0, float(own[1]) ** 2 / 3.0  # anywhere within its limits +- w

        return add_memory(base, split, {f"memory_{source}": unit}, step, begin)

    return Effect(
        kind,
        channel,
        "state",
        f"{'hysteresis with a shape' if shaped else 'hysteresis'} (Bouc-Wen) driven by {source}"
        + ("" if source == target else f" on {target}"),
        f"m' = m + dt (v - |v| m / w{shape}),  v = {origin.text(source)},  "
        f"{target}' = ... + dt * {name} * m",
        extend=extend,
        look_alikes={"coulomb": "has no memory beyond the sign", **more},
        traits=traits,
        **origin.counted(*own_parameters, probes=probes),
    )


def _after(m: Array, way: Array, width: Any, delta: Any) -> Array:
    """The memory after a way; signed, the width and delta are numbers or (M,)."""
    sign = np.where(way < 0.0, -1.0, 1.0)
    q, left = m * sign, np.abs(way)
    back, out = (1.0 - delta) / width, (1.0 + delta) / width
    crossing = np.where(q < 0.0, _way_to_zero(q, back), 0.0)
    first = np.minimum(left, crossing)
    q = np.where(first > 0.0, _along(q, first, back), q)
    q = np.where(left > crossing, _along(np.where(crossing > 0.0, 0.0, q), left - first, out), q)
    return np.asarray(sign * q)


def _slope(m: Array, way: Array, width: Any, delta: Any) -> Array:
    """How much further the memory m, after a way, is for a longer way."""
    q = m * np.where(way < 0.0, -1.0, 1.0)
    return np.asarray(1.0 - q * (1.0 + np.where(q < 0.0, -delta, delta)) / width)


def _along(q: Array, s: Array, k: Any) -> Array:
    """The solution of dq/ds = 1 - k q after a way s."""
    exponent = np.minimum(-k * s, LONGEST)
    small = np.abs(exponent) < 1e-12
    share = np.where(small, 1.0, np.expm1(exponent) / np.where(small, 1.0, exponent))
    return np.asarray(q * np.exp(exponent) + s * share)


def _way_to_zero(q: Array, k: Any) -> Array:
    """The way at which q, below zero, passes it; inf where it never does."""
    kq = k * q
    with np.errstate(divide="ignore", invalid="ignore"):
        way = np.where(np.abs(kq) < 1e-12, -q, np.log1p(-kq) / np.where(kq == 0.0, 1.0, k))
    return np.asarray(np.where(np.isfinite(way) & (kq < 1.0), way, np.inf))


def _turning(states: Channels, setting: Setting) -> list[str]:
    """Those that go both ways: on one way alone a loop is a curved drift, which has nothing to remember."""
    return [name for name in states(setting) if setting.turns(name)]


KINDS: list[Kind] = [
    at_pairs("hysteresis", partial(_bouc_wen, False), partial(_turning, each_state)),
    at_pairs("boucwen", partial(_bouc_wen, True), partial(_turning, each_moved)),
]
