"""What a function finds under its global names while it is recorded, so that traced numbers get through."""

from __future__ import annotations

import builtins
import math
import sys
from collections.abc import Callable
from functools import partial
from types import BuiltinFunctionType, CellType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
import scipy.linalg
import scipy.special

from engine.statespace.discretization import discretize
from engine.statespace.recorded.numbers import (
    Traced,
    TracedArray,
    UntraceableError,
    by_entries,
    has_traced,
    record,
    record_arrays,
    traced_array,
)

# packages whose functions are not looked into
KNOWN = frozenset({*sys.stdlib_module_names, "numpy", "scipy", "numba", "engine"})
OF_NUMPY = (FunctionType, BuiltinFunctionType, type(np.diag))


def _each(function: Callable[..., Any]) -> Callable[..., Any]:
    """By entries of the arguments, numbers or arrays of them."""

    def call(*operands: Any) -> Any:
        if not has_traced(operands):
            return traced_array(function(*map(_as_numbers, operands)))
        if any(isinstance(x, np.ndarray | list | tuple) for x in operands):
            plain = [np.asarray(_as_objects(x)).view(np.ndarray) for x in operands]
            found = np.frompyfunc(lambda *xs: record(function, xs), len(operands), 1)(*plain)
            return traced_array(found)
        return record(function, operands)

    return call


def _as_numbers(x: Any) -> Any:
    """Arrays of objects that are numbers, as numbers."""
    return np.asarray(x, dtype=float) if isinstance(x, TracedArray) else x


def _as_objects(x: Any) -> Any:
    if isinstance(x, Traced):
        box = np.empty((), dtype=object)
        box[()] = x
        return box
    return np.asarray(x, dtype=object)


def _plain_or(function: Callable[..., Any], ufunc: Callable[..., Any]) -> Callable[..., Any]:
    """A function of numbers, by another of rows where they are traced."""

    def call(*operands: Any) -> Any:
        if not has_traced(operands):
            return function(*operands)
        return record(ufunc, [x.item() if isinstance(x, TracedArray) else x for x in operands])

    return call


def _made(function: Callable[..., Any]) -> Callable[..., Any]:
    """A new array of numbers that takes traced ones."""

    def call(*args: Any, **options: Any) -> Any:
        dtype = _kind(options.pop("dtype", None))
        if dtype is not None and np.dtype(dtype).kind != "f":
            return function(*args, dtype=dtype, **options)
        if function is np.full and has_traced(args):
            return np.full(args[0], args[1], dtype=object).view(TracedArray)
        if args and isinstance(args[0], TracedArray):  # np.zeros_like(x)
            args = (np.zeros(args[0].shape), *args[1:])
        return _opened(function(*args, **options))

    return call


def _content(function: Callable[..., Any]) -> Callable[..., Any]:
    """An array made of what is given."""

    def call(given: Any, dtype: Any = None, **options: Any) -> Any:
        dtype = _kind(dtype)
        if has_traced(given):
            if np.dtype(dtype or float).kind != "f":
                raise UntraceableError
            return _nested(given)
        return _opened(function(given, dtype=dtype, **options))

    return call


def _kind(dtype: Any) -> Any:
    """The type for which a stand-in is."""
    return KINDS.get(dtype, dtype) if callable(dtype) else dtype


def _opened(array: Any) -> Any:
    """An array of numbers as one that takes traced ones."""
    if isinstance(array, np.ndarray) and array.dtype.kind == "f":
        return array.astype(object).view(TracedArray)
    return array


def _nested(given: Any) -> Any:
    """An array of objects of nested lists whose innermost entries are numbers or arrays of one shape."""
    if isinstance(given, list | tuple):
        return np.stack([np.asarray(_nested(one)) for one in given]).view(TracedArray)
    return _as_objects(given).copy().view(TracedArray)


