"""Effects in the state equation: forces that depend on the states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_pairs, at_states, each_pair
from engine.diagnose.effects.effect import Effect, add_linear_coupling, add_to_state
from engine.diagnose.effects.kinds.friction import rub
from engine.diagnose.effects.kinds.odds import nothing_rubs
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import USUAL, Traits
from engine.statespace.model import MixedModel, Parameter
from engine.units import product

ODD = "an odd function of the same state; told apart by the amplitudes that were visited"
FRICTION, STIFFNESS = Traits(suits="rate"), Traits(suits="position")
BENT = ("coulomb", "coupling", "linear")  # what a bend becomes where its width is nothing or all
WIDTHS = (0.25, 0.7)  # shares of the record that are within the widths the screen looks at


def _static(
    kind: str,
    title: str,
    formula: str,
    term: Callable[[Any, Sequence[Any]], Any],
    power: float,
    look_alikes: dict[str, str],
    width: bool = False,
    friction: bool = False,
    of_rate: str = "",
    traits: Traits = USUAL,
) -> Kind:
    """A kind ``size * term(x)``, x counted from its zero, where term grows like x ** power.

    ``width`` adds a scale parameter. Of a dry ``friction`` the term is the size, whose sign is against x.
    ``of_rate`` says what it is where x is the rate of another state.
    """

    def make(setting: Setting, channel: str, name: str, source: str, target: str) -> Effect:
        unit = setting.unit(source)
        origin = Origin(setting, name, source)
        rate = setting.rate(target, product((unit, power)))
        is_rate = setting.is_rate(source) and source == target
        parameters = [Parameter(name, 0.0, rate, description=title)]
        # of a parabola the record may show one branch; beyond the record x|x| is the same
        afar = power > 1.0 and traits is STIFFNESS
        places = [
            origin.probe,
            *((x,) for x in (*(origin.outside if afar else ()), *origin.inside)),
        ]
        probes = places
        if width:
            start, bounds = setting.distance(source, 0.4), setting.width(source, origin.inside)
            what = f"distance of {source} from its zero at which it bends"
            parameters.append(Parameter(f"{name}_width", start, unit, bounds, what))
            probes = [
                (setting.distance(source, level, *place), *place)
                for place in places
                for level in WIDTHS
            ]

        def extend(model: MixedModel) -> MixedModel:
            def sized(x: Any, own: Sequence[Any]) -> Any:
                return own[0] * term(x, own[1:])

            if friction:
                return rub(model, source, target, setting.feeding(source), sized, origin.of)
            return add_to_state(
                model, target, lambda v, own: sized(v[source] - origin.of(own), own), (source,)
            )

        return Effect(
            kind,
            channel,
            "state",
            f"{title} of {source}" + _acting_on(source, target) + (of_rate if is_rate else ""),
            f"{target}' = ... {'-' if friction else '+'} dt * {name} * "
            f"{formula.format(x=origin.text(source))}",
            extend=extend,
            look_alikes=look_alikes,
            traits=replace(traits, odd=friction and nothing_rubs(setting, source)),
            **origin.counted_from(*parameters, probes=probes),
        )

    return at_pairs(kind, make, each_pair)


def _acting_on(source: str, target: str) -> str:
    return "" if source == target else f" on {target}"


def _force(setting: Setting, channel: str, name: str) -> Effect:
    return Effect(
        "force",
        channel,
        "state",
        f"constant force on {channel}",
        f"{channel}' = ... + dt * {name}",
        (Parameter(name, 0.0, setting.rate(channel), description="constant rate"),),
        lambda model: add_to_state(model, channel, lambda v, own: own[0]),
        look_alikes={
            "bias": "does not move the state",
            "step": "acts from one time on",
        },
        traits=Traits(plainness=2),
    )


def _linear(setting: Setting, channel: str, name: str) -> Effect:
    """A state's own rate of decay or growth; one that the model estimates is not testable beside it."""
    origin = Origin(setting, name, channel)
    return Effect(
        "linear",
        channel,
        "state",
        f"linear damping or growth of {channel}",
        f"{channel}' = ... + dt * {name} * {origin.text(channel)}",
        extend=partial(_coupled, channel, channel, origin),
        look_alikes={
            "drag": "grows faster than the state",
            "saturation": "acts on large values only",
            "deadzone": "acts on small values only",
        },
        **origin.proportional(Parameter(name, 0.0, setting.per_time, description="rate")),
    )


