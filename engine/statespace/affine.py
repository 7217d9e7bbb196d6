"""A function that a few calls tell: without nonlinear states, the same at all times, affine in the inputs.

Many models are linear and their matrices constant: f = c(theta) + B(theta) u, and A and Q the same whatever
the inputs. Where such a function takes one time and one theta a call, a record of T rows would cost T calls for
every theta. Here c, B, A and Q are found from a few of the inputs that were met, and looked at again on
others; that the function is such is seen at all inputs when they are first met, again when a parameter moves
for the first time, which may be the height of a bump between those few, and now and then. Of times no sample
would be enough, for ``if t > 5`` may hold anywhere: that a function does not read them is told by its code
(:mod:`engine.statespace.reads`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.linalg import qr

from engine.statespace.compare import Result, copies
from engine.statespace.plan import Plan
from engine.statespace.refutation import count_refutation
from engine.statespace.rows import Array, Indices, Kind, Rows

CHECKED = 2  # inputs, besides extreme ones, at which another theta is looked at
RANK = 1e-6  # of the largest: directions in which the inputs differ by less are one
ROUNDING = 1e-13  # of the terms of which a value is the sum
MARGIN = 0.1  # of the range of inputs: further out all are looked at, not the extreme ones only
SAME = 1e-12  # of each entry of a matrix: what calls of one theta may differ by
STEPS = 3  # time steps of different length in a call that are worth it ...
THETAS = 4  # ... and values of a parameter: a drift has another one in every row
REMEMBERED = 512  # parameter vectors
OFTEN = 4  # times as many parameter vectors until all inputs are looked at again
FIRST = 16  # inputs met one by one until they are looked at, then again at four times as many

# (u (nu,), dt, theta) -> the function's result for one row
Alone: TypeAlias = Callable[[Array, float, Any], Result]


@dataclass(frozen=True)
class Known:
    """f = v @ ``weights`` (1 + nu, n) with v of :meth:`_Inputs.scaled`, and the matrices, for one theta."""

    weights: Array
    matrices: tuple[Array, ...]


class Affine:
    """What is known of such a function; ``holds`` until some inputs contradict it.

    Inputs are met where :meth:`rows` is asked for many or :meth:`step` for one after the other.
    """

    def __init__(self, alone: Alone) -> None:
        self._alone = alone
        self.holds = True
        self._known: dict[tuple[float, ...], Known] = {}
        self._inputs: _Inputs | None = None
        self._first: Any = None  # the parameters at which they were met
        self._moved: set[int] = set()  # of which these have moved since
        self._met = np.empty((0, 0))  # all inputs met, each once
        self._thetas = 0  # parameter vectors, and at how many all inputs are looked at again
        self._next = FIRST
        self._record: Array | None = None  # to be met first
        self._waiting: list[Array] = []  # met one by one
        self._due = FIRST
        self._told = False  # whether results were handed out, by inputs met before, too
        self._plan: tuple[Plan, float, Known] | None = None

    def expect(self, u: Array) -> None:
        """Inputs (T, nu) of a record, which are met before any others if none were met so far.

        Then the digits of results do not depend on what was asked first.
        """
        if self._inputs is None:
            self._record = u

    @staticmethod
    def takes_long(rows: Rows, kind: Kind) -> bool:
        """Whether rows differ in so many time steps or parameters that calls for each are many."""
        steps = len(np.unique(rows.dt)) if kind.dt else 1
        return steps > STEPS or any(len(np.unique(rows.theta[i])) > THETAS for i in kind.fields)

    def rows(self, rows: Rows, kind: Kind) -> Result | None:
        """The results of rows of any inputs and parameters; None where they must be called one by one."""
        if not self.holds or not isinstance(rows.u, np.ndarray):
            return None
        if kind.dt and len(np.unique(rows.dt)) > STEPS:
            return None
        M = len(rows.a)
        u = rows.u.T if kind.u else np.repeat(rows.u[None], M, axis=0)
        groups = _groups(rows, kind)
        parts = self._known_of(u, [own for _, own in groups])
        if parts is None or self._inputs is None:
            return None
        v = self._inputs.scaled(u)
        if len(groups) == 1:
            return (v @ parts[0].weights, *copies(parts[0].matrices))
        f = np.empty((M, parts[0].weights.shape[1]))
        stacks = tuple(np.empty((M, *matrix.shape)) for matrix in parts[0].matrices)
        for (at, _), known in zip(groups, parts, strict=True):
            f[at] = v[at] @ known.weights
            for stack, matrix in zip(stacks, known.matrices, strict=True):
                stack[at] = matrix
        return (f, *stacks)

    def step(self, plan: Plan, u: Array, dt: float) -> Result | None:
        """The results for the rows of a plan, which differ in their parameters; None as in :meth:`rows`."""
        if not self.holds:
            return None
        if self._record is not None:
            self._known_of(u[None], [(dt, plan.parts[0][1])])
        covered = self._covers(u[None])
        if not (covered or (self._inputs is not None and self._inputs.nearly_cover(u[None]))):
            self._wait(u, dt, plan.parts[0][1])
            return None
        known = self._plan if covered else None
        if known is None or known[0] is not plan or known[1] != dt:
            parts = self._known_of(u[None], [(dt, own) for _, own in plan.parts])
            if parts is None:
                return None
            known = self._plan = plan, dt, _side_by_side(plan, parts)
        if self._inputs is None:
            return None
        f = self._inputs.scaled(u[None]) @ known[2].weights
        return (f.reshape(plan.M, -1), *copies(known[2].matrices))

    def _wait(self, u: Array, dt: float, theta: Any) -> None:
        """Inputs that were not met before: they are looked at when there are enough of them."""
        self._waiting.append(u)
        if len(self._waiting) >= self._due:
            self._due *= 4
            self._known_of(np.array(self._waiting), [(dt, theta)])
            self._waiting = []

    def _known_of(self, u: Array, owners: list[tuple[float, Any]]) -> list[Known] | None:
        """For each time step and theta; None where the function is not affine, or fails at one of them."""
        try:
            record, self._record = self._record, None
            if record is not None:
                self._meet(record, *owners[0])
            if not self._covers(u):
                self._meet(u, *owners[0])
                if not self._covers(u):
                    return None
            if not self._as_parameters_move(owners):
                return None
            out: list[Known] = []
            for dt, theta in owners:
                known = self._of(dt, theta) if self.holds else None
                if known is None:
                    return None
                out.append(known)
            return out
        except Exception:  # noqa: BLE001 - who asked calls it row by row, and tells what fails
            return None

    def _covers(self, u: Array) -> bool:
        return self._inputs is not None and self._inputs.cover(u)

    def _as_parameters_move(self, owners: list[tuple[float, Any]]) -> bool:
        """Look at all inputs as parameters have moved that did not before; False where it is not affine then.

        One look tells of all that have, unless the function fails there.
        """
        new: dict[int, float] = {}
        movers = []
        for owner in owners:
            first = {
                i: value
                for i, (value, was) in enumerate(zip(owner[1], self._first, strict=True))
                if value != was and i not in self._moved and i not in new
            }
            if first:
                new |= first
                movers.append(owner)
        if not new:
            return True
        self._moved |= new.keys()
        names = self._first._fields
        moved = self._first._replace(**{names[i]: value for i, value in new.items()})
        try:
            if self._seen_at_all(owners[0][0], moved) is not None:
                return True
        except Exception:  # noqa: BLE001 - together they may be what none of them is
            pass
        return self.holds and all(self._seen_at_all(*owner) is not None for owner in movers)

    def _seen_at_all(self, dt: float, theta: Any) -> Known | None:
        return None if self._inputs is None else self._seen(self._inputs, self._met, dt, theta)

    def _of(self, dt: float, theta: Any) -> Known | None:
        key, inputs = (dt, *theta), self._inputs
        if key not in self._known and inputs is not None:
            self._thetas += 1
            due = self._thetas >= self._next
            self._next *= OFTEN if due else 1
            known = self._seen(inputs, self._met if due else inputs.checks, dt, theta)
            if known is None:
                return None
            if len(self._known) >= REMEMBERED:
                self._known.clear()
            self._known[key] = known
            self._told = True
        return self._known.get(key)

    def _meet(self, u: Array, dt: float, theta: Any) -> None:
        """Look at these inputs; they are covered from now on where the function is affine in them."""
        u, inputs = np.unique(u, axis=0), self._inputs
        if inputs is not None and inputs.nearly_cover(u):
            ends = _ends(u)
            if self._seen(inputs, ends, dt, theta) is not None:
                self._inputs = inputs.reaching(ends)
            return
        if inputs is not None:
            u = np.unique(np.concatenate([self._met, u]), axis=0)
        chosen = _Inputs.of(u)
        if self._seen(chosen, u, dt, theta) is not None:
            self._inputs, self._known, self._plan = chosen, {}, None
            self._first, self._moved, self._met = theta, set(), u

    def _seen(self, inputs: _Inputs, others: Array, dt: float, theta: Any) -> Known | None:
        """What the used inputs tell, if it is so at the others; None if not, or if values are not finite."""
        u = np.concatenate([inputs.used, others])
        results = [self._alone(one, dt, theta) for one in u]
        if any(matrix is None for result in results for matrix in result):
            self._refute()
            return None
        values = np.array([result[0][0] for result in results])
        stacks = [
            np.array([matrix.reshape(matrix.shape[-2:]) for matrix in matrices])
            for matrices in zip(*(result[1:] for result in results), strict=True)
        ]
        if not all(np.isfinite(array).all() for array in (values, *stacks)):
            return None
        v = inputs.scaled(u)
        weights = inputs.inverse @ values[: len(inputs.used)]
        allowed = ROUNDING * (np.abs(v) @ np.abs(weights)).max(axis=0)
        affine = (np.abs(values - v @ weights) <= allowed).all()
        if not affine or any(
            (np.abs(stack - stack[0]) > SAME * np.abs(stack[0])).any() for stack in stacks
        ):
            self._refute()
            return None
        return Known(weights, tuple(np.ascontiguousarray(stack[0]) for stack in stacks))

    def _refute(self) -> None:
        """It is not affine, for good."""
        self.holds = False
        if self._told:
            count_refutation()


@dataclass(frozen=True)
class _Inputs:
    """Inputs met, (m, nu): ``used`` determine an affine function on all, ``checks`` are to look again.

    What is between ``low`` and ``high`` is covered, where it is also in what they span: ``span`` projects
    on it, None where nothing is outside. They are scaled by their ``middle`` and their ``reach`` to either
    side; ``inverse`` @ values at the used inputs are the weights.
    """

    used: Array
    checks: Array
    interior: int  # so many of the checks are any, those after them extreme
    low: Array
    high: Array
    middle: Array
    reach: Array
    inverse: Array
    span: Array | None

    @classmethod
    def of(cls, u: Array) -> _Inputs:
        """Choose among inputs (m, nu)."""
        low, high = u.min(axis=0), u.max(axis=0)
        middle, reach = 0.5 * (low + high), 0.5 * (high - low)
        reach = np.where(reach > 0.0, reach, 1.0)
        v = _scaled(u, middle, reach)
        _, R, order = qr(v.T, mode="economic", pivoting=True)
        rank = int((np.abs(np.diag(R)) > RANK * abs(R[0, 0])).sum())
        used = v[order[:rank]]
        inverse = np.asarray(np.linalg.pinv(used), dtype=float)
        some = np.random.default_rng(0).permutation(order[rank:])[:CHECKED]
        return cls(
            used=u[order[:rank]],
            checks=np.concatenate([u[some], _ends(u)]),
            interior=len(some),
            low=low,
            high=high,
            middle=middle,
            reach=reach,
            inverse=inverse,
            span=None if rank == v.shape[1] else inverse @ used,
        )

    def scaled(self, u: Array) -> Array:
        """[1, u] for inputs (m, nu), each between -1 and 1 if it is covered."""
        return _scaled(u, self.middle, self.reach)

    def cover(self, u: Array) -> bool:
        """Whether inputs (m, nu) are among those met, or between them."""
        return bool((u >= self.low).all() and (u <= self.high).all()) and self._spans(u)

    def nearly_cover(self, u: Array) -> bool:
        """Whether they reach but little beyond."""
        beyond = np.maximum(self.low - u, u - self.high)
        return bool((beyond <= MARGIN * (self.high - self.low)).all()) and self._spans(u)

    def reaching(self, ends: Array) -> _Inputs:
        """The same, which reach to further inputs."""
        low, high = np.minimum(self.low, ends.min(axis=0)), np.maximum(self.high, ends.max(axis=0))
        farthest = _ends(np.concatenate([self.checks, ends]))
        checks = np.concatenate([self.checks[: self.interior], farthest])
        return replace(self, low=low, high=high, checks=checks)

    def _spans(self, u: Array) -> bool:
        if self.span is None:
            return True
        v = self.scaled(u)
        return bool((np.abs(v - v @ self.span) <= RANK**2).all())


def _scaled(u: Array, middle: Array, reach: Array) -> Array:
    v = np.ones((len(u), 1 + u.shape[1]))
    v[:, 1:] = (u - middle) / reach
    return v


def _ends(u: Array) -> Array:
    """The inputs (m, nu) at which each is least and largest."""
    at = [end(column) for column in u.T for end in (np.argmin, np.argmax)]
    return u[np.unique(np.array(at, dtype=np.intp))]


def _groups(rows: Rows, kind: Kind) -> list[tuple[Indices, tuple[float, Any]]]:
    """Rows of one time step and theta, with these as plain numbers."""
    own = Kind(False, False, kind.dt, kind.fields)
    if not (kind.dt or kind.fields):
        return [(np.arange(len(rows.a)), (float(rows.dt), rows.theta))]
    out = []
    for at in rows.groups(own):
        one = rows.alone(own, at, kind)
        out.append((at, (float(one.dt), one.theta)))
    return out


def _side_by_side(plan: Plan, parts: list[Known]) -> Known:
    """Those of all rows of a plan: weights (1 + nu, M n), and matrices (M, ., .)."""
    at = np.repeat(np.arange(len(parts)), plan.counts)
    at = at if plan.back is None else at[plan.back]
    weights = np.stack([known.weights for known in parts], axis=1)[:, at]
    matrices = zip(*(known.matrices for known in parts), strict=True)
    return Known(
        np.ascontiguousarray(weights.reshape(len(weights), -1)),
        tuple(np.ascontiguousarray(np.stack(some)[at]) for some in matrices),
    )
