"""Numbers that write down what is calculated with them."""

from __future__ import annotations

import functools
import math
import operator
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Self, cast

import numpy as np

LIMIT = 20_000  # operations of one path
OPENED = 1_000  # entries of an array into which a traced number may be written


class UntraceableError(BaseException):
    """Something was done with a number that no list of operations tells.

    No ``Exception``: a function that catches those must not go on with something else. ``raised`` counts them
    in this thread, for functions that catch everything.
    """

    here = threading.local()

    def __init__(self) -> None:
        UntraceableError.here.raised = UntraceableError.raised() + 1

    @classmethod
    def raised(cls) -> int:
        """How many there were in this thread."""
        return int(getattr(cls.here, "raised", 0))


class Operation(NamedTuple):
    """``function`` of the values numbered ``of``; its result is the value numbered ``out``."""

    function: Callable[..., Any]
    of: tuple[int, ...]
    out: int


class Condition(NamedTuple):
    """The value numbered ``of`` counted as true or not."""

    of: int
    held: bool


class Recorder:
    """What a function does, in its order; ``constants`` are values that are the same for all rows."""

    now = threading.local()  # ``running``: those at work in this thread

    def __init__(self) -> None:
        self.done: list[Operation | Condition] = []
        self.constants: dict[int, Any] = {}
        self.known: dict[int, bool] = {}  # conditions met already
        self.origins: dict[int, dict[int, Traced]] = {}  # what is finite where these values are
        self.finite: set[int] = set()  # values of which it is looked at already
        self.values = 0
        self.of_states: set[int] = set()  # values that depend on nonlinear states
        self.goes_by_rows = False  # whether it takes one of those out of an array
        self.open = True  # whoever remembers a number after the end has the plain one
        self.failed: Exception | None = None  # of an operation, which the function may have caught

    def __enter__(self) -> Self:
        Recorder.now.running = Recorder.running() + 1
        return self

    def __exit__(self, *_: object) -> None:
        self.open = False
        Recorder.now.running -= 1

    @classmethod
    def running(cls) -> int:
        """How many are at work in this thread."""
        return int(getattr(cls.now, "running", 0))

    def taken_out(self, *numbers: Any) -> None:
        """Numbers that are worked with by themselves, where arrays of them would be as well."""
        self.goes_by_rows = self.goes_by_rows or any(
            isinstance(x, Traced) and x.index in self.of_states for x in numbers
        )

    def number(self, value: Any) -> Traced:
        """An argument of the function, or a result."""
        self.values += 1
        out = Traced(self, self.values - 1, value)
        self.origins[out.index] = {out.index: out}
        return out

    def constant(self, value: Any) -> int:
        """The number of a value that does not differ."""
        self.values += 1
        self.constants[self.values - 1] = value
        return self.values - 1

    def operation(self, function: Callable[..., Any], operands: Sequence[Any]) -> Traced:
        """The result of a function of numbers, some of them traced."""
        if len(self.done) >= LIMIT:
            raise UntraceableError
        if any(isinstance(x, Traced) and x.recorder is not self for x in operands):
            raise UntraceableError  # remembered from another call
        values = [x.value if isinstance(x, Traced) else x for x in operands]
        if function not in OF_BOOLEANS and all(isinstance(x, bool | np.bool_) for x in values):
            raise UntraceableError  # True + True is 2 in Python and True in NumPy
        try:
            value = function(*values)
        except Exception as error:
            self.failed = error
            raise
        of = tuple(x.index if isinstance(x, Traced) else self.constant(x) for x in operands)
        out = self.number(value)
        if not self.of_states.isdisjoint(of):
            self.of_states.add(out.index)
        self.done.append(Operation(function, of, out.index))
        if function in NUMPYS and all(np.isfinite(value) for value in values):
            own = (self.origins[x.index] for x in operands if isinstance(x, Traced))
            self.origins[out.index] = {i: x for each in own for i, x in each.items()}
        return out

    def require_finite(self, x: Traced) -> None:
        """What is recorded does not hold for rows in which x is no number, or infinite."""
        for i, origin in self.origins[x.index].items():
            if i not in self.finite:
                self.finite.add(i)
                self.operation(_check_finite, (origin,))

    def condition(self, x: Traced) -> bool:
        """Whether a number counts as true, in this row."""
        self.taken_out(x)
        if x.index not in self.known:
            self.known[x.index] = bool(x.value)
            self.done.append(Condition(x.index, bool(x.value)))
        return self.known[x.index]


