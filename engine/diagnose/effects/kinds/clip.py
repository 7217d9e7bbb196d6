"""Limits at which a signal is clipped: an upper one, a lower one, or both."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import Setting
from engine.statespace.model import Parameter

SHARES = (0.5, 0.8, 0.95)  # of the record within the limits the screen looks at


class Clip:
    """What of a signal is beyond ``<name>_limit``, a value on the signal's axis.

    ``<name>_side`` says on which side it clips: 1 above the limit, -1 below it, 0 on both sides, at the
    limit and at its mirror image about the zero. Own values: size, limit, side, zero where not known.
    """

    def __init__(self, setting: Setting, name: str, channel: str) -> None:
        origin = self.origin = Origin(setting, name, channel)
        low, high = setting.inside(channel)
        zero, away = setting.zero(channel), setting.distance(channel, SHARES[-1])
        self.name, begins = name, zero + setting.distance(channel, 0.7)
        bounds = setting.limits(min(low, zero - away), max(high, zero + away), -np.inf)
        own = (
            Parameter(name, 0.0, "1", (0.0, 1.0), "share of the excess that is lost"),
            Parameter(f"{name}_limit", begins, setting.unit(channel), bounds, "where it begins"),
            Parameter(f"{name}_side", 0.0, "1", (-1.0, 1.0), "1: above, -1: below, 0: both sides"),
        )
        lowest, highest = (setting.quantile(channel, q) for q in (1.0 - SHARES[-1], SHARES[-1]))
        both = [(zero + setting.distance(channel, share), 0.0) for share in SHARES]
        if not lowest < zero < highest:
            both = []  # it has no second side
        probes = [(*one, *origin.probe) for one in both]
        if origin.name is not None and both:
            # what clips on both sides ends at both limits, wherever it is most of the time
            middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
            probes += [(middle + share * half, 0.0, middle) for share in SHARES[1:]]
        # readings that are clipped end at their limit
        shares = (*SHARES[1:], 1.0) if channel in setting.model.outputs else SHARES[1:]
        above = [(setting.quantile(channel, share), 1.0) for share in shares]
        below = [(setting.quantile(channel, 1.0 - share), -1.0) for share in shares]
        probes += [(*one, *origin.probe) for one in (*above, *below)]
        members = origin.counted(*own) | {"probes": tuple(probes)}
        # of an :class:`Effect` whose size is the share of the excess that is lost
        self.members = {**members, "held": (f"{name}_side", *members["held"])}

    def excess(self, x: Any, own: Sequence[Any]) -> Any:
        """How far x is beyond the limit, with its sign; zero inside."""
        limit, side, zero = own[1], own[2], self.origin.of(own)
        above, below = np.maximum(x - limit, 0.0), np.minimum(x - limit, 0.0)
        both = np.sign(x - zero) * np.maximum(np.abs(x - zero) - np.abs(limit - zero), 0.0)
        return np.where(np.greater(side, 0.5), above, np.where(np.less(side, -0.5), below, both))

    def text(self, x: str) -> str:
        """The excess, for an equation."""
        return f"(what of {x} is beyond {self.name}_limit, on {self.name}_side)"
