"""A store with a limit: what is above it runs off quickly, into another store in part or not at all.

    x' = ... - size (x - L)+        other' = ... + share size (x - L)+

Of a level that is counted downward, as the depth below a rim, it is what is below: (x - L)-. Over a step the
surplus decays, so that any rate can be stepped: size (x - L) dt becomes (x - L) (1 - exp(-size dt)), and a
large size is a rim that nothing stands above.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_pairs, each_moved
from engine.diagnose.effects.effect import Effect, Split, on_base, pushed
from engine.diagnose.effects.kinds.odds import nothing_spills
from engine.diagnose.effects.setting import WIDEST, Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import promote
from engine.units import product, same_kind

FULL = (0.7, 0.85, 0.95)  # shares of the record within the limits the screen looks at
ABOVE, BELOW = 1.0, -1.0
GONE = 20.0  # size times the time step at which nothing is left above the limit


def _overflow(setting: Setting, channel: str, name: str, source: str, target: str) -> Effect | None:
    """``x``: the surplus is lost; ``x->other``: a share of it arrives there."""
    unit, lost = setting.unit(source), source == target
    low, high = setting.quantile(source, 0.0), setting.quantile(source, 1.0)
    if not low < high < np.inf:
        low, high = setting.inside(source)
    fastest = setting.limits(0.0, GONE / setting.dt, 0.0)
    parameters = [
        Parameter(name, 0.0, setting.per_time, fastest, "rate of decay"),
        Parameter(f"{name}_limit", setting.quantile(source, FULL[0]), unit, (low, high), "limit"),
    ]
    rest: tuple[float, ...] = ()
    if not lost:
        # stores of other widths or units: what one gains is no more than some of what the other has lost
        ratio = setting.size(target) / setting.size(source)
        rest = (0.5 * ratio,)
        share = product(setting.unit(target), (unit, -1.0))
        bounds, what = setting.limits(0.0, WIDEST * ratio, 0.0), f"{target} gained by what is lost"
        parameters.append(Parameter(f"{name}_share", rest[0], share, bounds, what))
    parameters.append(Parameter(f"{name}_side", ABOVE, "1", (-1.0, 1.0), "1: above, -1: below"))
    limits = [(setting.quantile(source, level), ABOVE) for level in FULL]
    limits += [(setting.quantile(source, 1.0 - level), BELOW) for level in FULL]
    arrives = "" if lost else f",  {target}' = ... + {name}_share * the same"
    return Effect(
        "overflow",
        channel,
        "state",
        f"overflow of {source}" + ("" if lost else f" into {target}"),
        f"{source}' = ... - dt * {name} * (what of {source} is beyond {name}_limit, on {name}_side)"
        f"{arrives}",
        tuple(parameters),
        lambda model: _with_limit(model, setting, source, target),
        probes=tuple((limit, *rest, side) for limit, side in limits),
        look_alikes={
            "saturation": "acts on both sides of its zero",
            "drag": "acts on small values too",
            "saturation-sensor": "clips the reading, not what is read",
        },
        held=(f"{name}_side",),
        one_sided=True,
        traits=Traits(suits="store", odd=nothing_spills(setting, source)),
    )


def _with_limit(model: MixedModel, setting: Setting, source: str, target: str) -> MixedModel:
    """After the step; of a continuous model half before it, half after (Strang).

    What stands above the limit after the step must be known: linear states that feed the store are promoted.
    """
    fed = setting.feeding(source)
    needs = [name for name in model.linear if name == source or name in fed]
    base = promote(model, needs)
    split = Split(base)
    own_states = [*base.nonlinear, *base.linear]
    column, row = own_states.index(source), own_states.index(target)
    early = 0.5 if base.continuous else 0.0

    def moved(x: Any, time: Any, own: Any) -> dict[int, Any]:
        """What leaves the store in a time, and what arrives."""
        above, below = np.maximum(x - own[1], 0.0), np.minimum(x - own[1], 0.0)
        surplus = np.where(np.less(own[-1], 0.0), below, above) * -np.expm1(-own[0] * time)
        return {column: -surplus} | ({} if row == column else {row: own[2] * surplus})

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        before = moved(a[:, column], early * dt, own) if early else {}
        f, A, Q = pushed(base, before, a, u, t, dt, record)
        for i, amount in moved(f[:, column], (1.0 - early) * dt, own).items():
            f[:, i] += amount
        return f, A, Q

    return on_base(base, split, dynamics=dynamics)


def _each_store(setting: Setting) -> Iterator[str]:
    """States that others fill, neither the rate of one nor moved by a rate, and what like them they feed."""
    states = list(setting.states)
    feeds, _ = setting.feeds
    for source in each_moved(setting):
        if setting.is_rate(source) or setting.has_rate(source):
            continue
        yield source
        for j, target in enumerate(states):
            fed = feeds[j, states.index(source)] and target in setting.targets
            units = setting.unit(source), setting.unit(target)
            if fed and target != source and (units[0] == units[1] or same_kind(*units)):
                yield f"{source}->{target}"


KINDS: list[Kind] = [at_pairs("overflow", _overflow, _each_store)]
