"""Numbers that write down what is calculated with them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

import numpy as np

LIMIT = 20_000  # operations of one path


class UntraceableError(BaseException):
    """Something was done with a number that no list of operations tells.

    No ``Exception``: a function that catches those must not go on with something else.
    """


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

    def __init__(self) -> None:
        self.done: list[Operation | Condition] = []
        self.constants: dict[int, Any] = {}
        self.known: dict[int, bool] = {}  # conditions met already
        self.values = 0
        self.of_states: set[int] = set()  # values that depend on nonlinear states
        self.goes_by_rows = False  # whether it takes one of those out of an array
        self.open = True

    def check_open(self) -> None:
        """Raise TypeError after the end, for whoever remembered a number that was traced."""
        if not self.open:
            raise TypeError(
                "a number from an earlier call, of which the function may remember nothing"
            )

    def taken_out(self, *numbers: Any) -> None:
        """Numbers that are worked with by themselves, where arrays of them would be as well."""
        self.goes_by_rows = self.goes_by_rows or any(
            isinstance(x, Traced) and x.index in self.of_states for x in numbers
        )

    def number(self, value: Any) -> Traced:
        """An argument of the function, or a result."""
        self.values += 1
        return Traced(self, self.values - 1, value)

    def constant(self, value: Any) -> int:
        """The number of a value that does not differ."""
        self.values += 1
        self.constants[self.values - 1] = value
        return self.values - 1

    def operation(self, function: Callable[..., Any], operands: Sequence[Any]) -> Traced:
        """The result of a function of numbers, some of them traced."""
        self.check_open()
        if len(self.done) >= LIMIT:
            raise UntraceableError
        if any(isinstance(x, Traced) and x.recorder is not self for x in operands):
            raise UntraceableError  # remembered from another call
        value = function(*(x.value if isinstance(x, Traced) else x for x in operands))
        of = tuple(x.index if isinstance(x, Traced) else self.constant(x) for x in operands)
        out = self.number(value)
        if not self.of_states.isdisjoint(of):
            self.of_states.add(out.index)
        self.done.append(Operation(function, of, out.index))
        return out

    def condition(self, x: Traced) -> bool:
        """Whether a number counts as true, in this row."""
        self.check_open()
        self.taken_out(x)
        if x.index not in self.known:
            self.known[x.index] = bool(x.value)
            self.done.append(Condition(x.index, bool(x.value)))
        return self.known[x.index]


def record(function: Callable[..., Any], operands: Sequence[Any]) -> Any:
    """A function of numbers, written down where any of them is traced."""
    traced = next((x for x in operands if isinstance(x, Traced)), None)
    if traced is None:
        return function(*operands)
    simple = _simplified(function, operands) if len(operands) == 2 else None
    return traced.recorder.operation(function, operands) if simple is None else simple


def _simplified(function: Callable[..., Any], operands: Sequence[Any]) -> Any:
    """x + 0, x - 0, 1 x, x / 1 and 0 x, of which products of matrices are full; None for all others."""
    for (x, y), neutral in ((operands, NEUTRAL), (operands[::-1], NEUTRAL_BEFORE)):
        if isinstance(x, Traced) and not isinstance(y, Traced):
            if neutral.get(function) == y:
                return x
            if function is np.multiply and y == 0:
                return 0.0
    return None


NEUTRAL_BEFORE: dict[Any, int] = {np.add: 0, np.multiply: 1}
NEUTRAL: dict[Any, int] = {**NEUTRAL_BEFORE, np.subtract: 0, np.true_divide: 1}


def applied(ufunc: Any, method: str, inputs: Sequence[Any], options: dict[str, Any]) -> Any:
    """A function of NumPy, entry by entry; sums and products of matrices by the operators of the entries."""
    out = options.pop("out", (None,))[0]
    plain = [_boxed(x) for x in inputs]
    if method == "__call__" and ufunc.signature is None and ufunc.nout == 1:
        if options.keys() - {"dtype", "casting", "order"}:
            raise UntraceableError
        each = np.frompyfunc(lambda *xs: record(ufunc, xs), ufunc.nin, 1)
        result = each(*plain)
    elif method == "reduce" and ufunc in (np.maximum, np.minimum):
        each = np.frompyfunc(lambda *xs: record(ufunc, xs), 2, 1)
        result = each.reduce(*plain, **options)
    else:
        result = getattr(ufunc, method)(*plain, **options)
    if out is not None:
        out[...] = result
        return out
    return traced_array(result)


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


def _refuse(x: Traced, *_: Any, **__: Any) -> NoReturn:
    x.recorder.check_open()
    raise UntraceableError


class TracedArray(np.ndarray[Any, Any]):
    """An array of objects, numbers and traced numbers, that does what arrays of numbers do."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return applied(ufunc, method, inputs, options)

    def __array_function__(
        self, function: Any, types: Any, args: Iterable[Any], options: Mapping[str, Any]
    ) -> Any:
        return of_arrays(function, args, options)

    def astype(self, dtype: Any, *args: Any, **options: Any) -> Any:
        """Itself as numbers."""
        if not isinstance(dtype, type) and callable(dtype):  # what stands in for ``float``
            return self
        return (
            self
            if np.dtype(dtype).kind == "f"
            else np.ndarray.astype(self, dtype, *args, **options)
        )