def _arrays(function: Callable[..., Any], single: bool = True) -> Callable[..., Any]:
    """A function of whole matrices that takes leading axes."""

    def call(*arrays: Any) -> Any:
        if not has_traced([np.asarray(_nested(x)) for x in arrays]):
            out = function(*map(_as_numbers, arrays))
            return out
        found = record_arrays(lambda *xs: (function(*xs),) if single else function(*xs), arrays)
        return found[0] if single else found

    return call


def _solve(A: Any, b: Any) -> Any:
    """``np.linalg.solve``, of a vector or a matrix."""
    if np.ndim(b) == 2:
        return _arrays(np.linalg.solve)(A, b)
    return _arrays(lambda A, b: np.linalg.solve(A, b[..., None])[..., 0])(A, b)


def _discretize(F: Any, G: Any = None, Qc: Any = None, *, dt: Any) -> Any:
    """:func:`engine.discretize` of traced matrices."""
    n = np.shape(F)[-1]
    G = np.zeros((n, 0)) if G is None else G
    Qc = np.zeros((n, n)) if Qc is None else Qc
    if np.ndim(F) > 2 or np.ndim(dt) > 0:
        raise UntraceableError
    return _arrays(lambda F, G, Qc, dt: discretize(F, G, Qc, dt=dt), single=False)(F, G, Qc, dt)


def _log(x: Any, base: Any = None) -> Any:
    """``math.log``."""
    own = _plain_or(math.log, np.log)
    return own(x) if base is None else own(x) / own(base)


def _extreme(function: Callable[..., Any], ufunc: np.ufunc) -> Callable[..., Any]:
    """``max`` or ``min`` of numbers."""

    def call(*given: Any, **options: Any) -> Any:
        values = list(given[0]) if len(given) == 1 else list(given)
        if options or not has_traced(values):
            return function(*given, **options)
        out = values[0]
        for value in values[1:]:
            out = record(
                ufunc, [x.item() if isinstance(x, TracedArray) else x for x in (out, value)]
            )
        return out

    return call


def _number(kind: type) -> Callable[..., Any]:
    """``float`` and the like."""

    def call(x: Any = 0.0) -> Any:
        x = x.item() if isinstance(x, TracedArray) else x
        return x if isinstance(x, Traced) else kind(x)

    return call


def _isinstance(x: Any, kinds: Any) -> bool:
    """What the number that is traced is."""
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    own = tuple(KINDS.get(kind, kind) for kind in kinds)
    if isinstance(x, Traced):
        return isinstance(float(x.value) if isinstance(x.value, float) else x.value, own)
    return isinstance(x, own)


def _norm(x: Any) -> Any:
    """``np.linalg.norm`` of a vector."""
    if np.ndim(x) != 1:
        raise UntraceableError
    return np.sqrt(sum(_as_objects(x).view(TracedArray) ** 2))


IN_MATH = {
    **{
        getattr(math, name): getattr(np, name)
        for name in (
            *(
                "exp",
                "expm1",
                "log2",
                "log10",
                "log1p",
                "sqrt",
                "sin",
                "cos",
                "tan",
                "sinh",
                "cosh",
            ),
            *("tanh", "hypot", "fabs", "floor", "ceil", "trunc", "fmod", "copysign", "degrees"),
            *("radians", "isnan", "isfinite", "isinf"),
        )
    },
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
    math.gamma: scipy.special.gamma,
    math.lgamma: scipy.special.gammaln,
}
STAND_INS: dict[Any, Any] = {
    **{function: _plain_or(function, ufunc) for function, ufunc in IN_MATH.items()},
    math.log: _log,
    **{
        function: _made(function) for function in (np.zeros, np.ones, np.empty, np.eye, np.identity)
    },
    **{
        function: _made(function)
        for function in (np.full, np.zeros_like, np.ones_like, np.empty_like)
    },
    **{function: _content(function) for function in (np.array, np.asarray, np.ascontiguousarray)},
    np.asanyarray: _content(np.asanyarray),
    np.where: _each(np.where),
    np.clip: _each(np.clip),
    np.interp: _each(np.interp),
    np.linalg.inv: _arrays(np.linalg.inv),
    np.linalg.solve: _solve,
    np.linalg.norm: _norm,
    scipy.linalg.inv: _arrays(np.linalg.inv),
    scipy.linalg.solve: _solve,
    scipy.linalg.expm: _arrays(scipy.linalg.expm),
    discretize: _discretize,
    np.isscalar: lambda x: isinstance(x, Traced) or np.isscalar(x),
    np.float64: _number(np.float64),
    float: _number(float),
    isinstance: _isinstance,
    max: _extreme(max, np.maximum),
    min: _extreme(min, np.minimum),
}
KINDS = {STAND_INS[kind]: kind for kind in (np.float64, float)}
NAMES = {name: STAND_INS[getattr(builtins, name)] for name in ("float", "isinstance", "max", "min")}


