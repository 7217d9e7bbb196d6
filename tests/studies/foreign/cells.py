"""The cells: system, level of the sensors' noise, fault."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from tests.studies.foreign.plant import LEVELS, Fault
from tests.studies.foreign.systems import SYSTEMS
from tests.studies.foreign.written import System

CLEAN = "clean"
NO_TRACE = ("pendulum:root@ordinary",)  # no size tried gave a likelihood ratio: nothing to be found


@dataclass(frozen=True)
class Cell:
    """One cell; ``fault`` is the short name of a fault, or ``clean``."""

    system: str
    fault: str
    level: str = "ordinary"

    @property
    def name(self) -> str:
        """``system:fault@level``."""
        return f"{self.system}:{self.fault}@{self.level}"

    @property
    def plan(self) -> System:
        """Its system."""
        return SYSTEMS[self.system]

    @property
    def what(self) -> Fault | None:
        """Its fault, None where clean."""
        return None if self.fault == CLEAN else self.plan.faults[self.fault]

    @property
    def hidden(self) -> str:
        """The catalogue's name of what is hidden, ``outside:kind``, or "" where clean."""
        return "" if self.what is None else self.what.name

    @property
    def outside(self) -> bool:
        """Whether no kind of the catalogue describes it."""
        return self.what is not None and self.what.outside


@cache
def _cells(euler: bool) -> tuple[Cell, ...]:
    """Every fault at one level: its own, or the levels by turns."""
    out = []
    planned = [
        (name, key, fault)
        for name, system in SYSTEMS.items()
        if system.euler is euler
        for key, fault in system.faults.items()
    ]
    for turn, (name, key, fault) in enumerate(planned):
        out.append(Cell(name, key, fault.level or LEVELS[turn % 2]))
    return tuple(cell for cell in out if cell.name not in NO_TRACE)


def inside(euler: bool = False) -> list[Cell]:
    """Cells whose fault is a kind of the catalogue."""
    return [c for c in _cells(euler) if not c.outside]


def unlisted(euler: bool = False) -> list[Cell]:
    """Cells whose fault is not."""
    return [c for c in _cells(euler) if c.outside]


def clean(euler: bool = False) -> list[Cell]:
    """Nothing hidden, at both levels."""
    return [
        Cell(name, CLEAN, level)
        for level in LEVELS
        for name, system in SYSTEMS.items()
        if system.euler is euler
    ]


def every_cell() -> list[Cell]:
    """All of them."""
    return [c for euler in (False, True) for c in (*clean(euler), *inside(euler), *unlisted(euler))]


def cell_of(text: str) -> Cell:
    """``system:fault`` or ``system:fault@level``; without a level the planned one, or both' first.

    Raises ValueError naming what there is.
    """
    place, _, level = text.partition("@")
    system, _, fault = place.partition(":")
    if system not in SYSTEMS:
        raise ValueError(f"no system '{system}'; there are {', '.join(SYSTEMS)}")
    known = [CLEAN, *SYSTEMS[system].faults]
    if fault not in known:
        raise ValueError(f"no fault '{fault}' of '{system}'; there are {', '.join(known)}")
    if level and level not in LEVELS:
        raise ValueError(f"no level '{level}'; there are {', '.join(LEVELS)}")
    planned = {(c.system, c.fault): c.level for c in (*_cells(False), *_cells(True))}
    return Cell(system, fault, level or planned.get((system, fault), LEVELS[0]))
