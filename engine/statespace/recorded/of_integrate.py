"""What stands in for ``scipy.integrate.solve_ivp``: its explicit Runge-Kutta pairs, step by step.

Steps and their control are those of SciPy (E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential
Equations I, 2nd ed. 1993, II.4), so that recorded numbers are the function's own. Whether a step is taken again
is a choice for each row; only how many are tried in all is a way through the function.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.integrate import RK23, RK45
from scipy.optimize import OptimizeResult

from engine.statespace.recorded.arrays import TracedArray, boxed
from engine.statespace.recorded.numbers import UntraceableError, record
from engine.statespace.recorded.of_python import OF_PYTHON

PAIRS = {"RK45": RK45, "RK23": RK23}
SAFETY, SHRINKS, GROWS = 0.9, 0.2, 10.0
KNOWN = {"t_eval", "args", "rtol", "atol", "max_step", "first_step", "dense_output", "vectorized"}
TRIED = (
    1,
    2,
    3,
    4,
    6,
    8,
    12,
    16,
    24,
    32,
    48,
    64,
    96,
    128,
)  # after so many it is seen who has arrived
larger, smaller = OF_PYTHON[max], OF_PYTHON[min]


def solved_ivp(fun: Any, t_span: Any, y0: Any, method: Any = "RK45", **options: Any) -> Any:
    """``scipy.integrate.solve_ivp`` of traced numbers, forward in time."""
    pair = PAIRS.get(method) if isinstance(method, str) else None
    if method in (RK23, RK45):
        pair = method
    options = {name: value for name, value in options.items() if value is not None}
    first, last = t_span
    if pair is None or options.keys() - KNOWN or options.get("dense_output") or last < first:
        raise UntraceableError
    more, wanted = options.get("args", ()), options.get("t_eval")
    run = _Run(pair, lambda t, y: _flat(fun(t, y, *more)), last, options)
    start = _flat(y0)
    end, at_times = run.solved(first, start, [] if wanted is None else list(wanted))
    found = {
        "t": _Ends(first, last) if wanted is None else wanted,
        "y": _Table(start, end) if wanted is None else np.stack(at_times, axis=1).view(TracedArray),
        "status": 0,
        "success": True,
        "message": "The solver successfully reached the end of the integration interval.",
    }
    result = OptimizeResult()
    result.update(found | dict.fromkeys(("t_events", "y_events", "sol")))
    return result


def _flat(y: Any) -> Any:
    """A vector of numbers, of one where only one is given."""
    y = [y] if np.ndim(boxed(y)) == 0 else y
    each = np.empty(len(y), dtype=object)
    for i, one in enumerate(y):
        each[i] = one.item() if isinstance(one, np.ndarray) else one
    return each.view(TracedArray)


class _Run:
    """A run by a ``pair`` of formulas to the time ``last``."""

    def __init__(
        self, pair: Any, slope: Callable[[Any, Any], Any], last: Any, options: Any
    ) -> None:
        self._pair, self._slope, self._last = pair, slope, last
        self._relative = max(options.get("rtol", 1e-3), 100.0 * np.finfo(float).eps)
        self._absolute = options.get("atol", 1e-6)
        self._most, self._begun = options.get("max_step", np.inf), options.get("first_step")
        self._power = -1.0 / (pair.error_estimator_order + 1)

    def solved(self, t: Any, y: Any, wanted: list[Any]) -> tuple[Any, list[Any]]:
        """The state at the end, and those at times that are ``wanted``."""
        f = self._slope(t, y)
        h = self._first_step(t, y, f) if self._begun is None else self._begun
        again: Any = False
        at_times, ahead = [y for _ in wanted], [True for _ in wanted]
        for tried in range(1, TRIED[-1] + 1):
            now, h, moved, f_new, K, error = self._tried(t, y, f, h)
            good = error < 1.0
            for k, time in enumerate(wanted):
                here = _all(ahead[k], good, time <= now)
                at_times[k] = _taken(here, self._between(t, h, y, K, time), at_times[k])
                ahead[k] = _all(ahead[k], _not(here))
            factor = SAFETY * _taken(error == 0.0, 1.0, error) ** self._power
            grown = _taken(error == 0.0, GROWS, smaller(GROWS, factor))
            grown = _taken(again, smaller(1.0, grown), grown)
            t, y, f = (_taken(good, *pair) for pair in ((now, t), (moved, y), (f_new, f)))
            h = h * _taken(good, grown, larger(SHRINKS, factor))
            again = _not(good)
            if tried in TRIED and t >= self._last:
                return y, at_times
        raise UntraceableError

    def _tried(self, t: Any, y: Any, f: Any, h: Any) -> tuple[Any, ...]:
        """A step of no more than h: its end, length, state and slope there, slopes within, and its error."""
        h = smaller(h, self._most)
        now = t + h
        now = _taken(now - self._last > 0.0, self._last, now)
        h = now - t
        pair, K = self._pair, [f]
        for s in range(1, pair.n_stages):
            K.append(self._slope(t + pair.C[s] * h, y + _weighted(K, pair.A[s]) * h))
        moved = y + h * _weighted(K, pair.B)
        K.append(self._slope(t + h, moved))
        scale = self._absolute + np.maximum(abs(y), abs(moved)) * self._relative
        return now, h, moved, K[-1], K, _size(_weighted(K, pair.E) * h / scale)

    def _between(self, t: Any, h: Any, y: Any, K: list[Any], time: Any) -> Any:
        """The state at a time within a step."""
        P, x = self._pair.P, (time - t) / _taken(h == 0.0, 1.0, h)
        powers = [x ** (k + 1) for k in range(P.shape[1])]
        return y + h * sum(_weighted(K, P[:, k]) * power for k, power in enumerate(powers))

    def _first_step(self, t: Any, y: Any, f: Any) -> Any:
        length = abs(self._last - t)
        scale = self._absolute + abs(y) * self._relative
        sizes = _size(y / scale), _size(f / scale)
        tiny = _not(_all(sizes[0] >= 1e-5, sizes[1] >= 1e-5))
        h = _taken(tiny, 1e-6, 0.01 * sizes[0] / _taken(sizes[1] == 0.0, 1.0, sizes[1]))
        h = smaller(h, length)
        bent = _size((self._slope(t + h, y + h * f) - f) / scale) / h
        most = larger(sizes[1], bent)
        second = _taken(
            most <= 1e-15,
            larger(1e-6, h * 1e-3),
            (0.01 / _taken(most <= 1e-15, 1.0, most)) ** -self._power,
        )
        return smaller(smaller(smaller(100.0 * h, second), length), self._most)


class _Ends:
    """Numbers at all steps, of which the first and the last are known: rows have them at other steps."""

    def __init__(self, first: Any, last: Any) -> None:
        self._ends = {0: first, -1: last}

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, int) and key in self._ends:
            return self._ends[key]
        raise UntraceableError

    def __getattr__(self, name: str) -> Any:
        raise UntraceableError

    def __iter__(self) -> Iterator[Any]:
        raise UntraceableError

    __array__ = __len__ = __iter__


class _Table(_Ends):
    """The states (n, steps): their rows and columns."""

    def __getitem__(self, key: Any) -> Any:
        rows, step = key if isinstance(key, tuple) and len(key) == 2 else (key, None)
        if step is not None:
            return super().__getitem__(step)[rows]
        if isinstance(rows, int | np.integer):
            return _Ends(*(one[rows] for one in self._ends.values()))
        raise UntraceableError

    @property
    def T(self) -> _Ends:
        """The states (steps, n)."""
        return _Ends(*self._ends.values())

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self._ends[0])))


def _taken(where: Any, x: Any, y: Any) -> Any:
    """x or y, numbers or arrays of them."""
    if isinstance(x, np.ndarray):
        each = zip(x.tolist(), y.tolist(), strict=True)
        return _flat([record(np.where, (where, *pair)) for pair in each])
    return record(np.where, (where, x, y))


def _all(*conditions: Any) -> Any:
    first, *rest = conditions
    for each in rest:
        first = record(np.logical_and, (first, each))
    return first


def _not(condition: Any) -> Any:
    return record(np.logical_not, (condition,))


def _weighted(K: list[Any], weights: Any) -> Any:
    pairs = zip(K, np.asarray(weights).tolist(), strict=False)
    return sum(k * weight for k, weight in pairs if weight)


def _size(x: Any) -> Any:
    """The root of the mean square."""
    return np.sqrt(sum(one * one for one in boxed(x).tolist())) / len(x) ** 0.5
