"""What nothing does at a channel, as far as its unit tells: any other effect is likelier there beforehand.

A unit that nobody knows tells nothing.
"""

from __future__ import annotations

from engine.diagnose.effects.setting import Setting
from engine.units import SECOND, meanings, same_kind

TEMPERATURES = ({"K": 1.0}, {"degC": 1.0}, {"degF": 1.0})


def nothing_rubs(setting: Setting, state: str) -> bool:
    """Whether a state is not the speed of anything: dry friction needs one."""
    kinds = [kind for _, kind in meanings(setting.unit(state))]
    known = any(kinds) and not setting.is_rate(state)
    return known and all(kind.get(SECOND) != -1.0 for kind in kinds)


def nothing_spills(setting: Setting, state: str) -> bool:
    """Whether a state is a temperature, of which no store is full."""
    return _is_temperature(setting.unit(state))


def only_drives(setting: Setting, source: str) -> bool:
    """Whether an input is what drives the system, and no condition on which a parameter may depend.

    A wind that the model makes no other use of is one, and a temperature beside one that is a state, however it
    is counted. What a friction has to do with the voltage of its drive is that both are large at once.
    """
    unit = setting.unit(source)
    if not any(kind for _, kind in meanings(unit)):
        return False
    if any(_measure_the_same(unit, own) for own in setting.states.values()):
        return False
    _, moved = setting.feeds
    return bool(moved[:, list(setting.model.inputs).index(source)].any())


def _measure_the_same(one: str, other: str) -> bool:
    return same_kind(one, other) or (_is_temperature(one) and _is_temperature(other))


def _is_temperature(unit: str) -> bool:
    kinds = [kind for _, kind in meanings(unit)]
    return bool(kinds) and all(kind in TEMPERATURES for kind in kinds)
