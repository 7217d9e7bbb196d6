"""Cogging: a force that repeats itself along a position, as of magnets, teeth or a ball screw."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_pairs
from engine.diagnose.effects.effect import Effect, Values, add_to_state
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Parameter

# Periods over the way travelled at which the screen looks; half of one more over the way is another force.
CYCLES = np.arange(2.0, 24.5, 0.5)
LEAST_CYCLES = 2.0  # with fewer nothing repeats itself: any bend with an offset looks like it
MOST_CYCLES = 50.0
WAY = 0.02  # share of the record on either side of the way travelled


def _cogging(setting: Setting, channel: str, name: str, source: str, target: str) -> Effect | None:
    """size sin(2 pi (x - o) / p); the offset o takes the place of a phase and of a zero."""
    if source == target:
        return None
    unit = setting.unit(source)
    low, middle, high = (setting.quantile(source, q) for q in (WAY, 0.5, 1.0 - WAY))
    way = high - low if high > low else setting.size(source)
    periods = [way / float(cycles) for cycles in CYCLES]
    of_period = setting.limits(way / MOST_CYCLES, way / LEAST_CYCLES)
    of_offset = setting.limits(middle - 2.0 * way, middle + 2.0 * way, -np.inf)

    def term(v: Values, own: Sequence[Any]) -> Any:
        return own[0] * np.sin(2.0 * np.pi * (v[source] - own[2]) / own[1])

    return Effect(
        "cogging",
        channel,
        "state",
        f"cogging: a force on {target} that repeats itself along {source}",
        f"{target}' = ... + dt * {name} * sin(2 pi ({source} - {name}_offset) / {name}_period)",
        (
            Parameter(name, 0.0, setting.rate(target), description="amplitude"),
            Parameter(
                f"{name}_period", periods[0], unit, of_period, "way after which it repeats itself"
            ),
            Parameter(f"{name}_offset", middle, unit, of_offset, "where it is zero"),
        ),
        lambda model: add_to_state(model, target, term, (source,)),
        probes=tuple((p, middle + shift * p) for p in periods for shift in (0.0, 0.25)),
        look_alikes={
            "harmonic": "repeats itself in time, not along the way",
            "cubic": "does not repeat itself",
        },
        traits=Traits(suits="position"),
    )


def _each_position(setting: Setting) -> list[str]:
    """From a position to its rate."""
    pairs = product(setting.states, setting.targets)
    return [f"{position}->{rate}" for position, rate in pairs if setting.is_rate_of(rate, position)]


KINDS: list[Kind] = [at_pairs("cogging", _cogging, _each_position)]
