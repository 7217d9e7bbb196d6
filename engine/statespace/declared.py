"""Checks of what a model declares: its name, channels and parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from keyword import iskeyword
from typing import Any

from engine.errors import ModelError
from engine.statespace.base import Parameter

NUMBERS = ("default", "scale", "lower bound", "upper bound")


def check_declared(
    name: str, channels: Mapping[str, Any], states: Sequence[str], parameters: Sequence[Any]
) -> None:
    """Raise ModelError unless names, units, bounds and defaults can be used.

    ``channels`` maps what they are ("inputs", ...) to {name: unit}; ``states`` says which are states.
    """
    if not name or not isinstance(name, str):
        raise ModelError("a model needs a name")
    for what, group in channels.items():
        if not hasattr(group, "items"):
            raise ModelError(f"model '{name}': {what} must map names to units, like {{'v': 'm/s'}}")
    if not channels["outputs"]:
        raise ModelError(f"model '{name}' has no outputs; name at least one")
    if not any(channels[what] for what in states):
        raise ModelError(f"model '{name}' has no states; name {' or '.join(states)}")
    names = [one for group in channels.values() for one in group]
    doubled = sorted({one for one in names if names.count(one) > 1})
    if doubled:
        raise ModelError(f"model '{name}' uses the channel name '{doubled[0]}' twice")
    for p in parameters:
        if not isinstance(p, Parameter):
            raise ModelError(f"model '{name}': {p!r} among its parameters is no engine.Parameter")
    known = [p.name for p in parameters]
    for p in parameters:
        if (
            not isinstance(p.name, str)
            or not p.name.isidentifier()
            or p.name.startswith("_")
            or iskeyword(p.name)
        ):
            raise ModelError(
                f"model '{name}': the parameter name '{p.name}' cannot be used: a Python identifier is needed "
                "that is no keyword and does not begin with an underscore"
            )
        for what, value in zip(NUMBERS, (p.default, p.scale, *p.bounds), strict=True):
            if isinstance(value, str) or not hasattr(value, "__float__"):
                raise ModelError(
                    f"model '{name}', parameter '{p.name}': its {what} is {value!r}; a number is needed"
                )
        if known.count(p.name) > 1:
            raise ModelError(f"model '{name}' has two parameters named '{p.name}'")
        if not p.bounds[0] < p.bounds[1]:
            raise ModelError(
                f"model '{name}', parameter '{p.name}': bounds {p.bounds} are not (low, high)"
            )
        if not p.bounds[0] <= p.default <= p.bounds[1]:
            raise ModelError(
                f"model '{name}', parameter '{p.name}': default {p.default:g} is outside its bounds "
                f"{p.bounds}"
            )
