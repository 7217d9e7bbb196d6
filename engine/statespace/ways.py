"""The ways that a function of a model takes through its conditions, and all that were met as one list.

Where ways part, both sides are calculated, and for each row what its own side says is taken: a filter that goes
through a record need not stop where an input switches. Of a condition that came out the same on all ways so far
the list says that it must.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from engine.statespace.evaluation import ModelFunction, line_of
from engine.statespace.recorded.numbers import (
    LIMIT,
    Condition,
    Operation,
    Recorder,
    UntraceableError,
    check_finite,
)
from engine.statespace.recorded.of_python import Searched
from engine.statespace.recorded.paths import Output
from engine.statespace.recorded.program import outputs_of, traced_arguments
from engine.statespace.recorded.tables import At
from engine.statespace.rows import Array

RESULTS = 3


@dataclass(frozen=True)
class Way:
    """Operations and conditions in their order, and the results.

    ``known`` are constants by their numbers, ``booleans`` the numbers of values that are true or not.
    """

    steps: Sequence[Operation | Condition]
    outputs: Sequence[Output]
    known: dict[int, Any]
    booleans: frozenset[int]


class UnrecordedError(Exception):
    """A function that no list of operations tells, with the place in a user's file, "" where unknown."""


class PartedError(Exception):
    """Ways that part without a condition: the function is not the same each time."""


def record_way(function: ModelFunction, row: Sequence[Array], theta: Any) -> Way:
    """The way of a row: states (na,), inputs (nu,), time and step (2,), parameters. Raises UnrecordedError."""
    a, u, *_ = row
    recorder = Recorder()
    numbers = [recorder.number(float(x)) for x in np.concatenate(row)]
    before = UntraceableError.raised()
    try:
        with recorder, np.errstate(all="ignore"):
            given = traced_arguments(numbers, len(a), len(u), theta)
            outputs = outputs_of(function(*given), function.shapes, recorder)
    except (UntraceableError, Exception) as error:
        raise UnrecordedError(line_of(error)) from error
    if recorder.failed is not None or UntraceableError.raised() != before:
        raise UnrecordedError("")  # it caught that
    if len(outputs) != RESULTS or any(output is None for output in outputs):
        raise UnrecordedError("")
    own = [output for output in outputs if output is not None]
    return Way(recorder.done, own, recorder.constants, frozenset(recorder.booleans))


def merged(ways: Sequence[Way], arguments: int) -> Way:
    """All of them as one, of a function with so many numbers as arguments. Raises PartedError."""
    if len(ways) == 1:
        return ways[0]
    into = _Merged(arguments)
    outputs = into.follow(ways, 0, {i: i for i in range(arguments)}, None)
    return Way(into.steps, outputs, into.known, frozenset(into.booleans))


def parted(way: Way, rows: Sequence[Array]) -> int | None:
    """The first of rows, by their arguments (M,) each, of which a condition says otherwise; None where none."""
    if not any(isinstance(step, Condition) for step in way.steps):
        return None
    values: dict[int, Any] = {**way.known, **dict(enumerate(rows))}
    with np.errstate(all="ignore"):
        for step in way.steps:
            if isinstance(step, Condition):
                otherwise = np.asarray(values[step.of], dtype=bool) != step.held
                if otherwise.any():
                    return int(np.argmax(otherwise))
                continue
            try:
                values[step.out] = step.function(*[values[i] for i in step.of])
            except (ArithmeticError, ValueError):
                return None
    return None


