"""The ways through a function: operations from one condition to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from engine.statespace.recorded.numbers import Operation, Recorder
from engine.statespace.rows import Array, Indices


class NotByRowsError(Exception):
    """A function cannot be recorded; only here, where the numbers of these rows are why, or not at all."""

    def __init__(self, here: bool) -> None:
        super().__init__("written so that it cannot be evaluated for many rows")
        self.here = here


@dataclass(frozen=True)
class Output:
    """One result: ``shape``, the ``fixed`` entries (n,), and pairs (entry, number of a value) of the others."""

    shape: tuple[int, ...]
    fixed: Array
    moving: Sequence[tuple[int, int]]


@dataclass(frozen=True)
class Part:
    """Rows that take one path: its ``outputs`` with the values of their moving entries."""

    at: slice | Indices
    outputs: Sequence[Output | None]
    values: Sequence[Sequence[Any]]


@dataclass
class Path:
    """Operations up to a condition or the end, where the outputs are known."""

    operations: list[Operation] = field(default_factory=list)
    constants: dict[int, Any] = field(default_factory=dict)
    condition: int | None = None
    then: dict[bool, Path] = field(default_factory=dict)
    outputs: Sequence[Output | None] = ()


def chain(recorder: Recorder, outputs: Sequence[Output | None]) -> Path:
    """What was recorded as paths one after the other."""
    first = path = Path(constants=recorder.constants)
    for step in recorder.done:
        if isinstance(step, Operation):
            path.operations.append(step)
        else:
            path.condition = step.of
            path.then[step.held] = path = Path()
    path.outputs = outputs
    return first


def graft(known: Path, new: Path) -> None:
    """Add a path to those that begin as it does."""
    while True:
        same = known.condition == new.condition and len(known.operations) == len(new.operations)
        if known.condition is None and same:
            return  # it is known already
        if known.condition is None or not same:
            # the same conditions did not lead to the same operations
            raise NotByRowsError(here=False)
        ((held, rest),) = new.then.items()
        if held not in known.then:
            rest.constants = new.constants | rest.constants
            known.then[held] = rest
            return
        rest.constants = new.constants | rest.constants
        known, new = known.then[held], rest
