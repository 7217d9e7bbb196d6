"""What was recorded of a function, as paths of operations between conditions, gone through for many rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from engine.statespace.compare import NOISE
from engine.statespace.reads import reads
from engine.statespace.recorded.arrays import TracedArray
from engine.statespace.recorded.numbers import (
    Recorder,
    Traced,
    UntraceableError,
)
from engine.statespace.recorded.paths import NotByRowsError, Output, Part, Path, chain, graft
from engine.statespace.recorded.stand_ins import traceable
from engine.statespace.rows import PERTURBATION, Array, Indices, is_rows

PATHS = 32  # through one function
STEPS = 32  # lengths of time steps for each of which a function is recorded that counts with them
TRIES = 8  # rows at which nothing could be calculated, until it is given up
SAME = 1e-9  # relative: a number that is recorded is the function's own
SINGLE = (int, float, np.number, np.ndarray)  # what is a number for all rows
ENTRIES = 2**18  # numbers kept at once: rows are taken in parts


class Recorded:
    """A function (a, u, t, dt, theta) or (a, u, t, theta) for rows as :mod:`engine.statespace.rows` has them.

    ``shapes`` are those of its results for one row; it returns a tuple of them where ``several``, the first as
    (M, n), the others (r, c) where common to all rows, else (M, r, c). Raises NotByRowsError.
    """

    def __init__(
        self, function: Callable[..., Any], shapes: Sequence[tuple[int, ...]], several: bool = True
    ) -> None:
        self._function, self._shapes, self._several = function, shapes, several
        self._traceable: Any = None
        self._first: dict[Any, Path] = {}
        self._paths = self._lost = self._longest = 0
        self._counts = False  # whether it makes something of the time step that is no number
        self.goes_by_rows = False  # whether it looks at one particle after the other

    def __call__(self, a: Array, u: Any, t: Any, *others: Any) -> Any:
        """The results of all rows."""
        *step, theta = others
        try:
            return self._called(a, u, t, step, theta)
        except NotByRowsError as error:
            if error.here or self._counts or not step or self._first:
                raise
            self._counts = True  # range(int(dt / h)) is possible for each length of it
            return self._called(a, u, t, step, theta)

    def _called(self, a: Array, u: Any, t: Any, step: Sequence[Any], theta: Any) -> Any:
        key = self._key(u, step)
        given = [*a.T, *([] if u is None else u), t, *(step if key[1] is None else ()), *theta]
        given = [float(x) if isinstance(x, SINGLE) and not is_rows(x) else x for x in given]
        lengths = a.shape[1], 0 if u is None else len(u)
        arguments = key, lengths, theta, step
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            parts = list(self._parts(len(a), given, arguments))
        found = tuple(
            self._collected(parts, j, len(a), always=j == 0 and self._several)
            for j in range(len(self._shapes))
        )
        return found if self._several else found[0]

    def _key(self, u: Any, step: Sequence[Any]) -> tuple[bool, float | None]:
        """What a recording belongs to: whether there are inputs, and a time step that is counted with."""
        if not (step and self._counts):
            return u is None, None
        if is_rows(step[0]):
            raise NotByRowsError(here=False)
        key = u is None, float(step[0])
        if key not in self._first and len(self._first) >= STEPS:
            raise NotByRowsError(here=True)
        return key

    def _parts(self, M: int, given: list[Any], arguments: Any) -> Iterator[Part]:
        """The rows by the path they take, each with the values there."""
        first = self._first.get(arguments[0])
        if first is None:
            first = self._record(given, 0, arguments)
        size = max(64, ENTRIES // self._longest)
        for start in range(0, M, size):
            todo: list[slice | Indices] = [slice(start, min(start + size, M))]
            while todo:
                at = todo.pop()
                own = [x[at] if isinstance(x, np.ndarray) else x for x in given]
                split = yield from self._along(first, own, at, given, arguments)
                todo += split

    def _along(
        self, path: Path, values: list[Any], at: slice | Indices, given: list[Any], arguments: Any
    ) -> Any:
        """One path to its end; where rows part, nothing, and the rows of either side are returned."""
        known: dict[int, Any] = dict(enumerate(values))
        while True:
            known.update(path.constants)
            try:
                for function, of, out in path.operations:
                    known[out] = function(*[known[i] for i in of])
            except (ArithmeticError, ValueError) as error:
                raise NotByRowsError(here=True) from error
            if path.condition is None:
                yield Part(
                    at,
                    path.outputs,
                    [
                        [known[i] for _, i in output.moving] if output else []
                        for output in path.outputs
                    ],
                )
                return []
            held = np.asarray(known[path.condition], dtype=bool)
            answer = bool(held.flat[0])
            rows = np.arange(at.start, at.stop) if isinstance(at, slice) else at
            if held.ndim and not (held == answer).all():
                return [rows[~held], rows[held]]
            if answer not in path.then:
                self._record(given, int(rows[0]), arguments)
            if answer not in path.then:  # rounding decides
                raise NotByRowsError(here=True)
            path = path.then[answer]

    def _collected(self, parts: Sequence[Part], j: int, M: int, always: bool) -> Array | None:
        """The result number j of all rows."""
        outputs = [part.outputs[j] for part in parts]
        if all(output is None for output in outputs):
            return None
        first, common = outputs[0], len(parts) == 1 and not always
        if first is None:
            raise NotByRowsError(here=False)
        common = common and not any(map(is_rows, parts[0].values[j]))
        out = np.empty((1 if common else M, first.fixed.size))
        for part, output in zip(parts, outputs, strict=True):
            if output is None:
                raise NotByRowsError(here=False)
            at: Any = slice(None) if common else part.at
            out[at] = output.fixed
            for (entry, _), value in zip(output.moving, part.values[j], strict=True):
                out[at, entry] = value
        return out.reshape(first.shape if common else (M, *first.shape))

    # ---- recording ---------------------------------------------------------------------------

    def _record(self, given: list[Any], row: int, arguments: Any) -> Path:
        """Run the function on one row, and add the path it takes; the first path of all is returned."""
        key = arguments[0]
        own = [float(x[row]) if is_rows(x) else x for x in given]
        if not all(isinstance(x, float) for x in own):  # who asks whether a parameter is used
            raise NotByRowsError(here=True)
        if self._paths >= PATHS or self._lost >= TRIES:
            raise NotByRowsError(here=False)
        recorder = Recorder()
        numbers = [recorder.number(x) for x in own]
        recorder.of_states.update(range(arguments[1][0]))
        try:
            if self._traceable is None:
                self._traceable = traceable(self._function)
            before = UntraceableError.raised()
            with recorder:
                found = self._traceable(*self._given(numbers, arguments))
                outputs = self._outputs(found, recorder)
            if UntraceableError.raised() != before:  # it caught that
                raise UntraceableError
            if recorder.failed is not None:  # it caught that, as it need not in other rows
                raise recorder.failed
            self._compare(_numbers_of(found), own, arguments)
        except UntraceableError as error:
            raise NotByRowsError(here=False) from error
        except NotByRowsError:
            raise
        except Exception as error:
            self._lost += 1
            here = isinstance(error, ArithmeticError | ValueError)
            raise NotByRowsError(here=here) from error
        self._paths += 1
        self.goes_by_rows = self.goes_by_rows or recorder.goes_by_rows
        self._longest = max(self._longest, recorder.values)
        path = chain(recorder, outputs)
        first = self._first.setdefault(key, path)
        if first is not path:
            graft(first, path)
        return first

    def _given(self, numbers: Sequence[Any], arguments: Any) -> Sequence[Any]:
        """The arguments for one row, of its numbers, traced ones or not."""
        key, (na, nu), theta, step = arguments
        kind = object if isinstance(numbers[-1], Traced) else float
        a = np.array(numbers[:na], dtype=kind).reshape(1, na)
        u = None if key[0] else np.array(numbers[na : na + nu], dtype=kind)
        if kind is object:
            a, u = a.view(TracedArray), None if u is None else u.view(TracedArray)
        rest = iter(numbers[na + nu :])
        t = next(rest)
        step = step if key[1] is not None else [next(rest) for _ in step]
        return a, u, t, *step, theta._make(rest)

    def _compare(self, recorded: Sequence[Any], own: Sequence[float], arguments: Any) -> None:
        """Refuse what the function itself does not say of the row that was recorded."""

        def alone(factor: float) -> Sequence[Any]:
            return _numbers_of(self._function(*self._given([x * factor for x in own], arguments)))

        with np.errstate(all="ignore"):
            known = alone(1.0)
            pairs = enumerate(zip(recorded, known, strict=True))
            apart = [i for i, (x, y) in pairs if not _near(x, y, SAME * np.abs(y))]
            if not apart:
                return
            again, *nudged = (alone(1.0 + sign * PERTURBATION) for sign in (0.0, -1.0, 1.0))
            for i in apart:  # some functions magnify rounding
                noise = sum(np.abs(one[i] - known[i]) for one in nudged)
                allowed = SAME * np.abs(known[i]) + NOISE * noise
                if not (_near(again[i], known[i], 0.0) and _near(recorded[i], known[i], allowed)):
                    raise UntraceableError

    def _outputs(self, found: Any, recorder: Recorder) -> Sequence[Output | None]:
        return outputs_of(found if self._several else (found,), self._shapes, recorder)

    def reads_argument(self, position: int) -> bool:
        """What the function itself reads."""
        return reads(self._function, position)

    def __reduce__(self) -> tuple[Any, ...]:  # without what it remembers
        return type(self), (self._function, self._shapes, self._several)


def outputs_of(
    found: Any, shapes: Sequence[tuple[int, ...]], recorder: Recorder
) -> Sequence[Output | None]:
    """What a function has returned for one row, as entries that are numbers and entries that are recorded."""
    if not isinstance(found, list | tuple) or len(found) != len(shapes):
        raise UntraceableError
    out: list[Output | None] = []
    for value, shape in zip(found, shapes, strict=True):
        if value is None:
            out.append(None)
            continue
        entries = list(_leaves(value))
        if len(entries) != int(np.prod(shape)):
            raise UntraceableError
        fixed = [0.0 if isinstance(x, Traced) else float(x) for x in entries]
        if any(isinstance(x, Traced) and x.recorder is not recorder for x in entries):
            raise UntraceableError  # remembered from another call
        moving = [(i, x.index) for i, x in enumerate(entries) if isinstance(x, Traced)]
        out.append(Output(shape, np.array(fixed), moving))
    return out


def traced_arguments(numbers: Sequence[Traced], na: int, nu: int, theta: Any) -> Sequence[Any]:
    """The arguments a, u, t, dt and theta for one row, of traced numbers in this order."""
    a = np.array(numbers[:na], dtype=object).reshape(1, na).view(TracedArray)
    u = np.array(numbers[na : na + nu], dtype=object).view(TracedArray)
    t, dt, *rest = numbers[na + nu :]
    return a, u, t, dt, theta._make(rest)


def traced_results(found: Any, shapes: Sequence[tuple[int, ...]]) -> Any:
    """Results for one row in their regular shapes, matrices without one for the row where all are numbers."""
    if not isinstance(found, list | tuple) or len(found) != len(shapes):
        raise UntraceableError
    out = []
    for value, shape in zip(found, shapes, strict=True):
        entries = list(_leaves(value))
        if len(entries) != int(np.prod(shape)):
            raise UntraceableError
        moving = len(shape) == 1 or any(isinstance(x, Traced) for x in entries)
        each = np.empty(len(entries), dtype=object)
        each[:] = entries
        out.append(each.reshape((1, *shape) if moving else shape).view(TracedArray))
    return tuple(out)


def _leaves(value: Any) -> Iterator[Any]:
    """All entries of nested lists and arrays, in their order."""
    if isinstance(value, np.ndarray):
        yield from value.ravel().tolist()
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _leaves(one)
    else:
        yield value


def _numbers_of(found: Any) -> list[Array]:
    """Results for one row as numbers, in their order."""
    several = found if isinstance(found, list | tuple) else (found,)
    return [np.array([float(x) for x in _leaves(value) if x is not None]) for value in several]


def _near(x: Array, y: Array, allowed: Any) -> bool:
    return x.shape == y.shape and bool(
        np.all((np.abs(x - y) <= allowed) | (x == y) | (np.isnan(x) & np.isnan(y)))
    )


def by_rows(function: Any, shapes: Sequence[tuple[int, ...]]) -> Any:
    """The same function for rows of any times and parameters.

    Functions of the engine's own that call a user's know which.
    """
    own = getattr(function, "by_rows", None)
    return Recorded(function, shapes) if own is None else own()
