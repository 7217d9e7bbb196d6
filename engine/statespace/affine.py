"""A function that a few calls tell: without nonlinear states, the same at all times, affine in the inputs.

Many models are linear and their matrices constant: f = c(theta) + B(theta) u, and A and Q the same whatever
the inputs. Where such a function takes one time and one theta a call, a record of T rows would cost T calls for
every theta. Here c, B, A and Q are found from a few of the inputs that were met, and looked at again on
others; that the function is such is seen at all inputs when they are first met. Of times no sample would be
enough, for ``if t > 5`` may hold anywhere: that a function does not read them is told by its code
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
ROUNDING = 1e-11  # of the terms of which a value is the sum
MARGIN = 0.1  # of the range of inputs: further out all are looked at, not the extreme ones only
SAME = 1e-12  # of each entry of a matrix: what calls of one theta may differ by
STEPS = 3  # time steps of different length in a call that are worth it
REMEMBERED = 512  # parameter vectors
FIRST = 16  # inputs met one by one until they are looked at, then again at four times as many

# (u (nu,), dt, theta) -> the function's result for one row
Alone: TypeAlias = Callable[[Array, float, Any], Result]


@dataclass(frozen=True)
class Known:
    """f = [1, u] @ ``weights`` (1 + nu, n), and the matrices that follow it, for one theta."""

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
        self._waiting: list[Array] = []  # met one by one
        self._due = FIRST
        self._plan: tuple[Plan, float, Known] | None = None

    def rows(self, rows: Rows, kind: Kind) -> Result | None:
        """The results of rows of any inputs and parameters; None where they must be called one by one."""
        irregular = kind.dt and len(np.unique(rows.dt)) > STEPS
        if not self.holds or irregular or not isinstance(rows.u, np.ndarray):
            return None
        M = len(rows.a)
        u = rows.u if kind.u else np.repeat(rows.u[:, None], M, axis=1)
        groups = _groups(rows, kind)
        parts = self._known_of(with_one(u.T), [own for _, own in groups])
        if parts is None:
            return None
        if len(groups) == 1:
            return (with_one(u.T) @ parts[0].weights, *copies(parts[0].matrices))
        f = np.empty((M, parts[0].weights.shape[1]))
        stacks = tuple(np.empty((M, *matrix.shape)) for matrix in parts[0].matrices)
        for (at, _), known in zip(groups, parts, strict=True):
            f[at] = with_one(u[:, at].T) @ known.weights
            for stack, matrix in zip(stacks, known.matrices, strict=True):
                stack[at] = matrix
        return (f, *stacks)

    def step(self, plan: Plan, u: Array, dt: float) -> Result | None:
        """The results for the rows of a plan, which differ in their parameters; None as in :meth:`rows`."""
        if not self.holds:
            return None
        design, inputs = np.concatenate([[1.0], u]), self._inputs
        covered = inputs is not None and inputs.cover(design[None])
        if inputs is None or not (covered or inputs.nearly_cover(design[None])):
            self._wait(design, dt, plan.parts[0][1])
            return None
        known_plan = self._plan if covered else None
        if known_plan is None or known_plan[0] is not plan or known_plan[1] != dt:
            records = [own for _, own in plan.parts]
            parts = self._known_of(design[None], [(dt, own) for own in records])
            if parts is None:
                return None
            known_plan = self._plan = plan, dt, _side_by_side(plan, parts)
        known = known_plan[2]
        return ((design @ known.weights).reshape(plan.M, -1), *copies(known.matrices))

    def _wait(self, design: Array, dt: float, theta: Any) -> None:
        """Inputs that were not met before: they are looked at when there are enough of them."""
        self._waiting.append(design)
        if len(self._waiting) >= self._due:
            self._due *= 4
            self._meet(np.array(self._waiting), dt, theta)
            self._waiting = []

    def _known_of(self, design: Array, owners: list[tuple[float, Any]]) -> list[Known] | None:
        """For each time step and theta; None where the function is not affine, or fails at one of them."""
        try:
            if not self._covers(design):
                self._meet(design, *owners[0])
                if not self._covers(design):
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

    def _covers(self, design: Array) -> bool:
        return self._inputs is not None and self._inputs.cover(design)

    def _of(self, dt: float, theta: Any) -> Known | None:
        key, inputs = (dt, *theta), self._inputs
        if key not in self._known and inputs is not None:
            known = self._seen(inputs, inputs.checks, dt, theta)
            if known is None:
                return None
            if len(self._known) >= REMEMBERED:
                self._known.clear()
            self._known[key] = known
        return self._known.get(key)

    def _meet(self, design: Array, dt: float, theta: Any) -> None:
        """Look at these inputs; they are covered from now on where the function is affine in them."""
        design, inputs = np.unique(design, axis=0), self._inputs
        if inputs is not None and inputs.nearly_cover(design):
            ends = _ends(design)
            if self._seen(inputs, ends, dt, theta) is not None:
                self._inputs = inputs.reaching(ends)
            return
        if inputs is not None:
            design = np.concatenate([inputs.used, inputs.checks, design])
        chosen = _Inputs.of(design)
        if self._seen(chosen, design, dt, theta) is not None:
            self._inputs, self._known, self._plan = chosen, {}, None

    def _seen(self, inputs: _Inputs, others: Array, dt: float, theta: Any) -> Known | None:
        """What the used inputs tell, if it is so at the others; None if not, or if values are not finite."""
        some = [self._alone(u, dt, theta) for u in inputs.used[:, 1:]]
        further = [self._alone(u, dt, theta) for u in others[:, 1:]]
        if any(matrix is None for result in some for matrix in result):
            self._refute()
            return None
        values = [np.array([result[0][0] for result in results]) for results in (some, further)]
        stacks = [
            np.array([matrix.reshape(matrix.shape[-2:]) for matrix in matrices])
            for matrices in zip(*(result[1:] for result in [*some, *further]), strict=True)
        ]
        if not all(np.isfinite(array).all() for array in [*values, *stacks]):
            return None
        weights = inputs.solve(values[0])
        design = np.concatenate([inputs.used, others])
        terms = np.abs(design) @ np.abs(weights)
        off = np.abs(np.concatenate(values) - design @ weights)
        affine = (off <= ROUNDING * terms.max(axis=0)).all()
        if not affine or any(
            (np.abs(stack - stack[0]) > SAME * np.abs(stack[0])).any() for stack in stacks
        ):
            self._refute()
            return None
        return Known(weights, tuple(np.ascontiguousarray(stack[0]) for stack in stacks))

    def _refute(self) -> None:
        """It is not affine, for good."""
        self.holds = False
        if self._known:
            count_refutation()


@dataclass(frozen=True)
class _Inputs:
    """Inputs met, each as a row [1, u]: ``used`` determine an affine function on all, ``checks`` look again.

    What is between ``low`` and ``high`` is covered, where it is also in what they span: ``span`` projects
    on it, None where nothing is outside. ``inverse`` @ values at the used inputs are the weights.
    """

    used: Array
    checks: Array
    interior: int  # so many of the checks are any, those after them extreme
    low: Array
    high: Array
    inverse: Array
    size: Array
    span: Array | None

    @classmethod
    def of(cls, design: Array) -> _Inputs:
        """Choose among rows (m, 1 + nu)."""
        size = np.abs(design).max(axis=0)
        size = np.where(size > 0.0, size, 1.0)
        scaled = design / size
        _, R, order = qr(scaled.T, mode="economic", pivoting=True)
        rank = int((np.abs(np.diag(R)) > RANK * abs(R[0, 0])).sum())
        used = scaled[order[:rank]]
        inverse = np.linalg.pinv(used)
        some = np.random.default_rng(0).permutation(order[rank:])[:CHECKED]
        return cls(
            used=design[order[:rank]],
            checks=np.concatenate([design[some], _ends(design)]),
            interior=len(some),
            low=design.min(axis=0),
            high=design.max(axis=0),
            inverse=inverse / size[:, None],
            size=size,
            span=None if rank == design.shape[1] else inverse @ used,
        )

    def solve(self, values: Array) -> Array:
        """Weights (1 + nu, n) from values (r, n) at the used inputs."""
        weights: Array = self.inverse @ values
        return weights

    def cover(self, design: Array) -> bool:
        """Whether rows (m, 1 + nu) are among those met, or between them."""
        inside = (design >= self.low).all() and (design <= self.high).all()
        return bool(inside) and self._spans(design)

    def nearly_cover(self, design: Array) -> bool:
        """Whether they reach but little beyond."""
        beyond = np.maximum(self.low - design, design - self.high)
        return bool((beyond <= MARGIN * (self.high - self.low)).all()) and self._spans(design)

    def reaching(self, ends: Array) -> _Inputs:
        """The same, which reach to further rows."""
        low, high = np.minimum(self.low, ends.min(axis=0)), np.maximum(self.high, ends.max(axis=0))
        farthest = _ends(np.concatenate([self.checks, ends]))
        checks = np.concatenate([self.checks[: self.interior], farthest])
        return replace(self, low=low, high=high, checks=checks)

    def _spans(self, design: Array) -> bool:
        if self.span is None:
            return True
        scaled = design / self.size
        return bool((np.abs(scaled - scaled @ self.span) <= RANK**2).all())


def with_one(u: Array) -> Array:
    """[1, u] for inputs (m, nu)."""
    return np.concatenate([np.ones((len(u), 1)), u], axis=1)


def _ends(design: Array) -> Array:
    """The rows at which each input is least and largest."""
    at = [end(column) for column in design.T[1:] for end in (np.argmin, np.argmax)]
    return design[np.unique(np.array(at, dtype=np.intp))]


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
