"""What a function finds under its global names while it is recorded, so that traced numbers get through."""

from __future__ import annotations

import builtins
import dis
import math
import sys
from collections import Counter
from collections.abc import Callable
from functools import partial, reduce
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
import scipy.linalg
import scipy.special

from engine.statespace.discretization import discretize
from engine.statespace.recorded.numbers import (
    OPENED,
    Traced,
    TracedArray,
    UntraceableError,
    applied,
    as_float,
    as_numbers,
    by_entries,
    has_traced,
    opened,
    record,
    record_arrays,
    traced_array,
    whole,
)

CHOICES = 30  # points of an interpolation that differ from row to row, of which np.choose takes 32
# packages whose functions are not looked into
KNOWN = frozenset({*sys.stdlib_module_names, "numpy", "scipy", "numba", "engine"})
OF_NUMPY = (FunctionType, BuiltinFunctionType, type(np.diag))


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


def _made(function: Any) -> Callable[..., Any]:
    """A new array of numbers that takes traced ones."""

    def call(*args: Any, **options: Any) -> Any:
        dtype = _kind(options.pop("dtype", None))
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
        dtype = _kind(dtype)
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


def _kind(dtype: Any) -> Any:
    """The type for which a stand-in is."""
    return KINDS.get(dtype, dtype) if callable(dtype) else dtype


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


def _unless_traced(function: Callable[..., Any], own: Callable[..., Any]) -> Callable[..., Any]:
    """A function, or what does the same with traced numbers."""

    def call(*args: Any, **options: Any) -> Any:
        if has_traced([*args, *options.values()]):
            return own(*args, **options)
        return opened(function(*map(as_numbers, args), **options))

    return call


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
    return _within(x, y, np.maximum(rel_tol * np.maximum(abs(x), abs(y)), abs_tol))


def _all_close(x: Any, y: Any, rtol: float = 1e-5, atol: float = 1e-8) -> Any:
    """``np.isclose``."""
    return _within(x, y, np.add(atol, np.multiply(rtol, np.abs(y))))


def _within(x: Any, y: Any, allowed: Any) -> Any:
    """Whether two are equal or no further apart than is allowed, which infinite ones always are."""
    apart = np.abs(np.subtract(x, y))
    return np.equal(x, y) | (np.less_equal(apart, allowed) & np.isfinite(apart))


def _select(conditions: Any, choices: Any, default: Any = 0) -> Any:
    """``np.select``."""
    out = default
    for condition, choice in zip(conditions[::-1], choices[::-1], strict=True):
        out = STAND_INS[np.where](condition, choice, out)
    return out


def _larger(x: Any, y: Any) -> Any:
    """``max`` of Python, the first of both where one is NaN."""
    return np.where(np.greater(y, x), y, x)


def _smaller(x: Any, y: Any) -> Any:
    """``min`` of Python."""
    return np.where(np.less(y, x), y, x)


def _of_numbers_only(function: Callable[..., Any]) -> Callable[..., Any]:
    """``gamma`` and the like of :mod:`math`, which raise where those of arrays give what is not finite."""

    def call(x: Any) -> Any:
        out = function(x)
        if not np.isfinite(out).all():
            raise FloatingPointError("not a finite number")
        return out

    return call


def _errstate(**options: Any) -> Any:
    """``np.errstate``; what NumPy does in silence is recorded only."""
    if "raise" in options.values() or "call" in options.values():
        raise UntraceableError
    return np.errstate(**options)


class _Rows:
    """``np.r_`` and ``np.c_``."""

    def __init__(self, own: Any) -> None:
        self._own = own

    def __getitem__(self, key: Any) -> Any:
        return opened(self._own[key])


def _extreme(function: Callable[..., Any], own: Callable[..., Any]) -> Callable[..., Any]:
    """``max`` or ``min`` of numbers."""

    def call(*given: Any, **options: Any) -> Any:
        values = list(given[0]) if len(given) == 1 else list(given)
        if options or not has_traced(values):
            return function(values, **options)
        out = values[0]
        for value in values[1:]:
            out = record(own, [x.item() if isinstance(x, TracedArray) else x for x in (out, value)])
        return out

    return call


