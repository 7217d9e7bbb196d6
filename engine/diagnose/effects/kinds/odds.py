"""What nothing does at a channel, as far as its unit tells: any other effect is likelier there beforehand.

A unit that nobody knows tells nothing.
"""

from __future__ import annotations

from engine.diagnose.effects.setting import Setting
from engine.units import SECOND, meanings

TEMPERATURES = ({"K": 1.0}, {"degC": 1.0}, {"degF": 1.0})


def nothing_rubs(setting: Setting, state: str) -> bool:
    """Whether a state is not the speed of anything: dry friction needs one."""
    kinds = [kind for _, kind in meanings(setting.unit(state))]
    known = any(kinds) and not setting.is_rate(state)
    return known and all(kind.get(SECOND) != -1.0 for kind in kinds)


def nothing_spills(setting: Setting, state: str) -> bool:
    """Whether a state is a temperature, of which no store is full."""
    kinds = [kind for _, kind in meanings(setting.unit(state))]
    return bool(kinds) and all(kind in TEMPERATURES for kind in kinds)


def only_drives(setting: Setting, source: str) -> bool:
    """Whether an input is what drives the system, and no condition on which a parameter may depend.

    A wind that the model makes no other use of is one, and a temperature beside one that is a state. What a
    friction has to do with the voltage of its drive is that both are large at once.
    """
    surroundings = setting.model.inputs[source] in setting.states.values()
    _, moved = setting.feeds
    return not surroundings and bool(moved[:, list(setting.model.inputs).index(source)].any())
