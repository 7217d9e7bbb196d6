"""What stands in for functions of NumPy and SciPy, and for :func:`engine.discretize`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.integrate
import scipy.linalg

from engine.statespace.discretization import checked_step, discretize
from engine.statespace.recorded.arrays import (
    TracedArray,
    applied,
    as_numbers,
    boxed,
    by_entries,
    has_traced,
    opened,
    record_arrays,
    traced_array,
)
from engine.statespace.recorded.numbers import Traced, UntraceableError, record
from engine.statespace.recorded.of_integrate import solved_ivp
from engine.statespace.recorded.of_libraries import of_library
from engine.statespace.recorded.of_linalg import inverted, solved
from engine.statespace.recorded.of_python import kind_of, searched, unless_traced, within
from engine.statespace.rows import Array

ALIKE = 1e-11  # entries of matrices that two ways to an exponential give
CHOICES = 30  # points of an interpolation that differ from row to row, of which np.choose takes 32


def _each(function: Callable[..., Any]) -> Callable[..., Any]:
    """By entries of the arguments, numbers or arrays of them."""

    def call(*operands: Any) -> Any:
        if not has_traced(operands):
            return opened(function(*map(as_numbers, operands)))
        if any(isinstance(x, np.ndarray | list | tuple) for x in operands):
            plain = [np.asarray(_as_objects(x)).view(np.ndarray) for x in operands]
            found = np.frompyfunc(lambda *xs: record(function, xs), len(operands), 1)(*plain)
            return traced_array(found)
        return record(function, operands)

    return call


def _as_objects(x: Any) -> Any:
    return np.asarray(boxed(x), dtype=object)


def _made(function: Any) -> Callable[..., Any]:
    """A new array of numbers that takes traced ones."""

    def call(*args: Any, **options: Any) -> Any:
        dtype = kind_of(options.pop("dtype", None))
        if dtype is not None and np.dtype(dtype).char != "d":
            return function(*args, dtype=dtype, **options)
        if function is np.full and has_traced([*args, *options.values()]):
            return function(*args, **{**options, "dtype": object}).view(TracedArray)
        if args and isinstance(args[0], TracedArray):  # np.zeros_like(x)
            args = (np.zeros(args[0].shape), *args[1:])
        return opened(function(*args, **options))

    return call


def _content(function: Callable[..., Any]) -> Callable[..., Any]:
    """An array made of what is given."""

    def call(given: Any, dtype: Any = None, **options: Any) -> Any:
        dtype = kind_of(dtype)
        number = dtype is None or np.dtype(dtype).char == "d"
        if isinstance(given, TracedArray) and function is not np.array and not options and number:
            return given
        if not has_traced(given):
            return opened(function(as_numbers(given), dtype=dtype, **options))
        if not number or options.keys() - {"copy", "ndmin"}:
            raise UntraceableError
        out = _nested(given) if dtype is None else _nested(given).astype(float)
        return out.reshape((1,) * (options.get("ndmin", 0) - out.ndim) + out.shape)

    return call


def _nested(given: Any) -> Any:
    """An array of objects of nested lists whose innermost entries are numbers or arrays of one shape."""
    if isinstance(given, list | tuple):
        return np.stack([np.asarray(_nested(one)) for one in given]).view(TracedArray)
    return _as_objects(given).copy().view(TracedArray)


def _arrays(function: Callable[..., Any], single: bool = True) -> Callable[..., Any]:
    """A function of whole matrices that takes leading axes."""

    def call(*arrays: Any) -> Any:
        if not has_traced([np.asarray(_nested(x)) for x in arrays]):
            found = function(*map(as_numbers, arrays))
            return opened(found) if single else tuple(map(opened, found))
        if single:
            return record_arrays(lambda *xs: (function(*xs),), arrays)[0]
        return record_arrays(function, arrays)

    return call


def _discretize(F: Any, G: Any = None, Qc: Any = None, *, dt: Any) -> Any:
    """:func:`engine.discretize` of traced matrices."""
    n = np.shape(F)[-1]
    G = np.zeros((n, 0)) if G is None else G
    Qc = np.zeros((n, n)) if Qc is None else Qc
    if np.ndim(F) > 2 or np.ndim(dt) > 0:
        raise UntraceableError
    return _arrays(checked_step, single=False)(F, G, Qc, dt)


def _expm(M: Any) -> Any:
    """``scipy.linalg.expm``, which takes one matrix of a stack after the other: by a kernel that takes all.

    That is the series of :func:`engine.discretize`, which filters have on their tape. Where entries of very
    different size let the two differ already here, it is recorded as other functions of SciPy are.
    """
    entries = np.asarray(_nested(M))
    if entries.ndim == 2 and has_traced([entries]):
        values = [getattr(x, "value", x) for x in entries.ravel().tolist()]
        F = np.reshape(values, entries.shape)
        if np.isfinite(F).all():
            with np.errstate(all="ignore"):
                own, by_kernel = scipy.linalg.expm(F), discretize(F, dt=1.0)[0]
            if (np.abs(own - by_kernel) <= ALIKE * np.abs(own)).all():
                return _discretize(M, dt=1.0)[0]
    return of_library(scipy.linalg.expm)(M)


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    """``np.linalg.norm`` of vectors."""
    if ord not in (None, 2) or isinstance(axis, tuple) or (axis is None and np.ndim(x) != 1):
        raise UntraceableError
    return np.sqrt(_sum(np.square(_nested(x)), axis=axis, keepdims=keepdims))


def _sinc(x: Any) -> Any:
    """``np.sinc``."""
    x = np.multiply(x, np.pi)
    return _where(np.equal(x, 0.0), 1.0, np.sin(x) / _where(np.equal(x, 0.0), 1.0, x))


def _rounded(x: Any, decimals: int = 0) -> Any:
    """``np.round``."""
    if decimals < 0:
        raise UntraceableError
    return np.rint(x * 10.0**decimals) / 10.0**decimals if decimals else np.rint(x)


def _all_close(x: Any, y: Any, rtol: float = 1e-5, atol: float = 1e-8) -> Any:
    """``np.isclose``."""
    return within(x, y, np.add(atol, np.multiply(rtol, np.abs(y))))


def _select(conditions: Any, choices: Any, default: Any = 0) -> Any:
    """``np.select``."""
    out = default
    for condition, choice in zip(conditions[::-1], choices[::-1], strict=True):
        out = _where(condition, choice, out)
    return out


def _piecewise(x: Any, condlist: Any, funclist: Any, *args: Any, **options: Any) -> Any:
    """``np.piecewise``: the last condition that holds decides."""
    each = [one(x, *args, **options) if callable(one) else one for one in funclist]
    conditions = condlist if isinstance(condlist, list | tuple) else [condlist]
    out = each[len(conditions)] if len(each) > len(conditions) else 0.0
    for condition, height in zip(conditions, each, strict=False):
        out = _where(condition, height, out)
    return out


class Between:
    """``np.interp`` between ``points`` (n,), with ``heights`` (n,); where there are none they are operands."""

    def __init__(self, points: Array, heights: Array) -> None:
        self.points, self.heights = points, heights

    def __call__(self, x: Any, *heights: Any) -> Any:
        """The height at x, numbers or (M,)."""
        points = self.points
        if not heights:
            return np.interp(x, points, self.heights)
        at = np.clip(np.searchsorted(points, x, side="right") - 1, 0, len(points) - 2)
        low, high = np.choose(at, heights[:-1]), np.choose(at, heights[1:])
        inside = low + (high - low) / (points[at + 1] - points[at]) * (x - points[at])
        ends = np.where(x >= points[-1], heights[-1], inside)
        return np.where(x <= points[0], heights[0], ends)


def _interp(x: Any, xp: Any, fp: Any, **options: Any) -> Any:
    """``np.interp`` between points at the same places."""
    xp, fp = (np.asarray(_nested(each)) for each in (xp, fp))
    if options or has_traced(xp):
        raise UntraceableError
    xp, moving = xp.astype(float), has_traced(fp)
    increasing = len(xp) > 1 and (np.diff(xp) > 0.0).all()
    if moving and not (increasing and len(xp) <= CHOICES):
        raise UntraceableError
    if not (moving or increasing):
        return _each(lambda value: np.interp(value, xp, fp.astype(float)))(x)
    curve = Between(xp, np.empty(0) if moving else fp.astype(float))
    heights = fp.tolist() if moving else []
    if not has_traced([x, heights]):
        return opened(curve(as_numbers(x), *heights))
    each = np.frompyfunc(lambda value: record(curve, (value, *heights)), 1, 1)
    return traced_array(each(np.asarray(_as_objects(x)).view(np.ndarray)))


def _searched(grid: Any, x: Any, side: str = "left") -> Any:
    """``np.searchsorted`` in a grid of numbers."""
    if has_traced(grid):
        raise UntraceableError
    plain = np.asarray(_as_objects(x)).view(np.ndarray)
    return traced_array(np.frompyfunc(lambda one: searched(grid, one, side), 1, 1)(plain))


def _clip(x: Any, a_min: Any = None, a_max: Any = None) -> Any:
    """``np.clip``."""
    x = x if a_min is None else np.maximum(x, a_min)
    return x if a_max is None else np.minimum(x, a_max)


def _sum(x: Any, axis: Any = None, **options: Any) -> Any:
    """``np.sum``, which counts what is true."""
    return applied(np.add, "reduce", (_nested(x),), {"axis": axis, **options})


def _mean(x: Any, axis: Any = None, **options: Any) -> Any:
    """``np.mean``."""
    entries = np.asarray(_nested(x)).view(np.ndarray)
    if entries.ndim == 0:
        return x
    shape = entries.shape if axis is None else np.take(entries.shape, axis)
    return _sum(x, axis=axis, **options) / float(np.prod(shape))


def _errstate(**options: Any) -> Any:
    """``np.errstate``; what NumPy does in silence is recorded only."""
    if "raise" in options.values() or "call" in options.values():
        raise UntraceableError
    return np.errstate(**options)


class RowsOfNumPy:
    """``np.r_`` and ``np.c_``."""

    def __init__(self, own: Any) -> None:
        self._own = own

    def __getitem__(self, key: Any) -> Any:
        return opened(self._own[key])


def vectorized(own: Any, function: Callable[..., Any]) -> Callable[..., Any]:
    """``np.vectorize`` of a function, looked into, for its object ``own``."""

    def call(*args: Any, **options: Any) -> Any:
        if options or own.signature or own.excluded:
            raise UntraceableError
        if not has_traced(args):
            return opened(own(*map(as_numbers, args)))
        plain = [np.asarray(_as_objects(x)).view(np.ndarray) for x in args]
        return traced_array(np.frompyfunc(function, len(args), 1)(*plain))

    return call


def _vectorize(function: Any, *args: Any, **options: Any) -> Any:
    """``np.vectorize`` called while a function is recorded, of one that is looked into."""
    return vectorized(np.vectorize(function, *args, **options), function)


_where = _each(np.where)
MADE = (np.zeros, np.ones, np.empty, np.eye, np.identity, np.full)
MADE_LIKE = (np.zeros_like, np.ones_like, np.empty_like)
CONTENT = (np.array, np.asarray, np.asanyarray, np.ascontiguousarray)
OF_ENTRIES: dict[Any, Any] = {
    np.where: _where,
    np.clip: unless_traced(np.clip, _clip),
    np.interp: _interp,
    np.searchsorted: unless_traced(np.searchsorted, _searched),
    np.select: unless_traced(np.select, _select),
    np.deg2rad: unless_traced(np.deg2rad, lambda x: np.multiply(x, np.pi / 180.0)),
    np.radians: unless_traced(np.radians, lambda x: np.multiply(x, np.pi / 180.0)),
    np.rad2deg: unless_traced(np.rad2deg, lambda x: np.multiply(x, 180.0 / np.pi)),
    np.degrees: unless_traced(np.degrees, lambda x: np.multiply(x, 180.0 / np.pi)),
    np.sinc: unless_traced(np.sinc, _sinc),
    np.piecewise: unless_traced(np.piecewise, _piecewise),
    np.isclose: unless_traced(np.isclose, _all_close),
    np.allclose: unless_traced(
        np.allclose, lambda *args, **options: bool(np.all(_all_close(*args, **options)))
    ),
    np.linalg.inv: inverted(np.linalg.inv),
    np.linalg.solve: solved(np.linalg.solve),
    np.linalg.norm: _norm,
    np.linalg.det: _arrays(np.linalg.det),
    np.linalg.cholesky: _arrays(np.linalg.cholesky),
    np.linalg.pinv: _arrays(np.linalg.pinv),
}
OF_NUMPY: dict[Any, Any] = {
    **OF_ENTRIES,
    **{function: _made(function) for function in (*MADE, *MADE_LIKE)},
    **{function: _content(function) for function in CONTENT},
    np.errstate: _errstate,
    np.vectorize: _vectorize,
    np.isscalar: lambda x: isinstance(x, Traced) or np.isscalar(x),
    scipy.linalg.inv: inverted(scipy.linalg.inv),
    scipy.linalg.solve: solved(scipy.linalg.solve),
    scipy.linalg.expm: _expm,
    scipy.integrate.solve_ivp: solved_ivp,
    discretize: _discretize,
}
by_entries.update({**OF_ENTRIES, np.sum: _sum, np.mean: _mean, np.round: _rounded})