class _Number:
    """``float`` and the like: called, and given as a type."""

    def __init__(self, kind: Any) -> None:
        self._kind, self.dtype = kind, np.dtype(kind)

    def __call__(self, x: Any = 0.0) -> Any:
        x = x.item() if isinstance(x, TracedArray) else x
        return as_float(x) if isinstance(x, Traced) else self._kind(x)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kind, name)

    def __instancecheck__(self, x: Any) -> bool:
        return _isinstance(x, self._kind)

    def __or__(self, other: Any) -> Any:
        return self._kind | _kind(other)

    def __ror__(self, other: Any) -> Any:
        return other | self._kind


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
            *("tanh", "fabs", "fmod", "copysign", "degrees"),
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
    math.gamma: _of_numbers_only(scipy.special.gamma),
    math.lgamma: _of_numbers_only(scipy.special.gammaln),
    math.floor: whole(np.floor),
    math.ceil: whole(np.ceil),
    math.trunc: whole(np.trunc),
}
STAND_INS: dict[Any, Any] = {
    **{function: _plain_or(function, ufunc) for function, ufunc in IN_MATH.items()},
    math.log: _log,
    math.hypot: _hypot,
    math.dist: _dist,
    math.isclose: _unless_traced(math.isclose, _close),
    np.isclose: _unless_traced(np.isclose, _all_close),
    np.allclose: _unless_traced(
        np.allclose, lambda *args, **o: bool(np.all(_all_close(*args, **o)))
    ),
    np.select: _unless_traced(np.select, _select),
    np.errstate: _errstate,
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
    np.interp: _each(np.interp),
    np.linalg.inv: _arrays(np.linalg.inv),
    np.linalg.solve: _solve,
    np.linalg.norm: _norm,
    np.linalg.det: _arrays(np.linalg.det),
    np.linalg.cholesky: _arrays(np.linalg.cholesky),
    np.linalg.pinv: _arrays(np.linalg.pinv),
    scipy.linalg.inv: _arrays(np.linalg.inv),
    scipy.linalg.solve: _solve,
    scipy.linalg.expm: _arrays(scipy.linalg.expm),
    discretize: _discretize,
    np.isscalar: lambda x: isinstance(x, Traced) or np.isscalar(x),
    np.float64: _Number(np.float64),
    float: _Number(float),
    isinstance: _isinstance,
    max: _extreme(max, _larger),
    min: _extreme(min, _smaller),
}
KINDS = {STAND_INS[kind]: kind for kind in (np.float64, float)}
NAMES = {name: STAND_INS[getattr(builtins, name)] for name in ("float", "isinstance", "max", "min")}


def _interp(x: Any, xp: Any, fp: Any, **options: Any) -> Any:
    """``np.interp`` between points at the same places."""
    xp, fp = (np.asarray(_nested(each)) for each in (xp, fp))
    if options or has_traced(xp):
        raise UntraceableError
    xp = xp.astype(float)
    if not has_traced(fp):
        fp = fp.astype(float)
        return _each(lambda value: np.interp(value, xp, fp))(x)
    if (np.diff(xp) <= 0.0).any() or len(xp) < 2:
        raise UntraceableError

    def between(value: Any, *heights: Any) -> Any:
        at = np.clip(np.searchsorted(xp, value, side="right") - 1, 0, len(xp) - 2)
        low, high = np.choose(at, heights[:-1]), np.choose(at, heights[1:])
        inside = low + (high - low) / (xp[at + 1] - xp[at]) * (value - xp[at])
        ends = np.where(value >= xp[-1], heights[-1], inside)
        return np.where(value <= xp[0], heights[0], ends)

    if len(xp) > CHOICES:
        raise UntraceableError
    each = np.frompyfunc(lambda value: record(between, (value, *fp.tolist())), 1, 1)
    return traced_array(each(np.asarray(_as_objects(x)).view(np.ndarray)))


def _clip(x: Any, a_min: Any = None, a_max: Any = None) -> Any:
    """``np.clip``."""
    x = x if a_min is None else np.maximum(x, a_min)
    return x if a_max is None else np.minimum(x, a_max)


STAND_INS[np.clip] = _unless_traced(np.clip, _clip)
STAND_INS[np.interp] = _interp
by_entries.update({function: STAND_INS[function] for function in (np.where, np.clip, np.interp)})
by_entries.update(
    {
        function: STAND_INS[function]
        for function in (
            *(np.linalg.inv, np.linalg.solve, np.linalg.norm, np.linalg.det, np.linalg.cholesky),
            *(np.linalg.pinv, np.isclose, np.allclose, np.select),
        )
    }
)


def _sum(x: Any, axis: Any = None, **options: Any) -> Any:
    """``np.sum``, which counts what is true."""
    return applied(np.add, "reduce", (_nested(x),), {"axis": axis, **options})


by_entries[np.sum] = _sum


def _refuse(*_: Any, **__: Any) -> Any:
    raise UntraceableError


class _Dict(dict[Any, Any]):
    """What is there for all calls, in which none may leave something for the next."""

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse


class _List(list[Any]):
    """The same in a row; what is only appended to is a protocol, which none reads."""

    __setitem__ = __delitem__ = __iadd__ = __imul__ = clear = insert = _refuse
    extend = pop = remove = reverse = sort = _refuse

    def __init__(self, each: Any, own: list[Any]) -> None:
        super().__init__(each)
        self._own, self._read, self._written = own, False, False

    def append(self, x: Any) -> None:
        """Keep it for whoever calls the function."""
        self._used(written=True)
        self._own.append(x.value if isinstance(x, Traced) else x)

    def __getitem__(self, key: Any) -> Any:
        self._used(read=True)
        return super().__getitem__(key)

    def __iter__(self) -> Any:
        self._used(read=True)
        return super().__iter__()

    def __len__(self) -> int:
        self._used(read=True)
        return super().__len__()

    def _used(self, read: bool = False, written: bool = False) -> None:
        self._read, self._written = self._read or read, self._written or written
        if self._read and self._written:
            raise UntraceableError


