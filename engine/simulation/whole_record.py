"""A whole free run at once: Newton's method on the trajectory in place of a loop over time.

A run without noise, x_{t+1} = F(x_t, u_t, theta), is the trajectory X at which every defect
F(X_t) - X_{t+1} is zero. From a guess X all steps and their derivatives J_t = dF/dx are evaluated in a few
calls of the model, and the linearised equations solved by one recursion over time,

    x_{t+1} = F(X_t) + J_t (x_t - X_t),      X := x,

until nothing moves. The fixed point is the run itself, whatever J was; a linear model needs one iteration,
and after k iterations at least the first k rows are right. Lim et al. (2024), "Parallelizing non-linear
sequential models over the sequence length" (DEER); Gonzalez et al. (2024), "Towards scalable and stable
parallelization of nonlinear RNNs", on where it does not converge.

Here it is left to the loop where the run would not come out cheaper, from the last row that is right on:
where Newton's iterations have cost a share of what the loop costs (friction that sticks and slips, long
steps of a stiff oscillator), where the run amplifies rounding (chaos), where the model takes one time in a
call only, and in short records.
"""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.kernels.trajectory import correct
from engine.simulation.steps import Steps, near, sizes, tested, transitions
from engine.statespace.model import Array, MixedModel

SHORTEST = 300  # rows from which on it is tried
TOLERANCE = 1e-10  # of how far a state has moved: a correction this small ends the iterations ...
SMALL = 1e-3  # of the same: after such a correction J is as good as new
FLOOR = 1e-13  # ... and of its value, which rounding is a share of
MOST_SPENT = 0.15  # of the loop's cost, counted in its steps:
LOOK = 25.0  # what a tested call and the last check cost
CALL, ROWS_PER_STEP = 1.2, 2000.0  # a call of few rows, and so many rows of one
PATIENCE = 5  # iterations without a row more at the beginning
MOST_ROWS, MOST_NUMBERS = 2000, 60_000  # in one part of a long record: rows; entries of their J


def whole_record(
    model: MixedModel, record: object, series: Series, x1: Array, guess: Array | None = None
) -> Array:
    """The leading rows (n, nx) of the noise-free run from x1 (nx,); all T where Newton's method converges.

    Parameters
    ----------
    model, record
        The model, and its parameters as a record of plain numbers.
    series : Series
        Inputs and times; outputs are not looked at.
    x1 : (nx,)
        The first state, in the states' units.
    guess : (T, nx), optional
        A trajectory to begin with, such as that of nearby parameters; by default x1 throughout.

    Returns
    -------
    (n, nx)
        The run's first n rows, n >= 1, to 1e-9 of what each state moves; what is missing is the loop's.

    """
    T = len(series)
    start = x1[None].copy()
    if T < SHORTEST or not np.isfinite(x1).all():
        return start
    X = np.tile(x1, (T, 1)) if guess is None else guess.copy()
    X[0] = x1
    try:
        with np.errstate(all="ignore"):
            steps = transitions(model, record, series)
            solved = _solve(model, steps, X, guess is not None)
            return X[:solved] if _is_run(steps.rows(0, solved - 1), X[:solved]) else start
    except Exception:  # noqa: BLE001 - a user's function may raise anything away from the run itself
        return start


def _solve(model: MixedModel, steps: Steps, X: Array, guessed: bool) -> int:
    """Newton's method on X (T, nx), in place; how many of its rows are the run.

    Rows before ``first`` are done, those from ``there`` + 1 on hold nothing yet, and ``first`` to ``last``
    are worked on: a part of a long record, less where the linearised run explodes.
    """
    n, x1 = len(X) - 1, X[0].copy()
    at = tested(model, steps, X[:-1])
    if at is None:
        return 1
    moved = np.where(np.isfinite(at.value), np.abs(at.value - x1), 0.0).max(axis=0)
    scale = np.tile(sizes(moved, np.abs(x1), model.start_sizes), (n + 1, 1))
    rounding = np.zeros_like(X)
    J, is_kept = None, False
    longest = max(MOST_ROWS, MOST_NUMBERS // model.nx**2)
    first, last = 0, min(n, longest)
    there, solved, stuck, spent = n if guessed else last, 0, 0, LOOK
    own = steps.rows(first, last)
    if last < n:
        at = own(X[first:last])
    while True:
        part, calls = X[first : last + 1], 1
        if not is_kept:
            J = own.slopes(part[:-1], at, scale[first:last], False, J)
            calls += model.na
        right, finite, steady, most, scale[first : last + 1], rounding[first : last + 1] = correct(
            part, at.value, J, x1, scale[first], rounding[first], TOLERANCE, FLOOR
        )
        spent += 1.0 + calls * (CALL + (last - first) / ROWS_PER_STEP)
        stuck = 0 if first + right > solved else stuck + 1
        solved = first + int(right)
        if not steady:
            return 1
        if solved > n or spent > MOST_SPENT * n or stuck == PATIENCE:
            return solved
        before = first, last
        if finite <= last - first:
            there = last = first + max(finite // 2, right)
        if 2 * right > last - first:
            first = solved - 1
            last = max(last, first + min(2 * right, longest))
        last = min(last, n)
        if last > there:
            X[there + 1 : last + 1], scale[there + 1 : last + 1] = X[there], scale[there]
            there = last
        is_kept = most <= SMALL and (first, last) == before
        if (first, last) != before:
            own, J = steps.rows(first, last), None
            spent += LOOK  # a model within a model is tested on new rows
        at = own(X[first:last])


def _is_run(steps: Steps, X: Array) -> bool:
    """Whether steps made from X (n + 1, nx) end where it says: where F jumps a correction is never small."""
    x, ends = X[:-1], X[1:]
    return not len(x) or (near(steps(x).value, ends) and steps.as_alone(x, ends))