def _coupling(setting: Setting, channel: str) -> Effect | None:
    source, _, target = channel.partition("->")
    if source == target or not {source, target} <= set(setting.states):
        return None
    name = setting.identifier("coupling", source, target)
    origin = Origin(setting, name, source)
    return Effect(
        "coupling",
        channel,
        "state",
        f"coupling of {source} into {target}",
        f"{target}' = ... + dt * {name} * {origin.text(source)}",
        extend=partial(_coupled, source, target, origin),
        look_alikes={"cubic": "grows faster than the state", "gain": "acts on the reading only"},
        **origin.proportional(Parameter(name, 0.0, setting.rate(target, setting.unit(source)))),
    )


def _coupled(source: str, target: str, origin: Origin, model: MixedModel) -> MixedModel:
    """``target``' = ... + dt * size * (source - zero)."""
    if source in model.linear:
        return add_linear_coupling(model, target, source, origin.of)
    return add_to_state(model, target, lambda v, own: own[0] * (v[source] - origin.of(own)))


def _each_coupling(setting: Setting) -> list[str]:
    return [f"{x}->{y}" for x in setting.states for y in setting.targets if x != y]


KINDS: list[Kind] = [
    at_states("force", _force),
    _static(
        "quadratic",
        "quadratic force",
        "{x}^2",
        lambda x, own: x * x,
        2,
        {"force": "is constant"},
        traits=STIFFNESS,
    ),
    _static(
        "cubic",
        "cubic stiffness",
        "{x}^3",
        lambda x, own: x * x * x,  # np.power is twenty times slower
        3,
        {"drag": ODD, "deadzone": ODD},
        traits=STIFFNESS,
    ),
    _static(
        "drag",
        "quadratic drag",
        "-{x}|{x}|",
        lambda x, own: -x * np.abs(x),
        2,
        {"cubic": ODD, "coulomb": ODD},
        traits=FRICTION,
    ),
    _static(
        "coulomb",
        "Coulomb friction",
        "sign({x})",
        lambda x, own: 1.0,
        0,
        {"drag": ODD, "stribeck": ODD, "deadzone": ODD},
        friction=True,
        traits=FRICTION,
    ),
    _static(
        "stribeck",
        "Stribeck friction",
        "sign({x}) exp(-|{x}|/w)",
        lambda x, own: np.exp(-np.abs(x) / own[0]),
        0,
        {"coulomb": "does not fade with speed"},
        width=True,
        friction=True,
        traits=replace(FRICTION, contains=("coulomb",)),
    ),
    _static(
        "deadzone",
        "dead zone",
        "clip({x}, -w, w)",
        lambda x, own: np.clip(x, -own[0], own[0]),
        1,
        {"coulomb": ODD, "saturation": ODD},
        width=True,
        of_rate=": friction that stays the same above a speed",
        traits=replace(STIFFNESS, contains=BENT),
    ),
    _static(
        "saturation",
        "saturation",
        "(|{x}| - w)+ sign({x})",
        lambda x, own: np.sign(x) * np.maximum(np.abs(x) - own[0], 0.0),
        1,
        {"cubic": ODD, "deadzone": ODD, "overflow": "acts on large values of one sign only"},
        width=True,
        traits=replace(STIFFNESS, contains=BENT),
    ),
    at_states("linear", _linear),
    ("coupling", _coupling, _each_coupling),
]