def _kept(value: Any, seen: dict[int, Any]) -> Any:
    """A dictionary, list or tuple with stand-ins for what is in it, unless that is much."""

    def own(one: Any) -> Any:
        return stand_in(one, seen) if len(value) <= OPENED else one

    if isinstance(value, dict):
        return _Dict({key: own(one) for key, one in value.items()})
    each = [own(one) for one in value]
    return tuple(each) if isinstance(value, tuple) else _List(each, value)


def _constant(value: Any) -> Any:
    """An array that is there for all calls, into which none may write; anything else as it is."""
    own = opened(value)
    if own is not value:
        own.setflags(write=False)
    return own


class _Module:
    """A module whose functions take traced numbers."""

    def __init__(self, module: ModuleType, seen: dict[int, Any]) -> None:
        self._module, self._seen = module, seen

    def __getattr__(self, name: str) -> Any:
        return stand_in(getattr(self._module, name), self._seen)


def stand_in(value: Any, seen: dict[int, Any]) -> Any:
    """What is used instead of a value under a global name; itself for most."""
    if type(value) in (dict, list, tuple):
        return _kept(value, seen)
    try:
        if value in STAND_INS:
            return STAND_INS[value]
    except TypeError:  # not hashable
        return _constant(value)
    if value is np.r_ or value is np.c_:
        return _Rows(value)
    if isinstance(value, ModuleType):
        return _Module(value, seen)
    if isinstance(value, OF_NUMPY) and _package_of(value) == "numpy":
        return _of_numpy(value)
    if hasattr(value, "cache_info"):  # of functools.cache: traced numbers are no keys
        value = value.__wrapped__
    if isinstance(value, FunctionType):  # looked into when it is called
        return lambda *args, **options: traceable(value, seen)(*args, **options)
    if isinstance(value, MethodType) and isinstance(value.__func__, FunctionType):
        own = traceable(value.__func__, seen, type(value.__self__))
        return MethodType(own, value.__self__)
    if isinstance(value, partial):
        return partial(stand_in(value.func, seen), *value.args, **value.keywords)
    return value


def _package_of(function: Any) -> str:
    return str(function.__module__).partition(".")[0]


def _of_numpy(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *args, **options: opened(function(*args, **options))


def traceable(function: Any, seen: dict[int, Any] | None = None, kind: type = object) -> Any:
    """The same function with stand-ins under its global and enclosing names; of a ``kind``, if a method."""
    seen = {} if seen is None else seen
    called = type(function).__call__
    if not isinstance(function, FunctionType):
        if isinstance(called, FunctionType) and _package_of(called) not in KNOWN:
            return MethodType(traceable(called, seen, type(function)), function)
        return stand_in(function, seen)
    if _package_of(function) in KNOWN:
        return function
    if id(function) not in seen:
        if _remembers(function, kind):
            raise UntraceableError
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


def _remembers(function: FunctionType, kind: type) -> bool:
    """Whether a function, or a method it calls, reads what it leaves for its next call.

    Counting calls (``self.calls += 1``) is no reading.
    """
    loaded: Counter[Any] = Counter()
    stored: set[Any] = set()
    todo, met = [(function, kind)], set()
    while todo:
        one = todo.pop()
        if one in met:
            continue
        met.add(one)
        code, names = one[0].__code__, _names_of(one[0].__code__)
        own = _uses_of(code, {*code.co_freevars})
        loaded.update(own[0])
        stored |= own[1]
        kept = [one[0].__globals__[name] for name in names & one[0].__globals__.keys()]
        kept += [cell.cell_contents for cell in one[0].__closure__ or ()]
        for each in {one[1], *map(type, kept)}:
            if _package_of(each) not in KNOWN:
                found = [getattr(each, name, None) for name in names]
                methods = [getattr(x, "fget", x) for x in found]
                todo += [(x, each) for x in methods if isinstance(x, FunctionType)]
    return any(loaded[use] > 0 for use in stored)


def _uses_of(code: Any, free: set[str]) -> tuple[Counter[Any], set[Any]]:
    """How often names that stay are loaded but for adding to them, and which are assigned to."""
    loaded: Counter[Any] = Counter()
    stored: set[Any] = set()
    added = False
    for step in dis.get_instructions(code):
        what, _, where = step.opname.partition("_")
        use = where.removesuffix("_OR_NULL"), step.argval
        if where == "METHOD":
            use = "ATTR", step.argval
        stays = use[0] in ("GLOBAL", "ATTR") or (use[0] == "DEREF" and use[1] in free)
        if stays and what == "LOAD":
            loaded[use] += 1
        elif stays and what in ("STORE", "DELETE"):
            stored.add(use)
            loaded[use] -= added
        if step.opname not in ("SWAP", "CACHE") and not step.opname.startswith("LOAD"):
            added = step.opname == "BINARY_OP" and step.argrepr.endswith("=")
    for const in code.co_consts:
        if isinstance(const, CodeType):
            inner = _uses_of(const, free)
            loaded.update(inner[0])
            stored |= inner[1]
    return loaded, stored
