"""Effects in the state equation: forces that depend on the states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from engine.diagnose.effect import (
    Effect,
    Values,
    add_linear_coupling,
    add_to_state,
    identifier,
)
from engine.diagnose.setting import Kind, Maker, Setting, each_pair, each_state, pair
from engine.model import MixedModel, Parameter

ODD = "an odd function of the same state; told apart by the amplitudes that were visited"


def power_of(unit: str, power: float) -> str:
    """The unit of x ** power, "" for power 0."""
    if power in (0, 1):
        return unit if power else ""
    whole = f"({unit})" if "/" in unit or " " in unit else unit
    return f"{whole}^{power:g}"


def _static(
    kind: str,
    title: str,
    formula: str,
    term: Callable[[Any, Sequence[Any]], Any],
    power: float,
    look_alikes: dict[str, str],
    width: bool = False,
) -> Maker:
    """A kind ``size * term(x)`` where term grows like x ** power; ``width`` adds a scale parameter."""

    def make(setting: Setting, channel: str) -> Effect | None:
        found = pair(setting, channel)
        if found is None:
            return None
        source, target = found
        name = identifier(kind, channel)
        scale = setting.size(source)
        x_unit = power_of(setting.unit(source), power)
        parameters = [Parameter(name, 0.0, setting.rate(target, x_unit), description=title)]
        if width:
            parameters.append(
                Parameter(
                    f"{name}_width",
                    0.5 * scale,
                    setting.unit(source),
                    setting.limits(1e-3 * scale, 10.0 * scale, 1e-12),
                    f"scale of {source} at which it bends",
                )
            )

        def extend(model: MixedModel) -> MixedModel:
            return add_to_state(
                model,
                target,
                lambda v, own: own[0] * term(v[source], own[1:]),
                needs=(source,) if source in model.linear else (),
            )

        return Effect(
            kind,
            channel,
            "state",
            f"{title} of {source}" + ("" if source == target else f" on {target}"),
            f"{target}' = ... + dt * {name} * {formula.format(x=source)}",
            tuple(parameters),
            extend,
            probes=((0.3 * scale,), (scale,)) if width else ((),),
            look_alikes=look_alikes,
        )

    return make


def _coulomb(setting: Setting, channel: str) -> Effect | None:
    """Friction of constant size against the motion; it may stop the motion in a step, not reverse it."""
    found = pair(setting, channel)
    if found is None:
        return None
    source, target = found
    name = identifier("coulomb", channel)

    def term(v: Values, own: Sequence[Any]) -> Any:
        if source != target:
            return -own[0] * np.sign(v[source])
        most = v.dt * np.abs(own[0])
        return -np.sign(own[0]) * np.clip(v[source], -most, most) / v.dt

    def extend(model: MixedModel) -> MixedModel:
        return add_to_state(model, target, term, needs=(source,) if source in model.linear else ())

    return Effect(
        "coulomb",
        channel,
        "state",
        f"Coulomb friction of {source}" + ("" if source == target else f" on {target}"),
        f"{target}' = ... - dt * {name} * sign({source})",
        (Parameter(name, 0.0, setting.rate(target), description="friction per unit of inertia"),),
        extend,
        look_alikes={"drag": ODD, "stribeck": ODD, "deadzone": ODD},
    )


def _force(setting: Setting, channel: str) -> Effect | None:
    if channel not in setting.states:
        return None
    name = identifier("force", channel)

    def extend(model: MixedModel) -> MixedModel:
        return add_to_state(model, channel, lambda v, own: own[0])

    return Effect(
        "force",
        channel,
        "state",
        f"constant force on {channel}",
        f"{channel}' = ... + dt * {name}",
        (Parameter(name, 0.0, setting.rate(channel), description="constant rate"),),
        extend,
        look_alikes={
            "bias": "a sensor bias does not move the state",
            "step": "acts from one time on",
        },
    )


def _linear(setting: Setting, channel: str) -> Effect | None:
    """A state's own rate of decay or growth; one that the model estimates is not testable beside it."""
    if channel not in setting.states:
        return None
    name = identifier("linear", channel)

    def extend(model: MixedModel) -> MixedModel:
        if channel in model.linear:
            return add_linear_coupling(model, channel, channel)
        return add_to_state(model, channel, lambda v, own: own[0] * v[channel])

    return Effect(
        "linear",
        channel,
        "state",
        f"linear damping or growth of {channel}",
        f"{channel}' = ... + dt * {name} * {channel}",
        (Parameter(name, 0.0, "1/s", description="rate"),),
        extend,
        look_alikes={
            "drag": "grows faster than the state",
            "saturation": "acts on large values only",
            "deadzone": "acts on small values only",
        },
    )


def _coupling(setting: Setting, channel: str) -> Effect | None:
    found = pair(setting, channel)
    if found is None or found[0] == found[1]:
        return None
    source, target = found
    name = identifier("coupling", source, target)

    def extend(model: MixedModel) -> MixedModel:
        if source in model.linear:
            return add_linear_coupling(model, target, source)
        return add_to_state(model, target, lambda v, own: own[0] * v[source])

    return Effect(
        "coupling",
        channel,
        "state",
        f"coupling of {source} into {target}",
        f"{target}' = ... + dt * {name} * {source}",
        (Parameter(name, 0.0, setting.rate(target, setting.unit(source))),),
        extend,
        look_alikes={"cubic": "grows faster than the state", "gain": "acts on the reading only"},
    )


def _each_coupling(setting: Setting) -> Any:
    for source in setting.states:
        for target in setting.targets:
            if source != target:
                yield f"{source}->{target}"


KINDS: list[Kind] = [
    ("force", _force, each_state),
    (
        "quadratic",
        _static(
            "quadratic",
            "quadratic force",
            "{x}^2",
            lambda x, own: x * x,
            2,
            {"force": "is constant"},
        ),
        each_pair,
    ),
    (
        "cubic",
        _static(
            "cubic",
            "cubic stiffness",
            "{x}^3",
            lambda x, own: x**3,
            3,
            {"drag": ODD, "deadzone": ODD},
        ),
        each_pair,
    ),
    (
        "drag",
        _static(
            "drag",
            "quadratic drag",
            "-{x}|{x}|",
            lambda x, own: -x * np.abs(x),
            2,
            {"cubic": ODD, "coulomb": ODD},
        ),
        each_pair,
    ),
    ("coulomb", _coulomb, each_pair),
    (
        "stribeck",
        _static(
            "stribeck",
            "Stribeck friction",
            "-sign({x}) exp(-|{x}|/w)",
            lambda x, own: -np.sign(x) * np.exp(-np.abs(x) / own[0]),
            0,
            {"coulomb": "does not fade with speed"},
            width=True,
        ),
        each_pair,
    ),
    (
        "deadzone",
        _static(
            "deadzone",
            "dead zone",
            "clip({x}, -w, w)",
            lambda x, own: np.clip(x, -own[0], own[0]),
            1,
            {"coulomb": ODD, "saturation": ODD},
            width=True,
        ),
        each_pair,
    ),
    (
        "saturation",
        _static(
            "saturation",
            "saturation",
            "(|{x}| - w)+ sign({x})",
            lambda x, own: np.sign(x) * np.maximum(np.abs(x) - own[0], 0.0),
            1,
            {"cubic": ODD, "deadzone": ODD},
            width=True,
        ),
        each_pair,
    ),
    ("linear", _linear, each_state),
    ("coupling", _coupling, _each_coupling),
]