def _interp(x: Any, xp: Any, fp: Any, **options: Any) -> Any:
    """``np.interp`` between points that do not differ."""
    if options or has_traced([xp, fp]):
        raise UntraceableError
    xp, fp = (np.asarray(each, dtype=float) for each in (xp, fp))
    return _each(lambda value: np.interp(value, xp, fp))(x)


STAND_INS[np.interp] = _interp
by_entries.update({function: STAND_INS[function] for function in (np.where, np.clip, np.interp)})
by_entries.update(
    {function: STAND_INS[function] for function in (np.linalg.inv, np.linalg.solve, np.linalg.norm)}
)


class _Module:
    """A module whose functions take traced numbers."""

    def __init__(self, module: ModuleType, seen: dict[int, Any]) -> None:
        self._module, self._seen = module, seen

    def __getattr__(self, name: str) -> Any:
        return stand_in(getattr(self._module, name), self._seen)


def stand_in(value: Any, seen: dict[int, Any]) -> Any:
    """What is used instead of a value under a global name; itself for most."""
    try:
        if value in STAND_INS:
            return STAND_INS[value]
    except TypeError:  # not hashable
        return value
    if isinstance(value, ModuleType):
        return _Module(value, seen)
    if isinstance(value, OF_NUMPY) and _package_of(value) == "numpy":
        return _of_numpy(value)
    if hasattr(value, "cache_info"):  # of functools.cache: traced numbers are no keys
        value = value.__wrapped__
    if isinstance(value, FunctionType):  # looked into when it is called
        return lambda *args, **options: traceable(value, seen)(*args, **options)
    if isinstance(value, MethodType) and isinstance(value.__func__, FunctionType):
        return MethodType(traceable(value.__func__, seen), value.__self__)
    if isinstance(value, partial):
        return partial(stand_in(value.func, seen), *value.args, **value.keywords)
    return value


def _package_of(function: Any) -> str:
    return str(function.__module__).partition(".")[0]


def _of_numpy(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *args, **options: traced_array(function(*args, **options))


def traceable(function: Any, seen: dict[int, Any] | None = None) -> Any:
    """The same function with stand-ins under its global and enclosing names."""
    seen = {} if seen is None else seen
    if not isinstance(function, FunctionType):
        return stand_in(function, seen)
    if _package_of(function) in KNOWN:
        return function
    if id(function) not in seen:
        names = dict(function.__globals__)
        closure = tuple(CellType() for _ in function.__closure__ or ())
        own = FunctionType(
            function.__code__, names, function.__name__, function.__defaults__, closure or None
        )
        own.__kwdefaults__ = function.__kwdefaults__
        seen[id(function)] = own
        for name in _names_of(function.__code__) & names.keys():
            names[name] = stand_in(names[name], seen)
        names.update({name: value for name, value in NAMES.items() if name not in names})
        for cell, original in zip(closure, function.__closure__ or (), strict=True):
            cell.cell_contents = stand_in(original.cell_contents, seen)
    return seen[id(function)]


def _names_of(code: Any) -> set[str]:
    """Global names in a function and in those within it."""
    inner = (const for const in code.co_consts if hasattr(const, "co_names"))
    return {*code.co_names}.union(*map(_names_of, inner))
