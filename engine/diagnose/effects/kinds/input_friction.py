"""Friction that acts where an input acts: of a cart, a joint or a motor that moves several masses at once.

A force on a cart accelerates the cart and what hangs from it. So does the cart's friction, which no force on
one of the two states alone says: the equations are coupled by their masses. With v the rate of what the input
moves,

    u -> u - size * sign(v)      or      u -> u - size * v|v|.

Where an input moves one rate alone, Coulomb friction and drag of that rate say the same, and are asked instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind
from engine.diagnose.effects.effect import Effect, Split, on_base
from engine.diagnose.effects.kinds.friction import rubbed, with_feeding
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.rows import with_input
from engine.units import product

FRICTION = Traits(suits="rate")


def _each_moved_by_an_input(setting: Setting) -> Iterator[str]:
    """``state->input`` of states that an input moves with others at once, one of which is a rate at least."""
    _, moved = setting.feeds
    for j, source in enumerate(setting.model.inputs):
        rates = [
            state
            for i, state in enumerate(setting.states)
            if moved[i, j] and state in setting.targets and not setting.has_rate(state)
        ]
        if source in setting.extra or len(rates) < 2 or not any(map(setting.is_rate, rates)):
            continue
        yield from (f"{state}->{source}" for state in rates)


def _friction(
    kind: str, title: str, formula: str, power: float, setting: Setting, channel: str
) -> Effect | None:
    state, _, source = channel.partition("->")
    if state not in setting.states or source not in setting.model.inputs:
        return None
    name = setting.identifier(kind, channel)
    origin = Origin(setting, name, state)
    unit = product(setting.unit(source), (setting.unit(state), -power))
    own = kind.removeprefix("input-")
    return Effect(
        kind,
        channel,
        "input",
        f"{title} of {state} where {source} acts",
        f"{source} -> {source} - {name} * {formula.format(x=origin.text(state))}",
        extend=partial(_rubbed, setting, state, source, origin, power),
        look_alikes={
            own: "acts on one state alone",
            "input-deadzone": "acts on the input, whichever way the motion is",
        },
        traits=FRICTION,
        **origin.counted(Parameter(name, 0.0, unit, description=f"{title} in the input's unit")),
    )


def _rubbed(
    setting: Setting, state: str, source: str, origin: Origin, power: float, model: MixedModel
) -> MixedModel:
    """The model whose input is less by its friction.

    Drag is that of the motion half way through the step. Dry friction stops a motion or holds it, and the
    share of it that this takes is what acts on all that the input moves.
    """
    base = with_feeding(model, state, setting.feeding(state))
    split, index = Split(model), list(base.inputs).index(source)
    column, unit = list(base.nonlinear).index(state), setting.size(source)

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        f, A, Q = base.transition(a, u, t, dt, record)
        zero = origin.of(own)
        before, after = a[:, column] - zero, f[:, column] - zero
        # a mean over linear states does not say which way the motion is
        after = np.where(np.broadcast_to(A[..., column, :].any(axis=-1), (len(a),)), before, after)
        more = base.transition(a, with_input(u, index, u[index] + unit), t, dt, record)[0]
        slope = (more - f) / unit  # by the input, over the step
        if power:
            v = 0.5 * (before + after)
            return f - own[0] * (v * np.abs(v))[:, None] * slope, A, Q
        push = own[0] * slope[:, column]
        share = (after - rubbed(before, after, push)) / np.where(push == 0.0, 1.0, push)
        return f - own[0] * share[:, None] * slope, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        v = a[:, column] - origin.of(own)
        less = own[0] * (v * np.abs(v) if power else np.sign(v))
        return base.observation(a, with_input(u, index, u[index] - less), t, record)

    return on_base(base, split, dynamics=dynamics, measurement=measurement)


def _kind(kind: str, title: str, formula: str, power: float) -> Kind:
    return kind, partial(_friction, kind, title, formula, power), _each_moved_by_an_input


KINDS: list[Kind] = [
    _kind("input-coulomb", "Coulomb friction", "sign({x})", 0),
    _kind("input-drag", "quadratic drag", "{x}|{x}|", 2),
]
