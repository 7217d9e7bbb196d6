"""Products of two signals that push a state: a reaction of two concentrations, a flow that carries heat."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product
from typing import Any

from engine.diagnose.effects.effect import Effect, add_to_state
from engine.diagnose.effects.kinds import Kind
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import ANY, Traits
from engine.statespace.model import MixedModel, Parameter
from engine.units import product as unit_product

TIMES, ONTO = "*", "->"


def _product(setting: Setting, channel: str) -> Effect | None:
    """``one*other->target``: what either does depends on the other, counted from their zeros."""
    source, _, target = channel.partition(ONTO)
    one, _, other = source.partition(TIMES)
    known = {**setting.states, **setting.model.inputs}
    if target not in setting.states or one == other or not {one, other} <= set(known):
        return None
    name = setting.identifier("product", f"{one},{other}", target)
    # where nobody knows a zero from the middle: from elsewhere it adds what the other signal does by itself
    zeros = setting.zero(one), setting.zero(other)
    needs = tuple(each for each in (one, other) if each in setting.states)

    def extend(model: MixedModel) -> MixedModel:
        def term(v: Any, own: Any) -> Any:
            return own[0] * (v[one] - zeros[0]) * (v[other] - zeros[1])

        return add_to_state(model, target, term, needs)

    both = unit_product(setting.unit(one), setting.unit(other))
    text = " * ".join(
        each if zero == 0.0 else f"({each} - {zero:g})"
        for each, zero in zip((one, other), zeros, strict=True)
    )
    return Effect(
        "product",
        channel,
        "state",
        f"product of {one} and {other} acting on {target}",
        f"{target}' = ... + dt * {name} * {text}",
        (Parameter(name, 0.0, setting.rate(target, both), description="rate per product"),),
        extend,
        look_alikes={
            "coupling": "does not depend on the other signal",
            "quadratic": "depends on one signal only",
            "input-gain": "does not depend on the state",
        },
        traits=Traits(plainness=ANY + 1),
    )


def _each_product(setting: Setting) -> Iterator[str]:
    """Pairs of states that move, or one with an input, of which one moves the target already or is the target.

    Of two inputs by name only: what they do within a sample looks like their product.
    """
    feeds, moved = setting.feeds
    states, inputs = list(setting.states), list(setting.model.inputs)
    for target in setting.targets:
        row = states.index(target)
        near = {name for i, name in enumerate(states) if feeds[row, i]} | {target}
        near |= {name for i, name in enumerate(inputs) if moved[row, i]}
        used = [name for name in inputs if name not in setting.extra]
        for one, other in (*combinations(setting.moved, 2), *product(setting.moved, used)):
            if {one, other} & near:
                yield f"{one}{TIMES}{other}{ONTO}{target}"


KINDS: list[Kind] = [("product", _product, _each_product)]
