"""Derivatives of what was recorded, where a number stands in it only linearly: exact, and without its value.

A difference says the same to rounding, but other rounding at every point, so that whatever is made of it has to
be found for every point by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from engine.statespace.recorded.numbers import Condition, Operation, Recorder, Traced, record

Rule: TypeAlias = Callable[[Sequence[Any], Sequence[Any]], Any]


def _sum(of: Sequence[Any], by: Sequence[Any]) -> Any:
    return record(np.add, by)


def _difference(of: Sequence[Any], by: Sequence[Any]) -> Any:
    return record(np.subtract, by)


def _negative(of: Sequence[Any], by: Sequence[Any]) -> Any:
    return record(np.negative, by)


def _product(of: Sequence[Any], by: Sequence[Any]) -> Any:
    (x, y), (dx, dy) = of, by
    if _is_zero(dx):
        return record(np.multiply, (x, dy))
    return record(np.multiply, (dx, y)) if _is_zero(dy) else None


def _quotient(of: Sequence[Any], by: Sequence[Any]) -> Any:
    return record(np.true_divide, (by[0], of[1])) if _is_zero(by[1]) else None


RULES: dict[Any, Rule] = {
    np.add: _sum,
    np.subtract: _difference,
    np.negative: _negative,
    np.positive: lambda of, by: by[0],
    np.multiply: _product,
    np.true_divide: _quotient,
}


def linear_in(x: Any, recorder: Recorder, since: int) -> Callable[[Any], Any]:
    """What tells the derivative by x of a number recorded ``since`` that many operations; None where it bends.

    None for all of them where x is no traced number, or a condition depends on it.
    """
    by: dict[int, Any] = {}  # of what depends on x
    lost = not isinstance(x, Traced)
    if not lost:
        by[x.index] = 1.0
    for step in recorder.done[since:]:
        if lost:
            break
        if isinstance(step, Condition):
            lost = step.of in by
        elif not by.keys().isdisjoint(step.of):
            by[step.out] = _by(step, recorder, by)

    def slope(y: Any) -> Any:
        if lost:
            return None
        return by.get(y.index, 0.0) if isinstance(y, Traced) else 0.0

    return slope


def _by(step: Operation, recorder: Recorder, by: dict[int, Any]) -> Any:
    """The derivative of a result, None where it is not one number's for all values of x."""
    own = [by.get(i, 0.0) for i in step.of]
    rule = RULES.get(getattr(step.function, "ufunc", step.function))
    if rule is None or any(one is None for one in own):
        return None
    return rule([recorder.operand(i) for i in step.of], own)


def _is_zero(x: Any) -> bool:
    return not isinstance(x, Traced) and x == 0.0