def record(function: Callable[..., Any], operands: Sequence[Any]) -> Any:
    """A function of numbers, written down where any of them is traced."""
    traced = next((x for x in operands if isinstance(x, Traced) and x.recorder.open), None)
    if traced is None:
        return function(*(x.value if isinstance(x, Traced) else x for x in operands))
    simple = _simplified(function, operands) if len(operands) == 2 else None
    return traced.recorder.operation(function, operands) if simple is None else simple


def _simplified(function: Callable[..., Any], operands: Sequence[Any]) -> Any:
    """x + 0, x - 0, 1 x, x / 1 and 0 x, of which products of matrices are full; None for all others."""
    for (x, y), neutral in ((operands, NEUTRAL), (operands[::-1], NEUTRAL_BEFORE)):
        if isinstance(x, Traced) and not isinstance(y, Traced) and isinstance(x.value, float):
            if neutral.get(function) == y:
                return x
            if function is np.multiply and y == 0:
                x.recorder.require_finite(x)
                return 0.0
    return None


def _check_finite(x: Any) -> Any:
    """0 x is 0 for these only."""
    if not np.isfinite(x).all():
        raise FloatingPointError("not a finite number")
    return x


NEUTRAL_BEFORE: dict[Any, int] = {np.add: 0, np.multiply: 1}
NEUTRAL: dict[Any, int] = {**NEUTRAL_BEFORE, np.subtract: 0, np.true_divide: 1}
# functions that raise, while recordings are gone through, where they make of finite numbers others
NUMPYS = frozenset(x for x in vars(np).values() if isinstance(x, np.ufunc))
RAISING = frozenset(
    {
        *(np.true_divide, np.floor_divide, np.remainder, np.fmod, np.power, np.float_power, np.exp),
        *(np.exp2, np.expm1, np.log, np.log2, np.log10, np.log1p, np.sqrt, np.sinh, np.cosh),
        *(np.arcsin, np.arccos, np.arccosh, np.arctanh, np.reciprocal),
    }
)
# functions that do the same to booleans of Python and of NumPy
OF_BOOLEANS = frozenset(
    {
        *(np.logical_and, np.logical_or, np.logical_xor, np.logical_not, np.where, np.multiply),
        *(np.bitwise_and, np.bitwise_or, np.bitwise_xor, np.invert, np.equal, np.not_equal),
        *(np.less, np.less_equal, np.greater, np.greater_equal, np.maximum, np.minimum),
    }
)


def applied(ufunc: Any, method: str, inputs: Sequence[Any], options: dict[str, Any]) -> Any:
    """A function of NumPy, entry by entry; sums and products of matrices by the operators of the entries."""
    out = options.pop("out", (None,))[0]
    if not Recorder.running():  # a function remembers an array of an earlier call
        result = getattr(ufunc, method)(*map(as_numbers, inputs), **options)
        if out is None:
            return result
        out[...] = result
        return out
    plain = [_boxed(x) for x in inputs]
    if method == "__call__" and ufunc.signature is None and ufunc.nout == 1:
        if options:
            raise UntraceableError
        own = quiet(ufunc)
        each = np.frompyfunc(lambda *xs: record(own, xs), ufunc.nin, 1)
        result = each(*plain)
    elif method == "reduce" and ufunc in (np.maximum, np.minimum):
        each = np.frompyfunc(lambda *xs: record(ufunc, xs), 2, 1)
        result = each.reduce(*plain, **options)
    else:
        if ufunc is np.add:
            plain[0] = np.frompyfunc(counted, 1, 1)(plain[0])
        result = getattr(ufunc, method)(*plain, **options)
    if out is not None:
        out[...] = result
        return out
    return traced_array(result)


@functools.cache
def quiet(ufunc: Any) -> Callable[..., Any]:
    """A function of NumPy, which returns what is not finite where one of Python raises."""
    if ufunc not in RAISING:
        return cast("Callable[..., Any]", ufunc)

    def call(*operands: Any) -> Any:
        with np.errstate(all="ignore"):
            return ufunc(*operands)

    return call


def counted(x: Any) -> Any:
    """What is true as one, in a sum."""
    boolean = isinstance(x, Traced) and isinstance(x.value, bool | np.bool_)
    return record(np.add, (x, 0)) if boolean else x


def as_float(x: Any) -> Any:
    """What is true as one, elsewhere."""
    boolean = isinstance(x, Traced) and isinstance(x.value, bool | np.bool_)
    return record(np.multiply, (x, 1.0)) if boolean else x


