"""A user's function, evaluated right for rows of any times and parameters, or refused.

Algorithms want to call a model once for many particles, times and parameter vectors. The contract that
allows it is about rows: row i of what a function returns depends on row i of its arguments alone
(:mod:`engine.statespace.rows`). Many functions keep it for states but not for times or parameters:
``if t > 5``, ``math.cos(theta.w)``, ``np.diag([1e-4, theta.q])``, ``np.linalg.norm(u)``. Here, and nowhere
else, it is decided which calls a function takes:

- When rows first differ in times or parameters, the call is compared with calls of single rows, and
  with the same rows in another order; likewise a call of rows scattered at random, some of them seen
  at other times, whose number fits no matrix by chance. The 16th, 256th, 4096th, ... call is looked
  at again, and briefly the first of every pass over a record and calls whose inputs or times go beyond
  those of the calls before, or differ by more among their rows.
- A call that is looked at thoroughly is made twice: a function that draws random numbers, or remembers
  its calls, is refused.
- Where a function that fails has no nonlinear state, reads no times and is affine in the inputs, a few calls
  tell the rest (:mod:`engine.statespace.affine`).
- Any other that fails, and that one too for rows of many parameter vectors or time steps, is evaluated by what
  was recorded of it (:mod:`engine.statespace.recorded`), which is compared with calls of single rows likewise.
- Where that fails too, it is called for each time and parameter vector by itself from then on, which is
  slower and always right; rows that differ only in what it does not read are one call. Where results were
  handed out before a failure was seen, what was made of them is made again
  (:mod:`engine.statespace.refutation`).
- Rows of one time and one theta are particles, which no loop can help: where they influence each
  other (``a[0]`` for ``a[:, 0]``, ``np.any(a > 1)``), ModelError is raised, with the remedy. This is looked
  at in the 1st, 2nd, 4th, 8th, ... call, among states of other times. Where the function has a loop over
  them, what was recorded of it takes many of them faster.

"No" is for good and "yes" is asked again. Verdicts belong to one model object and are not pickled.
"""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from engine.errors import EngineError, ModelError
from engine.statespace.affine import Affine
from engine.statespace.compare import Result, copies, differ, joined, sizes_of
from engine.statespace.plan import Plan, plan_of
from engine.statespace.reads import fields_read, loops, reads
from engine.statespace.recorded import NotByRowsError, by_rows
from engine.statespace.recorded.arrays import TracedArray
from engine.statespace.recorded.program import traced_results
from engine.statespace.recorded.stand_ins import Within, traceable
from engine.statespace.refutation import (
    calls_split,
    count_refutation,
    count_split,
    looks_at_times,
)
from engine.statespace.rows import Array, Indices, Kind, Rows, regular_input
from engine.statespace.trial import Regular, Trial, UnrepeatedError, is_numeric
from engine.statespace.verdict import Verdict, ranges_of

MANY = 30  # particles that a loop over them takes longer for than what was recorded of it
INPUT, TIME = 1, 2  # positions of u and t among the arguments of dynamics and of measurement
ENGINE = str(Path(__file__).parents[1])  # this package's own files


