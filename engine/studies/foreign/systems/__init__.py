"""Ten plants, each with the model that a user would write down for it."""

from __future__ import annotations

from dataclasses import replace

from engine.studies.foreign.systems import pendulum, room, tanks
from engine.studies.foreign.written import System

EULER = {"step", "drag", "leak", "bias"}  # faults that are tried on Euler's bases too


def _euler(system: System, base: object) -> System:
    return system


SYSTEMS: dict[str, System] = {s.name: s for s in (room.SYSTEM, pendulum.SYSTEM, tanks.SYSTEM)}