def of_arrays(function: Any, args: Iterable[Any], options: Mapping[str, Any]) -> Any:
    """A function of NumPy on arrays of objects: ``append``, ``stack``, ``diag``, ... move entries only."""
    known = by_entries.get(function)
    if known is not None:
        return known(*args, **options)
    return traced_array(function(*map(_stripped, args), **options))


def _stripped(x: Any) -> Any:
    if isinstance(x, list | tuple):
        return type(x)(map(_stripped, x)) if type(x) in (list, tuple) else x
    return _boxed(x)


# functions of NumPy that are not told by the entries' own operators, filled by :mod:`.stand_ins`
by_entries: dict[Any, Callable[..., Any]] = {}


class Traced:
    """A number of one row, with its place in the list of a recorder."""

    __slots__ = ("index", "recorder", "value")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, recorder: Recorder, index: int, value: Any) -> None:
        self.recorder, self.index, self.value = recorder, index, value

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return applied(ufunc, method, inputs, options)

    def __array_function__(
        self, function: Any, types: Any, args: Iterable[Any], options: Mapping[str, Any]
    ) -> Any:
        return of_arrays(function, args, options)

    def __bool__(self) -> bool:
        return self.recorder.condition(self)

    def item(self) -> Traced:
        """As a number of NumPy has it."""
        return self

    __float__ = __int__ = __index__ = __complex__ = __round__ = __len__ = __iter__ = _refuse
    __str__ = __repr__ = __format__ = __reduce_ex__ = __getitem__ = _refuse


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


def _unary(ufunc: np.ufunc) -> Callable[[Any], Any]:
    return lambda self: record(ufunc, (self,))


ARITHMETIC: dict[str, Any] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "truediv": np.true_divide,
    "floordiv": np.floor_divide,
    "mod": np.remainder,
    "pow": np.power,
    "and": np.logical_and,
    "or": np.logical_or,
    "xor": np.logical_xor,
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
    "invert": np.logical_not,
    "floor": np.floor,
    "ceil": np.ceil,
    "trunc": np.trunc,
}
for _name, _ufunc in (ARITHMETIC | COMPARISONS).items():
    setattr(Traced, f"__{_name}__", _binary(_ufunc, back=False))
for _name, _ufunc in ARITHMETIC.items():
    setattr(Traced, f"__r{_name}__", _binary(_ufunc, back=True))
for _name, _ufunc in ALONE.items():
    setattr(Traced, f"__{_name}__", _unary(_ufunc))