def _boxed(x: Any) -> Any:
    """Without the overrides that called this."""
    if isinstance(x, Traced):
        box = np.empty((), dtype=object)
        box[()] = x
        return box
    return x.view(np.ndarray) if isinstance(x, TracedArray) else x


def traced_array(x: Any) -> Any:
    """Arrays of objects as arrays of traced numbers; everything else as it is."""
    if isinstance(x, np.ndarray) and x.dtype == object and x.__class__ is not TracedArray:
        return x.view(TracedArray)
    return x


def has_traced(x: Any) -> bool:
    """Whether there is a traced number in it."""
    if isinstance(x, np.ndarray):
        return x.dtype == object and any(isinstance(entry, Traced) for entry in x.flat)
    if isinstance(x, list | tuple):
        return any(map(has_traced, x))
    return isinstance(x, Traced)


def record_arrays(function: Callable[..., Any], arrays: Sequence[Any]) -> tuple[TracedArray, ...]:
    """A function of whole arrays, which returns several and takes leading axes for the rows."""
    whole = record(OfArrays(function, [np.shape(x) for x in arrays]), _entries(arrays))
    out = []
    for k, result in enumerate(whole.value):
        each = np.empty(result.shape, dtype=object)
        for at in np.ndindex(*result.shape):
            each[at] = record(_Entry(k, at), (whole,))
        out.append(each.view(TracedArray))
    return tuple(out)


def _entries(arrays: Sequence[Any]) -> list[Any]:
    return [entry for x in arrays for entry in np.asarray(x, dtype=object).flat]


class OfArrays:
    """``function`` of arrays of some shapes, given by their entries, numbers or (M,)."""

    def __init__(self, function: Callable[..., Any], shapes: Sequence[tuple[int, ...]]) -> None:
        self.function, self.shapes = function, shapes

    def __call__(self, *values: Any) -> Any:
        """What the function returns, for the entries of its arrays one after the other."""
        lead = next((np.shape(value) for value in values if np.ndim(value)), ())
        arrays, i = [], 0
        for shape in self.shapes:
            n = math.prod(shape)
            array = np.empty((*lead, n))
            for j in range(n):
                array[..., j] = values[i + j]
            arrays.append(array.reshape((*lead, *shape)))
            i += n
        return self.function(*arrays)


class _Entry:
    """One entry of the k-th of several arrays (..., r, c)."""

    def __init__(self, k: int, at: tuple[int, ...]) -> None:
        self.k, self.at = k, at

    def __call__(self, arrays: Any) -> Any:
        return arrays[self.k][(..., *self.at)]


def _plain(make: Callable[..., Any]) -> Callable[..., Any]:
    """What no list of operations tells: of the plain number after the end only."""

    def method(x: Traced, *others: Any) -> Any:
        if x.recorder.open:
            raise UntraceableError
        return make(x.value, *others)

    return method


