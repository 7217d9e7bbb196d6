"""Ten plants, each with the model that a user would write down for it; two of them with Euler's rule, too."""

from __future__ import annotations

from dataclasses import replace

from tests.studies.foreign.systems import (
    battery,
    mixer,
    motor,
    pendulum,
    reactor,
    room,
    ship,
    spring,
    tanks,
    vehicle,
)
from tests.studies.foreign.written import System

SYSTEMS: dict[str, System] = {
    system.name: system
    for system in (
        room.SYSTEM,
        motor.SYSTEM,
        battery.SYSTEM,
        pendulum.SYSTEM,
        vehicle.SYSTEM,
        tanks.SYSTEM,
        mixer.SYSTEM,
        spring.SYSTEM,
        reactor.SYSTEM,
        ship.SYSTEM,
    )
}
SYSTEMS |= {
    name: replace(
        system,
        base=base,
        faults={key: system.faults[key] for key in faults},
        euler=True,
    )
    for name, system, base, faults in (
        ("pendulum-euler", pendulum.SYSTEM, pendulum.euler_base, ("drag", "bias")),
        ("tanks-euler", tanks.SYSTEM, tanks.euler_base, ("leak", "bias")),
    )
}
