"""Which of many effects a person asks about first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

FIRST_EFFECTS = 12  # effects that are listed; the rest is a click or an option away

# Kinds by how often they are met: friction, sensors, timing, limits, then noise and what happens once.
_KINDS = (
    "coulomb", "bias", "drag", "gain", "delay", "input-offset", "input-gain", "cubic", "lag", "input-deadzone",
    "saturation", "input-coulomb", "step", "heavy-tails", "drift", "harmonic", "input-saturation", "deadzone",
    "stribeck", "slow-sensor", "slow-input", "overflow", "play", "direct", "path", "extra-input",
    "parameter-step", "parameter-slope", "input-gain-step", "gain-step", "input-drag", "colored", "hysteresis",
    "boucwen", "cogging", "linear", "start",
)  # fmt: skip


def asked_first(effects: Sequence[str], n: int = FIRST_EFFECTS) -> list[str]:
    """At most ``n`` of the effects ``kind:place``, one of each common kind before a second one.

    Effects of a channel on itself come before those of one on another, such as ``drag:a->b``.
    """
    own_first = sorted(effects, key=lambda name: "->" in name)
    ranks: dict[str, tuple[int, int]] = {}
    seen: Counter[str] = Counter()
    for name in own_first:
        kind = name.partition(":")[0]
        ranks[name] = (seen[kind], _KINDS.index(kind) if kind in _KINDS else len(_KINDS))
        seen[kind] += 1
    return sorted(own_first, key=ranks.__getitem__)[:n]
