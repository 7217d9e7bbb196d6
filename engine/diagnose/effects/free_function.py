"""A force that is any function of a signal, straight between values at knots.

It has no name; it says what the best name could reach, and shows a curve where none does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from engine.diagnose.effects.effect import Effect, add_to_state, worded_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, MixedModel, Parameter

KNOTS = 9
LEVELS = 0.005, 0.995  # shares of the record at the first and last knot: beyond, the curve is level
CLOSEST = 0.25  # of knots spread evenly: quantiles nearer to each other make one


def knots_of(values: Array) -> Array:
    """Knots (K,) halfway between even ones and quantiles of a signal (n,); one where it stands still.

    Even ones alone leave some without data, quantiles alone put nearly all where the signal rests.
    """
    values = values[np.isfinite(values)]
    if not values.size:
        return np.zeros(1)
    levels = np.linspace(*LEVELS, KNOTS)
    by_share = np.quantile(values, levels)
    even = np.linspace(by_share[0], by_share[-1], KNOTS)
    wanted = 0.5 * (by_share + even)
    least = CLOSEST * (even[1] - even[0])
    kept = [wanted[0]]
    for knot in wanted[1:]:
        if knot - kept[-1] > least:
            kept.append(knot)
    return np.array(kept)


def hats(x: Any, knots: Array) -> Array:
    """Values (K, ...) at x (...) of the functions that are 1 at one knot and 0 at the others.

    Straight between knots, level beyond the first and the last.
    """
    x = np.clip(x, knots[0], knots[-1])
    at = knots.reshape(-1, *(1,) * x.ndim)
    up, down = np.ones((2, len(knots), *x.shape))
    up[1:] = (x - at[:-1]) / (at[1:] - at[:-1])
    down[:-1] = (at[1:] - x) / (at[1:] - at[:-1])
    return np.asarray(np.clip(np.minimum(up, down), 0.0, 1.0))


def free_function(
    setting: Setting, source: str, target: str, knots: Array, directions: Array
) -> Effect:
    """``target``' = ... + dt * (a function of ``source``, a state or an input).

    Its values at the ``knots`` (K,) are ``directions`` (K, r) @ parameters (r,): those that data can tell.
    """
    name = setting.identifier("function", source, target)
    unit = setting.rate(target)

    def extend(model: MixedModel) -> MixedModel:
        def term(v: Any, own: Sequence[Any]) -> Any:
            hat = hats(v[source], knots)
            weights = directions.reshape(*directions.shape, *(1,) * (hat.ndim - 1))
            shapes = (weights * hat[:, None]).sum(axis=0)  # (r, ...), in the order of the knots
            return sum(value * shape for value, shape in zip(own, shapes, strict=True))

        return add_to_state(model, target, term, (source,) if source in model.linear else ())

    effect = Effect(
        "function",
        f"{source}->{target}",
        "state",
        f"a function of {source} on {target}",
        f"{target}' = ... + dt * {name}({source})",
        tuple(Parameter(f"{name}_{k}", 0.0, unit) for k in range(1, directions.shape[1] + 1)),
        extend,
        traits=Traits(unnamed=True),
    )
    return worded_for(setting.model, effect)