@dataclass
class _Merged:
    """The list as far as it has been made, of ``values`` so many numbers."""

    values: int
    steps: list[Operation | Condition] = field(default_factory=list)
    known: dict[int, Any] = field(default_factory=dict)
    booleans: set[int] = field(default_factory=set)

    def follow(
        self, ways: Sequence[Way], at: int, names: dict[int, int], side: int | None
    ) -> Sequence[Output]:
        """Add what ways do from a step on; ``names`` are the list's numbers of theirs.

        For rows of which the value ``side`` is true, if it is not for all.
        """
        names = dict(names)
        while at < len(ways[0].steps):
            step = ways[0].steps[at]
            if not all(at < len(way.steps) and _alike(ways[0], way, at) for way in ways[1:]):
                raise PartedError
            if isinstance(step, Operation):
                self._do(step, ways[0], names, side)
            elif all(way.steps[at] == step for way in ways):
                self._must(names[step.of], step.held, side)
            else:
                return self._choice(ways, at, names, side)
            at += 1
        if any(at < len(way.steps) for way in ways):
            raise PartedError
        return [
            Output(one.shape, one.fixed, [(entry, names[i]) for entry, i in one.moving])
            for one in ways[0].outputs
        ]

    def _do(self, step: Operation, way: Way, names: dict[int, int], side: int | None) -> None:
        for i in step.of:
            if i not in names:
                names[i] = self._constant(way.known[i])
        of = [names[i] for i in step.of]
        if side is not None:  # what fails at a number that only rows of the other side have
            count = step.function.keys if isinstance(step.function, At) else 1
            if step.function is check_finite or isinstance(step.function, At | Searched):
                zero = self._constant(0.0)
                of[:count] = [self._add(np.where, side, i, zero) for i in of[:count]]
        names[step.out] = self._add(step.function, *of)
        if step.out in way.booleans:
            self.booleans.add(names[step.out])

    def _must(self, of: int, held: bool, side: int | None) -> None:
        if side is None:
            self.steps.append(Condition(of, held))
            return
        otherwise = self._truth(np.logical_not, of) if held else of
        self.steps.append(Condition(self._truth(np.logical_and, side, otherwise), held=False))

    def _choice(
        self, ways: Sequence[Way], at: int, names: dict[int, int], side: int | None
    ) -> Sequence[Output]:
        condition = names[ways[0].steps[at].of]  # type: ignore[index]
        found = []
        for held in (True, False):
            own = condition if held else self._truth(np.logical_not, condition)
            own = own if side is None else self._truth(np.logical_and, side, own)
            there = [way for way in ways if way.steps[at].held == held]  # type: ignore[union-attr]
            found.append(self.follow(there, at + 1, names, own))
        return [self._chosen(condition, *pair) for pair in zip(*found, strict=True)]

    def _chosen(self, condition: int, true: Output, false: Output) -> Output:
        """One result of both sides."""
        if true.shape != false.shape:
            raise PartedError
        moving = []
        sides = [dict(one.moving) for one in (true, false)]
        for entry, fixed in enumerate(zip(true.fixed.tolist(), false.fixed.tolist(), strict=True)):
            own = [side.get(entry) for side in sides]
            if own[0] != own[1] or (own[0] is None and fixed[0] != fixed[1]):
                x, y = (
                    self._constant(value) if i is None else i
                    for i, value in zip(own, fixed, strict=True)
                )
                moving.append((entry, self._add(np.where, condition, x, y)))
            elif own[0] is not None:
                moving.append((entry, own[0]))
        return Output(true.shape, true.fixed, moving)

    def _constant(self, value: Any) -> int:
        self.values += 1
        self.known[self.values - 1] = value
        return self.values - 1

    def _add(self, function: Callable[..., Any], *of: int) -> int:
        if len(self.steps) >= LIMIT:
            raise PartedError
        self.values += 1
        self.steps.append(Operation(function, of, self.values - 1))
        return self.values - 1

    def _truth(self, function: Callable[..., Any], *of: int) -> int:
        self.booleans.add(self._add(function, *of))
        return self.values - 1


def _alike(one: Way, other: Way, at: int) -> bool:
    """Whether two ways do the same there; a condition may turn out otherwise."""
    step, others = one.steps[at], other.steps[at]
    if isinstance(step, Condition) or isinstance(others, Condition):
        return type(step) is type(others) and step.of == others.of
    if step[1:] != others[1:] or not _does_the_same(step.function, others.function):
        return False
    pairs = ((one.known[i], other.known[i]) for i in step.of if i in one.known)
    return all(x is y or np.array_equal(x, y) for x, y in pairs)


def _does_the_same(one: Any, other: Any) -> bool:
    """Whether two are the same function, or were made alike at the same place of two recordings."""
    if one is other:
        return True
    if type(one) is not type(other) or isinstance(one, np.ufunc):
        return False
    return getattr(one, "__code__", None) is getattr(other, "__code__", None)
