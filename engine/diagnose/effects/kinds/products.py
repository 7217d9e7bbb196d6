"""Products of two signals that push a state: a reaction of two concentrations, a flow that carries heat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, product
from typing import Any

from engine.diagnose.effects.channels import Kind
from engine.diagnose.effects.effect import Effect, add_to_state
from engine.diagnose.effects.kinds.slopes import weighed_by
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import ANY, Traits
from engine.statespace.model import MixedModel, Parameter
from engine.units import product as unit_product
from engine.words import enumerated

TIMES, ONTO = "*", "->"


def _product(setting: Setting, channel: str) -> Effect | None:
    """``one*other->target``: what either does depends on the other, counted from their zeros."""
    source, _, target = channel.partition(ONTO)
    pair = _factors(source, [*setting.states, *setting.model.inputs])
    if target not in setting.states or not pair:
        return None
    one, other = pair
    channel = f"{one}{TIMES}{other}{ONTO}{target}"
    name = setting.identifier("product", f"{one},{other}", target)
    # where nobody knows a zero from the middle: from elsewhere it adds what the other signal does by itself;
    # held as a parameter, so that a model made again without the record counts from the same place
    origins = [Origin(setting, name, each, of_several=True) for each in (one, other)]
    zeros = [p for origin in origins for p in origin.parameters]
    needs = tuple(each for each in (one, other) if each in setting.states)

    def extend(model: MixedModel) -> MixedModel:
        def term(v: Any, own: Any) -> Any:
            first, second = own[1 : 1 + len(origins[0].parameters)], own[1:]
            return own[0] * (v[one] - origins[0].of(first)) * (v[other] - origins[1].of(second))

        return add_to_state(model, target, term, needs)

    both = unit_product(setting.unit(one), setting.unit(other))
    text = " * ".join(origin.text(each) for each, origin in zip((one, other), origins, strict=True))
    return Effect(
        "product",
        channel,
        "state",
        f"product of {one} and {other} acting on {target}{_as_slopes(setting, pair, target)}",
        f"{target}' = ... + dt * {name} * {text}",
        (Parameter(name, 0.0, setting.rate(target, both), description="rate per product"), *zeros),
        extend,
        probes=(tuple(p.default for p in zeros),),
        held=tuple(p.name for p in zeros),
        zero=zeros[-1].name if zeros else None,  # of an input, where it is one of the two
        look_alikes={
            "coupling": "does not depend on the other signal",
            "quadratic": "depends on one signal only",
            "input-gain": "does not depend on the state",
        },
        traits=Traits(plainness=ANY + 1),
    )


def _as_slopes(setting: Setting, pair: Sequence[str], target: str) -> str:
    """Parameters that weigh one of the two, and depend on the other then, in words after a title."""
    one, other = pair
    words = [
        f"{parameter} depends on {other if channel == one else one}"
        for parameter in setting.steering
        for channel, state in [weighed_by(setting, parameter) or ("", "")]
        if state == target and channel in pair
    ]
    return f", as where {enumerated(words, 'or')}" if words else ""


def _factors(source: str, known: Sequence[str]) -> list[str]:
    """The two channels of ``one*other``, in the order in which they are known; empty where there are no two.

    Either may have the sign in its name.
    """
    ways = (i for i, sign in enumerate(source) if sign == TIMES)
    for one, other in ((source[:i], source[i + 1 :]) for i in ways):
        if one != other and one in known and other in known:
            return sorted((one, other), key=known.index)
    return []


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