class TracedArray(np.ndarray[Any, Any]):
    """An array of objects, numbers and traced numbers, that does what arrays of numbers do."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return applied(ufunc, method, inputs, options)

    def __array_function__(
        self, function: Any, types: Any, args: Iterable[Any], options: Mapping[str, Any]
    ) -> Any:
        return of_arrays(function, args, options)

    def astype(self, dtype: Any, *args: Any, **options: Any) -> Any:
        """A copy as numbers."""
        if np.dtype(dtype).char != "d":
            return np.ndarray.astype(self, dtype, *args, **options)
        return traced_array(
            np.frompyfunc(as_float, 1, 1)(self.view(np.ndarray)).reshape(self.shape)
        )

    def __getitem__(self, key: Any) -> Any:
        return super().__getitem__(_decided(key))

    def __setitem__(self, key: Any, value: Any) -> None:
        super().__setitem__(_decided(key), value)


def _decided(key: Any) -> Any:
    """An index of which conditions are a part, with their answers."""
    if isinstance(key, tuple):
        return tuple(map(_decided, key))
    if isinstance(key, Traced) and isinstance(key.value, bool | np.bool_):
        return bool(key)
    if isinstance(key, np.ndarray) and key.dtype == object:
        answers = [_decided(x) for x in key.flat]
        return np.array(answers, dtype=None if answers else bool).reshape(key.shape)
    return key


def of_arrays(function: Any, args: Iterable[Any], options: Mapping[str, Any]) -> Any:
    """A function of NumPy on arrays of objects: ``append``, ``stack``, ``diag``, ... move entries only."""
    known = by_entries.get(function)
    if known is not None and Recorder.running():
        return known(*args, **options)
    if not (Recorder.running() and has_traced([*args, *options.values()])):
        plain = {name: as_numbers(x) for name, x in options.items()}
        found = function(*map(as_numbers, args), **plain)
        return opened(found) if Recorder.running() else found
    return traced_array(function(*map(_stripped, args), **options))


def as_numbers(x: Any) -> Any:
    """Arrays of objects that are numbers, as numbers."""
    if type(x) in (list, tuple):
        return type(x)(map(as_numbers, x))
    if isinstance(x, Traced):
        return x.item()
    if not isinstance(x, TracedArray):
        return x
    entries = x.ravel().tolist()
    whole = bool(entries) and all(isinstance(entry, bool | int | np.integer) for entry in entries)
    return np.array(entries, dtype=None if whole else float).reshape(x.shape)


def opened(x: Any) -> Any:
    """Arrays of numbers as such that take traced ones; everything else as it is."""
    if isinstance(x, np.ndarray) and x.dtype.char == "d" and x.size <= OPENED:
        return x.astype(object).view(TracedArray)
    return traced_array(x)


def _stripped(x: Any) -> Any:
    if isinstance(x, list | tuple):
        return type(x)(map(_stripped, x)) if type(x) in (list, tuple) else x
    return _boxed(x)


# functions of NumPy that are not told by the entries' own operators, filled by :mod:`.stand_ins`
by_entries: dict[Any, Callable[..., Any]] = {}


class Traced:
    """A number of one row, with its place in the list of a recorder."""

    __slots__ = ("index", "recorder", "value")

    def __init__(self, recorder: Recorder, index: int, value: Any) -> None:
        self.recorder, self.index, self.value = recorder, index, value

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return applied(ufunc, method, inputs, options)

    def __array_function__(
        self, function: Any, types: Any, args: Iterable[Any], options: Mapping[str, Any]
    ) -> Any:
        return of_arrays(function, args, options)

    def __bool__(self) -> bool:
        return self.recorder.condition(self) if self.recorder.open else bool(self.value)

    def item(self) -> Any:
        """As a number of NumPy has it."""
        return self if self.recorder.open else self.value

    # no len(x), iter(x) and x[0], which a number does not have either
    __float__, __int__, __complex__ = _plain(float), _plain(int), _plain(complex)
    __index__, __round__, __hash__ = _plain(operator.index), _plain(round), _plain(hash)
    __str__, __repr__, __format__ = _plain(str), _plain(repr), _plain(format)
    __reduce_ex__ = _plain(lambda value, _: (type(value), (value,)))

    def __divmod__(self, other: Any) -> Any:
        return self // other, self % other

    def __rdivmod__(self, other: Any) -> Any:
        return other // self, other % self


def _binary(ufunc: np.ufunc, back: bool) -> Callable[[Any, Any], Any]:
    def method(self: Traced, other: Any) -> Any:
        if not isinstance(other, int | float | np.number | np.bool_ | np.ndarray | Traced):
            return NotImplemented
        pair = (other, self) if back else (self, other)
        if isinstance(other, np.ndarray):
            return applied(ufunc, "__call__", pair, {})
        self.recorder.taken_out(*pair)
        return record(ufunc, pair)

    return method


@functools.cache
def whole(ufunc: np.ufunc) -> Callable[..., Any]:
    """An integer of Python, which exists for finite numbers only."""
    return lambda x: ufunc(_check_finite(x))


def _unary(ufunc: Any) -> Callable[[Any], Any]:
    return lambda self: record(ufunc, (self,))


ARITHMETIC: dict[str, Any] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "truediv": np.true_divide,
    "floordiv": np.floor_divide,
    "mod": np.remainder,
    "pow": np.power,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
}
COMPARISONS: dict[str, Any] = {
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
}
ALONE: dict[str, Any] = {
    "neg": np.negative,
    "pos": np.positive,
    "abs": np.absolute,
    "invert": np.invert,
    "floor": whole(np.floor),
    "ceil": whole(np.ceil),
    "trunc": whole(np.trunc),
}
for _name, _ufunc in (ARITHMETIC | COMPARISONS).items():
    setattr(Traced, f"__{_name}__", _binary(_ufunc, back=False))
for _name, _ufunc in ARITHMETIC.items():
    setattr(Traced, f"__r{_name}__", _binary(_ufunc, back=True))
for _name, _ufunc in ALONE.items():
    setattr(Traced, f"__{_name}__", _unary(_ufunc))