def line_of(error: BaseException) -> str:
    """Where in the user's own file an error was raised, "" where that is not known."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if not any(part in f.filename for part in ("site-packages", ENGINE))]
    if not own:
        return ""
    return f"{Path(own[-1].filename).name}, line {own[-1].lineno}, in {own[-1].name}; "


def hands_rows_on(function: Any) -> Any:
    """Mark a function of the engine's own that evaluates another model with the rows it is given.

    The test is then made of the functions of that model alone.
    """
    function.hands_rows_on = True
    return function


class ModelFunction:
    """One ``function`` of a model, whose results have the ``shapes`` for one row.

    ``regular`` makes of such a function one that gives its results their regular shapes; ``model`` and ``name``
    are for errors; ``bounds`` (low, high), each (n_theta,), limit the parameters of the test.
    """

    def __init__(
        self,
        regular: Callable[[Any], Regular],
        function: Any,
        shapes: Sequence[tuple[int, ...]],
        model: str,
        name: str,
        bounds: tuple[Array, Array],
    ) -> None:
        self._trusted = getattr(function, "hands_rows_on", False)
        self._function, self.shapes = function, shapes
        self._looked_into: Any = None  # the function for numbers that are being recorded
        self._regular = regular(function)
        self._bounds, self._trial = bounds, Trial(self._regular, bounds)
        self._program = by_rows(function, shapes)
        self._recorded = Trial(self._regular, bounds, regular(self._program))
        self._looped = loops(function)  # until it is known whether over its rows
        self.model, self.name = model, name
        self._verdicts: dict[Kind | None, Verdict] = {None: Verdict(self._trial)}
        # the last record, what differs in it, the number of its rows (0: any), the verdict on it
        self._theta: Any = None
        self._kind: Kind | None = None
        self._M = 0
        self._verdict = self._verdicts[None]
        self._plan = Plan()
        # where it has no nonlinear state and does not read the times, None where it has or does
        self._reads_u, self._reads_t = reads(function, INPUT), reads(function, TIME)
        self._fields = fields_read(function, TIME + 2 if name == "dynamics" else TIME + 1)
        self._affine = None if self._reads_t else Affine(self._one)

    def __call__(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> Result:
        """The function's results for all rows. Raises ModelError naming function, time and shapes."""
        if a.__class__ is TracedArray:
            return self._traced(a, u, t, dt, theta)
        if self._trusted:
            return self._handed_on(a, u, t, dt, theta)
        kind, verdict = self._kind, self._verdict
        if not (
            t.__class__ is float
            and dt.__class__ is float
            and u.__class__ is np.ndarray
            and u.ndim == 1
        ):
            return self._first_look(Rows(a, regular_input(u, len(a)), t, dt, theta))
        if not (theta is self._theta and (not self._M or len(a) == self._M)):
            if any(value.__class__ is not float for value in theta):
                return self._first_look(Rows(a, regular_input(u, len(a)), t, dt, theta))
            kind, verdict = None, self._verdicts[None]
            self._theta, self._kind, self._verdict, self._M = theta, kind, verdict, 0
        if kind is not None and not verdict.takes:
            return self._theta_by_theta(a, u, t, dt, theta, kind)
        return self._as_before(a, u, t, dt, theta, kind, verdict)

    def _traced(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> Result:
        """What it does to one row of numbers that are being recorded."""
        if self._looked_into is None:
            own = getattr(self._function, "traced", None)
            self._looked_into = traceable(self._function, Within()) if own is None else own
        step = (dt,) if self.name == "dynamics" else ()
        found = self._looked_into(a, u, t, *step, theta)
        results: Result = traced_results(found, self.shapes)
        return results

    def _as_before(
        self,
        a: Array,
        u: Array,
        t: float,
        dt: float,
        theta: Any,
        kind: Kind | None,
        verdict: Verdict,
    ) -> Result:
        """One call, of a kind that was seen and taken; looked at with care when that is due."""
        verdict.calls += 1
        if verdict.calls >= verdict.next:
            return self._with_care(Rows(a, u, t, dt, theta), kind, verdict)
        try:  # as a filter calls it at every time step
            out = verdict.trial.together(a.copy(), u, t, dt, theta)
        except NotByRowsError as error:
            if error.here and kind is not None:
                return self._part_by_part(self._plan_of(a, u, t, dt, theta, kind), a, u, t, dt)
            return self._otherwise(Rows(a, u, t, dt, theta), kind, verdict, error)
        except Exception as error:  # noqa: BLE001 - a user's function may raise anything
            return self._otherwise(Rows(a, u, t, dt, theta), kind, verdict, error)
        return copies(out) if verdict.trial.reuses else out

    def _handed_on(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> Result:
        """What the engine's own function makes of the results of another model's."""
        try:
            return self._regular(a, u, t, dt, theta)
        except Exception as error:  # noqa: BLE001 - a user's function may raise anything
            self._fail(error, Rows(a, u, t, dt, theta))

    def _theta_by_theta(
        self, a: Array, u: Array, t: float, dt: float, theta: Any, kind: Kind
    ) -> Result:
        """A call for each theta, as a filter needs it at every time step, or what a few calls told."""
        plan = self._plan_of(a, u, t, dt, theta, kind)
        if self._affine is not None and not a.shape[1]:
            known = self._affine.step(plan, u, dt)
            if known is not None:
                return known
        if self._may_be_recorded(self._verdict, a, kind):
            return self._with_care(Rows(a, u, t, dt, theta), kind, self._verdict)
        return self._part_by_part(plan, a, u, t, dt)

    def _plan_of(self, a: Array, u: Array, t: float, dt: float, theta: Any, kind: Any) -> Plan:
        """How rows of several parameter vectors are split, found once for all time steps."""
        if self._plan.theta is not theta or len(a) != self._plan.M:
            read = self._read_of(kind, theta)
            self._plan = plan_of(Rows(a, u, t, dt, theta), kind, read)
        return self._plan

    def _part_by_part(self, plan: Plan, a: Array, u: Array, t: float, dt: float) -> Result:
        """A call for each theta of a plan."""
        count_split()
        alike, lost = self._verdicts[None], None
        each: list[Result | None] = []
        for at, own in plan.parts:
            try:
                each.append(self._as_before(a[at], u, t, dt, own, None, alike))
            except ModelError as error:
                if not error.numeric:
                    raise
                each.append(None)
                lost = error
        if lost is not None and not any(each):
            raise lost
        return plan.stacked(each)

    def _first_look(self, rows: Rows) -> Result:
        """A call of other arguments than the last one."""
        kind = self._kind_of(rows)
        if kind is not None and len(rows.a) == 1:
            return self(*rows.alone(kind, np.zeros(1, dtype=np.intp)))
        verdict = self._verdicts.get(kind)
        if verdict is None:
            verdict = self._verdicts[kind] = Verdict(self._trial)
        if kind is None or not kind.times:
            self._theta, self._kind, self._verdict = rows.theta, kind, verdict
            self._M = 0 if kind is None else len(rows.a)
        verdict.calls += 1
        if kind is not None and kind.times:
            rows = rows.frozen()
            if looks_at_times():
                own = ranges_of(rows, kind)
                if verdict.ranges is None or (own > verdict.ranges).any():
                    known = own if verdict.ranges is None else verdict.ranges
                    verdict.ranges = np.maximum(own, known)
                    verdict.next = min(verdict.next, verdict.calls)
        return self._with_care(rows, kind, verdict)

    def _with_care(self, rows: Rows, kind: Kind | None, verdict: Verdict) -> Result:
        """Together if that is right, else each time and theta by itself."""
        if (
            kind is not None
            and not verdict.takes
            and not self._may_be_recorded(verdict, rows.a, kind)
        ):
            return self._apart(rows, kind)
        if kind is None and self._looped and len(rows.a) > 1:
            self._look_at_loop(verdict, rows)
        together: Result | None
        try:
            if len(rows.a) == 1 and not self._trial.tried_single:
                together = self._trial.single(rows)
            elif verdict.calls >= verdict.next and len(rows.a) > 1:
                thorough = verdict.calls >= verdict.due
                if thorough:
                    verdict.due = 16 * verdict.calls
                verdict.next = min(verdict.due, 2 * verdict.calls) if kind is None else verdict.due
                together = verdict.trial.agreeing(rows, kind, thorough, verdict.calls)
            else:
                together = verdict.trial.together(*rows.fresh())
        except UnrepeatedError as error:
            self._fail(ModelError(f"{self.name}: {error}"), rows)
        except Exception as error:  # noqa: BLE001 - a user's function may raise anything
            return self._otherwise(rows, kind, verdict, error)
        if together is None:
            return self._otherwise(rows, kind, verdict)
        return copies(together) if verdict.trial.reuses else together

    def _otherwise(
        self, rows: Rows, kind: Kind | None, verdict: Verdict, error: Exception | None = None
    ) -> Result:
        """What is right where one call is not. Raises ModelError where nothing is."""
        if kind is not None:
            if verdict.calls == 1 and self._may_be_recorded(verdict, rows.a, kind):
                return self._with_care(rows, kind, verdict)  # nothing was handed out before
            out = self._apart(rows, kind)  # raises where the function fails by itself too
            if isinstance(error, NotByRowsError) and error.here:
                return out
            verdict.refuse()
            if verdict.calls > 1:
                count_refutation()
            return out
        if verdict.trial is not self._trial:
            if not (isinstance(error, NotByRowsError) and error.here):
                verdict.restart(self._trial)
                return self._with_care(rows, kind, verdict)
            try:
                return copies(self._regular(*rows.fresh()))
            except Exception as own:  # noqa: BLE001 - a user's function may raise anything
                error = own
        if error is not None:
            self._fail(error, rows)
        raise ModelError(
            f"model '{self.model}', {self.name}: what it returns for one row of a depends on the other "
            f"rows, which are other particles ({rows.place()}). Write a[:, 0] instead of a[0], "
            "np.where(condition, x, y) instead of if, and axis=1 in sums and norms",
            placed=True,
        )

    def _may_be_recorded(self, verdict: Verdict, a: Array, kind: Kind) -> bool:
        """Turn to what was recorded of a function that is called row by row so far; whether that is new."""
        left = self._is_left_to_record(verdict, a, kind)
        if left:
            verdict.restart(self._recorded)
        return left

    def _is_left_to_record(self, verdict: Verdict, a: Array, kind: Kind) -> bool:
        """Whether it was not tried yet, and few calls do not tell all."""
        affine = self._affine is not None and self._affine.holds and not (a.shape[1] or kind.many)
        return not affine and verdict.trial is not self._recorded

    def _look_at_loop(self, verdict: Verdict, rows: Rows) -> None:
        """Turn to what was recorded of a function that goes through the particles in a loop of its own."""
        self._looped = False
        with contextlib.suppress(Exception):  # the function itself will do
            recorded = self._recorded.together(*rows.fresh())
            if self._program.goes_by_rows:
                own = self._regular(*rows.fresh())
                if not differ(recorded, own, sizes_of(own), particles=True):
                    verdict.restart(Trial(self._regular, self._bounds, self._as_many))

    def _as_many(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> Result:
        """Particles of a function with a loop over them, by the loop itself where they are few."""
        call = self._regular if len(a) < MANY else self._recorded.together
        return call(a, u, t, dt, theta)

    def once(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> Result:
        """One call with what is given, without a test; whatever the function raises."""
        if self._affine is not None and not a.shape[1]:
            return self(a, u, t, dt, theta)
        u = regular_input(u, len(a))
        if t.__class__ is not float:
            verdict = self._verdicts.get(self._kind_of(Rows(a, u, t, dt, theta)))
            if verdict is not None and verdict.trial is self._recorded:
                try:
                    return copies(self._recorded.together(a.copy(), u, t, dt, theta))
                except NotByRowsError:
                    return self(a, u, t, dt, theta)
        return self._regular(a.copy(), u, t, dt, theta)

    def _one(self, u: Array, dt: float, theta: Any) -> Result:
        """A row of a function that has no nonlinear state and does not read the times."""
        return self(np.empty((1, 0)), u, 0.0, dt, theta)

    def takes(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> bool:
        """Whether such rows are evaluated in one call; tries it if none were yet."""
        if self._trusted:  # as the functions of the model take them that it hands them on to
            before = calls_split()
            self(a, u, t, dt, theta)
            return calls_split() == before
        rows = Rows(a, regular_input(u, len(a)), t, dt, theta)
        kind = self._kind_of(rows)
        if kind is not None and kind not in self._verdicts:
            self._first_look(rows)
        verdict = self._verdicts.get(kind)  # a single row needs none
        if verdict is None or kind is None or verdict.takes:
            return True
        if self._is_left_to_record(verdict, a, kind):
            self._first_look(rows)
        return verdict.takes

    @property
    def recorded(self) -> bool:
        """Whether some rows are evaluated by what was recorded of the function."""
        return any(one.trial is not self._trial and one.takes for one in self._verdicts.values())

    def look_again(self, u: Array | None = None) -> None:
        """Look at the next call of each kind, briefly unless a thorough look is due; not at particles.

        At all that was recorded, and at a sample of others; see :meth:`Verdict.look_again`.

        ``u`` (T, nu) are the inputs of the record from which the calls will be.
        """
        if u is not None and self._affine is not None and not self._trusted:
            self._affine.expect(u)
        for kind, verdict in self._verdicts.items():
            if verdict.takes and kind is not None:
                verdict.look_again(recorded=verdict.trial is not self._trial)

    def _kind_of(self, rows: Rows) -> Kind | None:
        try:
            kind = rows.kind()
        except ValueError as error:
            self._fail(error, rows)
        if kind is None or self._affine is None or rows.a.shape[1]:
            return kind
        return kind._replace(many=self._affine.takes_long(rows, kind))

    def _read_of(self, kind: Kind, theta: Any) -> Kind:
        """Of what differs, what the function reads: rows that differ in other things are particles."""
        fields = kind.fields
        if self._fields is not None:
            fields = tuple(i for i in fields if theta._fields[i] in self._fields)
        return kind._replace(u=kind.u and self._reads_u, t=kind.t and self._reads_t, fields=fields)

    def _fail(self, error: Exception, rows: Rows) -> NoReturn:
        """Raise a ModelError with the function's name, time and shapes, once."""
        if isinstance(error, MemoryError) or getattr(error, "placed", False):
            raise error
        if isinstance(error, EngineError):
            text = f"model '{self.model}', {error} ({rows.place()})"
        else:
            text = (
                f"model '{self.model}': {self.name} raised {type(error).__name__}: {error} "
                f"({line_of(error)}{rows.place()})"
            )
        if "read-only" in str(error):
            text += "; a function must not write into what it is given: copy it first"
        raise ModelError(text, placed=True, numeric=is_numeric(error)) from error

    def _apart(self, rows: Rows, kind: Kind) -> Result:
        """Each time and theta in a call of its own.

        A theta at which the function cannot be calculated has NaN, unless all are such.
        """
        if self._affine is not None and not rows.a.shape[1]:
            known = self._affine.rows(rows, kind)
            if known is not None:
                return known
        count_split()
        split = kind
        if kind.fields and kind.times:  # one of them may be taken together
            times = Kind(kind.u, kind.t, kind.dt, ())
            verdict = self._verdicts.get(times)
            split = (
                times if verdict and not verdict.takes else Kind(False, False, False, kind.fields)
            )
        parts: list[tuple[Indices, Result]] = []
        lost: ModelError | None = None
        known_next = self._theta, self._kind, self._verdict, self._M  # the calls below are others
        for at in rows.groups(self._read_of(split, rows.theta)):
            try:
                parts.append((at, copies(self(*rows.alone(split, at, kind)))))
            except ModelError as error:
                if not (split.fields and error.numeric):
                    raise
                lost = error
        self._theta, self._kind, self._verdict, self._M = known_next
        if lost is not None and not parts:
            raise lost
        return joined(parts, len(rows.a))
