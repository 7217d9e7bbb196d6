"""Products of two signals that push a state: a reaction of two concentrations, a flow that carries heat."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product
from typing import Any

from engine.diagnose.effects.effect import Effect, add_to_state
from engine.diagnose.effects.kinds import Kind
from engine.diagnose.effects.origin import Origin
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
    counted = _counted_from(setting, name, one, other)
    needs = tuple(each for each in (one, other) if each in setting.states)

    def extend(model: MixedModel) -> MixedModel:
        def term(v: Any, own: Any) -> Any:
            return own[0] * (v[one] - counted[0].of(own)) * (v[other] - counted[1].of(own))

        return add_to_state(model, target, term, needs)

    both = unit_product(setting.unit(one), setting.unit(other))
    text = " * ".join(zero.text(each) for zero, each in zip(counted, (one, other), strict=True))
    origin = max(counted, key=lambda zero: len(zero.parameters))
    return Effect(
        "product",
        channel,
        "state",
        f"product of {one} and {other} acting on {target}",
        f"{target}' = ... + dt * {name} * {text}",
        extend=extend,
        look_alikes={
            "coupling": "does not depend on the other signal",
            "quadratic": "depends on one signal only",
            "input-gain": "does not depend on the state",
        },
        traits=Traits(plainness=ANY + 1),
        **origin.proportional(
            Parameter(name, 0.0, setting.rate(target, both), description="rate per product")
        ),
    )


def _counted_from(setting: Setting, name: str, one: str, other: str) -> list[Origin]:
    """Where each of the two counts from; one zero at most is a parameter, that of a scale without one."""
    afloat = next((each for each in (one, other) if setting.zeros_outside(each)), one)
    known = replace(
        setting,
        zeros={
            **setting.known_zeros,
            **{each: setting.zero(each) for each in (one, other) if each != afloat},
        },
    )
    return [Origin(known, name, each) for each in (one, other)]


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
