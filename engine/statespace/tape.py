"""What a model's function calculates as a tape, for filters that call it at every time step.

The function is recorded on one row of each way through it (:mod:`engine.statespace.ways`), extensions of it
and the model extended together. What depends on parameters alone is found once for a whole record, by NumPy;
the rest are lines of :func:`engine.kernels.tape.go_through`. A function with an operation that the kernel does
not know has no tape. Conditions on which no ways part must turn out as they did: else the tape is left.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.special
from numpy.typing import NDArray

from engine.kernels.tape import CODES
from engine.statespace.discretization import checked_step
from engine.statespace.recorded.arrays import Entry, OfArrays
from engine.statespace.recorded.numbers import (
    RAISING,
    Condition,
    Operation,
    check_finite,
)
from engine.statespace.recorded.of_numpy import Between
from engine.statespace.recorded.of_python import Searched
from engine.statespace.recorded.paths import Output
from engine.statespace.recorded.tables import At
from engine.statespace.rows import Array
from engine.statespace.traced_step import over_a_step
from engine.statespace.ways import Way

CODE_OF = {getattr(np, name): code for name, code in CODES.items() if hasattr(np, name)} | {
    np.fabs: CODES["absolute"],
    np.float_power: CODES["power"],
    scipy.special.erf: CODES["erf"],
    scipy.special.expit: CODES["expit"],
    check_finite: CODES["check_finite"],
}
OPERANDS = 3
POINTS = 400  # of an interpolation or a table, each of which is a row of the work space
STEPS = (over_a_step, checked_step)  # functions of whole matrices that the kernel knows
SQUARE = 2.0
OF_BOOLEANS = {  # the same as these, of numbers that are true or not
    np.bitwise_and: CODES["logical_and"],
    np.bitwise_or: CODES["logical_or"],
    np.bitwise_xor: CODES["not_equal"],
    np.invert: CODES["logical_not"],
}


class LeftError(Exception):
    """These parameters take another way through the function than the one on the tape."""


@dataclass(frozen=True)
class Tape:
    """What a function does on one ``way``, or on several merged.

    ``lengths`` of a, u and theta: the arguments are numbered a, u, t, dt, theta.
    """

    lengths: tuple[int, int, int]
    way: Way
    plans: dict[Any, Any] = field(default_factory=dict)  # found once, see :func:`_plan`

    @property
    def outputs(self) -> Sequence[Output]:
        """The results."""
        return self.way.outputs


@dataclass(frozen=True)
class Lines:
    """A tape for rows of given parameters, as :func:`engine.kernels.tape.evaluate` takes it.

    The ``codes`` (n, 5), the ``links`` (k, .) of those that take matrices, the work ``space`` (., M), and the
    three ``results``, flat (1 or M, .), which have all that no state, input or time changes (one row where the
    rows do not differ); ``places`` (., 2) are their other entries with the rows of the space. The ``columns``
    (T, .) count as further inputs of the record.
    """

    codes: NDArray[np.int64]
    links: NDArray[np.int64]
    space: Array
    places: tuple[NDArray[np.int64], ...]
    results: tuple[Array, ...]
    na: int
    raises: bool  # whether a call may fail where this makes numbers that are not finite
    columns: Array

    @property
    def points(self) -> Array:
        """The states a (M, na) of the last call."""
        return np.ascontiguousarray(self.space[: self.na].T)

    @property
    def more(self) -> int:
        """How many columns there are."""
        return len(self.columns.T)


def lines_of(
    tape: Tape, thetas: Array, copies: int, dt: float | None, record: Sequence[Array]
) -> Lines | None:
    """The lines for K parameter vectors (K, n), ``copies`` rows each; ``dt`` where all steps have it.

    ``record`` are inputs (T, nu), times and steps (T,). None where the kernel does not know an operation. What
    inputs and times alone tell may be any. Raises LeftError.
    """
    known, rest, outputs = _of_parameters(tape, thetas, dt)
    if outputs is not tape.outputs:
        tape = _of_one_side(tape, rest, outputs)
    found = _lines(tape, known, rest, {}, len(thetas), copies)
    if found is None:
        columns, left = _of_record(tape, known, rest, record)
        if columns:
            found = _lines(tape, known, left, columns, len(thetas), copies)
    return found


def _lines(
    tape: Tape,
    known: dict[int, Any],
    rest: Sequence[Operation | Condition],
    columns: dict[int, Array],
    K: int,
    copies: int,
) -> Lines | None:
    plan = _plan(tape, known, rest, columns)
    if plan is None:
        return None
    rows, results = K * copies, list[Array]()
    for output, (fixed, common) in zip(tape.outputs, plan.outputs, strict=True):
        out = np.tile(output.fixed, (1 if common else rows, 1))
        for entry, i in fixed:
            out[:, entry] = np.repeat(known[i], copies) if np.ndim(known[i]) else known[i]
        results.append(out)
    work = np.zeros((plan.size, rows))
    for i, slot in plan.filled:
        value = known[i] if i in known else plan.numbers[i]
        work[slot] = np.repeat(value, copies) if np.ndim(value) else value
    own = np.array([*columns.values()]).T if columns else np.empty((0, 0))
    na = tape.lengths[0]
    given = plan.codes, plan.links, work, plan.places, tuple(results)
    return Lines(*given, na, plan.raises, own)


@dataclass(frozen=True)
class _Plan:
    """The lines of a tape but for what parameters and rows they are for.

    ``filled`` are (value, row) of the work space of ``size`` rows, of values known from parameters and
    ``numbers``; ``outputs`` are pairs (entry, value) that are known, and whether a result is common to all
    rows. The others as :class:`Lines` has them.
    """

    codes: NDArray[np.int64]
    links: NDArray[np.int64]
    places: tuple[NDArray[np.int64], ...]
    raises: bool
    size: int
    filled: Sequence[tuple[int, int]]
    numbers: dict[int, float]
    outputs: Sequence[tuple[Sequence[tuple[int, int]], bool]]


def _plan(
    tape: Tape,
    known: dict[int, Any],
    rest: Sequence[Operation | Condition],
    columns: dict[int, Array],
) -> _Plan | None:
    """The lines, made once for all parameters that differ in the same places; None where there are none."""
    arrays = ((i, value) for i, value in known.items() if isinstance(value, np.ndarray))
    varied = frozenset(i for i, value in arrays if value.ndim)
    steps = (one for one in rest if isinstance(one, Operation))
    powers = [one.of[1] for one in steps if _ufunc(one) is np.power]
    squares = tuple(_squares(known, i) for i in powers)
    key = frozenset(known), varied, squares, tuple(columns)
    if key not in tape.plans:
        tape.plans[key] = _planned(tape, dict(known), rest, columns, varied)
    found: _Plan | None = tape.plans[key]
    return found


def _planned(
    tape: Tape,
    known: dict[int, Any],
    rest: Sequence[Operation | Condition],
    columns: dict[int, Array],
    varied: frozenset[int],
) -> _Plan | None:
    space = _Space(tape, known, rest, columns)
    codes = []
    for i, step in enumerate(rest):
        if isinstance(step, Operation) and isinstance(step.function, Entry):
            if step.of[0] not in space.matrices:
                return None
            space.slots[step.out] = space.matrices[step.of[0]] + step.function.place
            continue
        codes.append(space.line(i, step))
    if not all(codes):
        return None
    of_rows = _of_rows(tape, varied, rest)
    outputs = list[tuple[list[tuple[int, int]], bool]]()
    places = list[NDArray[np.int64]]()
    for output in tape.outputs:
        moving = [(entry, space.slots[i]) for entry, i in output.moving if i not in known]
        fixed = [(entry, i) for entry, i in output.moving if i in known]
        common = bool(outputs) and of_rows.isdisjoint(i for _, i in output.moving)
        outputs.append((fixed, common))
        places.append(np.array(moving, dtype=np.int64).reshape(-1, 2))
    functions = [step.function for step in rest if isinstance(step, Operation)]
    raises = any(
        one in RAISING or one is check_finite or isinstance(one, Searched | At) or _checked(one)
        for one in functions
    )
    width = max(map(len, space.links), default=1)
    links = np.zeros((len(space.links), width), dtype=np.int64)
    for link, entries in zip(links, space.links, strict=True):
        link[: len(entries)] = entries
    lines = np.array(codes, dtype=np.int64).reshape(-1, 5)
    numbers = {i: known[i] for i, _ in space.filled if i < 0}
    return _Plan(lines, links, tuple(places), raises, space.size, space.filled, numbers, outputs)


def _of_parameters(
    tape: Tape, thetas: Array, dt: float | None
) -> tuple[dict[int, Any], list[Operation | Condition], Sequence[Output]]:
    """The values that depend on parameters alone, numbers or (K,), and the operations that are left.

    And the results, of one side only where these parameters decide for all rows which is taken.
    """
    na, nu, _ = tape.lengths
    known = dict(tape.way.known)
    for i, column in enumerate(thetas.T, na + nu + 2):
        known[i] = column if (column != column[0]).any() else float(column[0])
    if dt is not None:
        known[na + nu + 1] = dt
    rest: list[Operation | Condition] = []
    taken: dict[int, int] = {}  # of two sides, by the number of the choice
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        for step in tape.way.steps:
            if isinstance(step, Condition):
                of = taken.get(step.of, step.of)
                if of not in known:
                    rest.append(Condition(of, step.held))
                elif (np.asarray(known[of], dtype=bool) != step.held).any():
                    raise LeftError
                continue
            one = step
            if taken and not taken.keys().isdisjoint(step.of):
                one = step._replace(of=tuple(taken.get(i, i) for i in step.of))
            if all(i in known for i in one.of):
                try:
                    known[one.out] = one.function(*[known[i] for i in one.of])
                except (ArithmeticError, ValueError) as error:
                    raise LeftError from error
            elif one.function is np.where and np.ndim(known.get(one.of[0], thetas)) == 0:
                taken[one.out] = one.of[1] if known[one.of[0]] else one.of[2]
            else:
                rest.append(one)
    outputs = tape.outputs
    if taken:
        outputs = [
            Output(one.shape, one.fixed, [(entry, taken.get(i, i)) for entry, i in one.moving])
            for one in outputs
        ]
    return known, _needed(rest, outputs), outputs


def _of_one_side(
    tape: Tape, rest: Sequence[Operation | Condition], outputs: Sequence[Output]
) -> Tape:
    """The tape of what parameters leave of it, kept with its own lines for each such side."""
    key = tuple((step.of, step.out if isinstance(step, Operation) else -1) for step in rest)
    if key not in tape.plans:
        tape.plans[key] = replace(tape, way=replace(tape.way, outputs=outputs), plans={})
    found: Tape = tape.plans[key]
    return found


def _of_record(
    tape: Tape,
    known: dict[int, Any],
    rest: Sequence[Operation | Condition],
    record: Sequence[Array],
) -> tuple[dict[int, Array], list[Operation | Condition]]:
    """Values (T,) that depend on inputs and times alone and are used, and the operations that are left."""
    na, nu, _ = tape.lengths
    u, t, dt = record
    values: dict[int, Any] = {i: value for i, value in known.items() if np.isscalar(value)}
    steps = np.append(dt[:-1], dt[-2:-1])  # the last has no meaning
    given = [*u.T, t, *([] if na + nu + 1 in known else [steps])]
    values |= dict(enumerate(given, na))
    left: list[Operation | Condition] = []
    try:
        with np.errstate(all="ignore"):
            for step in rest:
                if isinstance(step, Operation) and all(i in values for i in step.of):
                    values[step.out] = step.function(*[values[i] for i in step.of])
                else:
                    left.append(step)
    except (ArithmeticError, ValueError):
        return {}, left
    used = {i for step in left for i in _operands(step)}
    used |= {i for output in tape.outputs for _, i in output.moving}
    made = sorted(i for i in used & values.keys() if i not in known and i >= na + nu + 2)
    return {i: np.broadcast_to(np.asarray(values[i], dtype=float), t.shape) for i in made}, left


def _of_rows(
    tape: Tape, of_theta: Iterable[int], rest: Sequence[Operation | Condition]
) -> set[int]:
    """What differs from row to row: of states, or of parameters that do."""
    varied = {*range(tape.lengths[0]), *of_theta}
    for step in rest:
        if isinstance(step, Operation) and not varied.isdisjoint(step.of):
            varied.add(step.out)
    return varied


def _checked(function: Any) -> bool:
    return isinstance(function, OfArrays) and function.function is checked_step


def _needed(
    steps: Sequence[Operation | Condition], outputs: Sequence[Output]
) -> list[Operation | Condition]:
    """The operations whose results are used, and the conditions."""
    wanted = {i for output in outputs for _, i in output.moving}
    out: list[Operation | Condition] = []
    for step in reversed(steps):
        if isinstance(step, Condition):
            wanted.add(step.of)
            out.append(step)
        elif step.out in wanted or step.function is check_finite:
            wanted.update(step.of)
            out.append(step)
    return out[::-1]


def _ufunc(step: Operation) -> Any:
    return getattr(step.function, "ufunc", step.function)


def _squares(known: dict[int, Any], exponent: int) -> bool:
    value = known.get(exponent)
    return isinstance(value, int | float) and value == SQUARE


def _operands(step: Operation | Condition) -> tuple[int, ...]:
    return (step.of,) if isinstance(step, Condition) else step.of


class _Space:
    """Which row of the work space has which value: ``slots`` by number; ``filled`` once are (value, row).

    The rows of results are taken again after their last use.
    """

    def __init__(
        self,
        tape: Tape,
        known: dict[int, Any],
        rest: Sequence[Operation | Condition],
        columns: dict[int, Array],
    ) -> None:
        na, nu, _ = tape.lengths
        head = [*range(na + nu), *columns, na + nu, na + nu + 1]  # t and dt come last
        self.size = len(head)
        self.slots = {i: slot for slot, i in enumerate(head)}
        self.filled: list[tuple[int, int]] = []
        self._known, self._booleans = known, tape.way.booleans
        self._last = {i: line for line, step in enumerate(rest) for i in _operands(step)}
        self._last |= {i: len(rest) for output in tape.outputs for _, i in output.moving}
        self.links: list[list[int]] = []
        self.matrices: dict[int, int] = {}  # the first row of A_d, B, Q, by their number
        self._found, self._free = set[int](), list[int]()
        entries = (step for step in rest if isinstance(step, Operation))
        # discretisations of which A_d is used, their first matrix
        self._moving = {
            one.of[0] for one in entries if isinstance(one.function, Entry) and one.function.k == 0
        }

    def line(self, number: int, step: Operation | Condition) -> tuple[int, ...] | None:
        """The line of an operation; None where the kernel does not know it."""
        if isinstance(step, Condition):
            return CODES["holds" if step.held else "fails"], self._slot(step.of), 0, 0, 0
        if isinstance(step.function, OfArrays):
            return self._step(step) if step.function.function in STEPS else None
        if isinstance(step.function, Between):
            return self._between(step, step.function)
        if isinstance(step.function, Searched):
            side = "before" if step.function.side[0] == "l" else "up_to"
            return self._linked(step, CODES[side], [self._slot(step.of[0])], step.function.points)
        if isinstance(step.function, At):
            return self._entry(step, step.function)
        code = self._code(step)
        if code is None or len(step.of) > OPERANDS:
            return None
        operands = [self._slot(i) for i in step.of]
        for i in set(step.of):
            if i in self._found and self._last[i] == number:
                self._free.append(self.slots[i])
        self.slots[step.out] = self._free.pop() if self._free else self._new()
        self._found.add(step.out)
        return code, *operands, *[0] * (OPERANDS - len(operands)), self.slots[step.out]

    def _step(self, step: Operation) -> tuple[int, ...]:
        """The line of a discretisation, whose operands and results are linked."""
        n, m = step.function.shapes[1]  # type: ignore[attr-defined]
        operands = [self._slot(i) for i in step.of]
        self.matrices[step.out] = self.size
        self.links.append([n, m, *operands, self.size, int(step.out in self._moving)])
        self.size += n * (2 * n + m)
        return CODES["over_a_step"], len(self.links) - 1, 0, 0, 0

    def _between(self, step: Operation, curve: Between) -> tuple[int, ...] | None:
        """The line of an interpolation, whose points and heights are linked."""
        if not 2 <= len(curve.points) <= POINTS:
            return None
        x, *heights = (self._slot(i) for i in step.of)
        points, fixed = (list(map(self._number, known)) for known in (curve.points, curve.heights))
        self.slots[step.out] = self._new()
        self.links.append([len(points), x, *points, *heights, *fixed])
        return CODES["interp"], len(self.links) - 1, 0, 0, self.slots[step.out]

    def _entry(self, step: Operation, at: At) -> tuple[int, ...] | None:
        """The line of an entry of a table of one row, whose numbers, or operands, are linked."""
        numbers = np.empty(0) if at.table is None else at.table
        if at.keys != 1 or numbers.ndim > 1:
            return None
        return self._linked(step, CODES["entry"], [self._slot(i) for i in step.of], numbers)

    def _linked(
        self, step: Operation, code: int, rows: Sequence[int], numbers: Array
    ) -> tuple[int, ...] | None:
        """The line of what takes one operand and n others, among which may be numbers, by their links."""
        if len(numbers) > POINTS:
            return None
        rows = [*rows, *map(self._number, numbers.tolist())]
        self.slots[step.out] = self._new()
        self.links.append([len(rows) - 1, *rows])
        return code, len(self.links) - 1, 0, 0, self.slots[step.out]

    def _number(self, value: float) -> int:
        """The row of a number that is none of the tape's."""
        self._known[-1 - len(self.filled)] = float(value)
        return self._slot(-1 - len(self.filled))

    def _code(self, step: Operation) -> int | None:
        function = _ufunc(step)
        if function in OF_BOOLEANS:
            return OF_BOOLEANS[function] if self._booleans.issuperset(step.of) else None
        if function is np.power:
            return CODES["square" if _squares(self._known, step.of[1]) else "power"]
        return CODE_OF.get(function)

    def _slot(self, i: int) -> int:
        if i not in self.slots:
            self.slots[i] = self._new()
            self.filled.append((i, self.slots[i]))
        return self.slots[i]

    def _new(self) -> int:
        self.size += 1
        return self.size - 1
