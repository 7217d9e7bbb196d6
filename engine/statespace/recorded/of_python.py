"""What stands in for functions of Python: of :mod:`math`, ``float``, ``isinstance``, ``max`` and ``min``."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np
import scipy.special

from engine.statespace.recorded.arrays import (
    TracedArray,
    as_float,
    as_numbers,
    as_whole,
    has_traced,
    opened,
)
from engine.statespace.recorded.numbers import (
    Traced,
    UntraceableError,
    check_finite,
    record,
    whole,
)
from engine.statespace.rows import Array


def _plain_or(function: Callable[..., Any], ufunc: Callable[..., Any]) -> Callable[..., Any]:
    """A function of numbers, by another of rows where they are traced."""

    def call(*operands: Any) -> Any:
        if not has_traced(operands):
            return function(*operands)
        return record(ufunc, [x.item() if isinstance(x, TracedArray) else x for x in operands])

    return call


def unless_traced(function: Callable[..., Any], own: Callable[..., Any]) -> Callable[..., Any]:
    """A function, or what does the same with traced numbers."""

    def call(*args: Any, **options: Any) -> Any:
        if has_traced([*args, *options.values()]):
            return own(*args, **options)
        return opened(function(*map(as_numbers, args), **options))

    return call


def _log(x: Any, base: Any = None) -> Any:
    """``math.log``."""
    own = _plain_or(math.log, np.log)
    return own(x) if base is None else own(x) / own(base)


def _hypot(*xs: Any) -> Any:
    """``math.hypot`` of any number of numbers."""
    if not has_traced(xs):
        return math.hypot(*xs)
    two = _plain_or(math.hypot, np.hypot)
    return reduce(two, xs) if len(xs) > 1 else abs(xs[0])


def _dist(p: Any, q: Any) -> Any:
    """``math.dist``."""
    return _hypot(*(x - y for x, y in zip(p, q, strict=True)))


def _close(x: Any, y: Any, *, rel_tol: float = 1e-9, abs_tol: float = 0.0) -> Any:
    """``math.isclose``."""
    return within(x, y, np.maximum(rel_tol * np.maximum(abs(x), abs(y)), abs_tol))


def within(x: Any, y: Any, allowed: Any) -> Any:
    """Whether two are equal or no further apart than is allowed, which infinite ones always are."""
    apart = np.abs(np.subtract(x, y))
    return np.equal(x, y) | (np.less_equal(apart, allowed) & np.isfinite(apart))


def _whole(function: Callable[..., Any], ufunc: np.ufunc) -> Callable[[Any], Any]:
    """An integer of Python, as :func:`.numbers.whole` records it."""
    return unless_traced(function, lambda x: whole(ufunc, x.item()))


def _of_numbers_only(function: Callable[..., Any]) -> Callable[..., Any]:
    """``gamma`` and the like of :mod:`math`, which raise where those of arrays give what is not finite."""

    def call(x: Any) -> Any:
        out = function(x)
        if not np.isfinite(out).all():
            raise FloatingPointError("not a finite number")
        return out

    return call


def _extreme(function: Callable[..., Any], beyond: np.ufunc) -> Callable[..., Any]:
    """``max`` or ``min`` of numbers, the first of two where one is NaN.

    It is a comparison and a choice, which kernels know.
    """

    def call(*given: Any, **options: Any) -> Any:
        values = list(given[0]) if len(given) == 1 else list(given)
        if options or not has_traced(values):
            return function(values, **options)
        out = values[0]
        for value in values[1:]:
            x, y = (one.item() if isinstance(one, TracedArray) else one for one in (out, value))
            out = record(np.where, (record(beyond, (y, x)), y, x))
        return out

    return call


class _Number:
    """``float`` and the like: called, and given as a type."""

    def __init__(self, kind: Any, convert: Callable[[Any], Any]) -> None:
        self._kind, self._convert, self.dtype = kind, convert, np.dtype(kind)

    def __call__(self, *given: Any) -> Any:
        x = given[0] if given else 0
        x = x.item() if isinstance(x, TracedArray) else x
        return self._convert(x) if isinstance(x, Traced) else self._kind(x, *given[1:])

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kind, name)

    def __instancecheck__(self, x: Any) -> bool:
        return _isinstance(x, self._kind)

    def __or__(self, other: Any) -> Any:
        return self._kind | kind_of(other)

    def __ror__(self, other: Any) -> Any:
        return other | self._kind


def _isinstance(x: Any, kinds: Any) -> bool:
    """What the number that is traced is."""
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    own = tuple(KINDS.get(kind, kind) for kind in kinds)
    if isinstance(x, Traced):
        return isinstance(float(x.value) if isinstance(x.value, float) else x.value, own)
    return isinstance(x, own)


SAME_NAME = (
    "exp expm1 log2 log10 log1p sqrt sin cos tan sinh cosh tanh fabs fmod copysign degrees radians isnan "
    "isfinite isinf"
)
OTHER_NAME = {
    math.asin: np.arcsin,
    math.acos: np.arccos,
    math.atan: np.arctan,
    math.atan2: np.arctan2,
    math.asinh: np.arcsinh,
    math.acosh: np.arccosh,
    math.atanh: np.arctanh,
    math.pow: np.power,
    math.erf: scipy.special.erf,
    math.erfc: scipy.special.erfc,
    math.gamma: _of_numbers_only(scipy.special.gamma),
    math.lgamma: _of_numbers_only(scipy.special.gammaln),
}
IN_MATH = {getattr(math, name): getattr(np, name) for name in SAME_NAME.split()} | OTHER_NAME


def _bisected(function: Callable[..., Any], side: str) -> Callable[..., Any]:
    """``bisect`` in a list of numbers."""

    def own(grid: Any, x: Any, **options: Any) -> Any:
        if options or has_traced(grid):
            return function(grid, x, **options)
        return searched(list(grid), x, side)

    return unless_traced(function, own)


class Searched:
    """``np.searchsorted`` of numbers in ``points`` (n,), on one ``side``."""

    def __init__(self, points: Array, side: Any) -> None:
        self.points, self.side = points, side

    def __call__(self, value: Any) -> Any:
        """The places, for a number or (M,)."""
        return np.searchsorted(self.points, check_finite(value), side=self.side).astype(float)


def searched(grid: Any, x: Any, side: Any = "left") -> Any:
    """``np.searchsorted`` of a number that is traced."""
    points = np.asarray(as_numbers(grid), dtype=float)
    if not (np.diff(points) >= 0.0).all():  # what is found there depends on how it is looked for
        raise UntraceableError
    return record(Searched(points, side), (x.item() if isinstance(x, TracedArray) else x,))


OF_PYTHON: dict[Any, Any] = {
    bisect.bisect_left: _bisected(bisect.bisect_left, "left"),
    bisect.bisect_right: _bisected(bisect.bisect_right, "right"),
    **{function: _plain_or(function, ufunc) for function, ufunc in IN_MATH.items()},
    math.floor: _whole(math.floor, np.floor),
    math.ceil: _whole(math.ceil, np.ceil),
    math.trunc: _whole(math.trunc, np.trunc),
    math.log: _log,
    math.hypot: _hypot,
    math.dist: _dist,
    math.fsum: unless_traced(math.fsum, sum),
    math.isclose: unless_traced(math.isclose, _close),
    np.float64: _Number(np.float64, as_float),
    float: _Number(float, as_float),
    int: _Number(int, as_whole),
    isinstance: _isinstance,
    max: _extreme(max, np.greater),
    min: _extreme(min, np.less),
}
KINDS = {OF_PYTHON[kind]: kind for kind in (np.float64, float, int)}
NAMES = {one.__name__: OF_PYTHON[one] for one in (float, int, isinstance, max, min)}


def kind_of(dtype: Any) -> Any:
    """The type for which a stand-in is."""
    return KINDS.get(dtype, dtype) if callable(dtype) else dtype
