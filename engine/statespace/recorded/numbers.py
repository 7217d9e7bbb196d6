"""Numbers that write down what is calculated with them."""

from __future__ import annotations

import functools
import operator
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self, cast

import numpy as np

LIMIT = 20_000  # operations of one path
COUNTED = 200  # whole numbers of which each has a way of its own


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
        self.numbers: dict[int, Traced] = {}
        self.booleans: set[int] = set()  # values that are true or not
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
        self.numbers[out.index] = out
        return out

    def operand(self, index: int) -> Any:
        """The value with that number: traced, or one that does not differ."""
        return self.constants[index] if index in self.constants else self.numbers[index]

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
        if isinstance(value, np.ndarray) and value.ndim == 0:  # as np.where has numbers
            value = value[()]
        of = tuple(x.index if isinstance(x, Traced) else self.constant(x) for x in operands)
        out = self.number(value)
        if isinstance(value, bool | np.bool_):
            self.booleans.add(out.index)
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
                self.operation(check_finite, (origin,))

    def condition(self, x: Traced) -> bool:
        """Whether a number counts as true, in this row."""
        self.taken_out(x)
        if x.index not in self.known:
            self.known[x.index] = bool(x.value)
            self.done.append(Condition(x.index, bool(x.value)))
        return self.known[x.index]


def _plain(make: Callable[..., Any]) -> Callable[..., Any]:
    """What no list of operations tells: of the plain number after the end only."""

    def method(x: Traced, *others: Any) -> Any:
        if x.recorder.open:
            raise UntraceableError
        return make(x.value, *others)

    return method


def _decided(make: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """What a whole number is used for: a way of its own for each, as for the answers of a condition."""

    def method(x: Traced) -> Any:
        value = x.value
        if x.recorder.open and not isinstance(value, bool | np.bool_):
            if not (isinstance(value, float) and value.is_integer() and 0.0 <= value < COUNTED):
                raise UntraceableError
            value = int(value)
            for each in range(value + 1):  # in this order on all ways
                x.recorder.condition(x.recorder.operation(np.equal, (x, float(each))))
        elif x.recorder.open:
            value = x.recorder.condition(x)
        return make(value)

    return method


class Traced:
    """A number of one row, with its place in the list of a recorder."""

    __slots__ = ("index", "recorder", "value")

    def __init__(self, recorder: Recorder, index: int, value: Any) -> None:
        self.recorder, self.index, self.value = recorder, index, value

    def __bool__(self) -> bool:
        return self.recorder.condition(self) if self.recorder.open else bool(self.value)

    def item(self) -> Any:
        """As a number of NumPy has it."""
        return self if self.recorder.open else self.value

    # no len(x), iter(x) and x[0], which a number does not have either
    __float__, __int__, __complex__ = _plain(float), _plain(int), _plain(complex)
    __index__, __hash__ = _decided(operator.index), _decided(hash)
    __str__, __repr__, __format__ = _plain(str), _plain(repr), _plain(format)
    __reduce_ex__ = _plain(lambda value, _: (type(value), (value,)))

    def __round__(self, digits: int | None = None) -> Any:
        if digits is not None or not self.recorder.open:
            return _plain(round)(self, *([] if digits is None else [digits]))
        return whole(np.rint, self)

    def __divmod__(self, other: Any) -> Any:
        return self // other, self % other

    def __rdivmod__(self, other: Any) -> Any:
        return other // self, other % self


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


def check_finite(x: Any) -> Any:
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


@functools.cache
def quiet(ufunc: Any) -> Callable[..., Any]:
    """A function of NumPy, which returns what is not finite where one of Python raises."""
    if ufunc not in RAISING:
        return cast("Callable[..., Any]", ufunc)

    def call(*operands: Any) -> Any:
        with np.errstate(all="ignore"):
            return ufunc(*operands)

    call.ufunc = ufunc  # type: ignore[attr-defined]
    return call


def _binary(ufunc: np.ufunc, back: bool) -> Callable[[Any, Any], Any]:
    def method(self: Traced, other: Any) -> Any:
        if not isinstance(other, int | float | np.number | np.bool_ | Traced):
            return NotImplemented  # arrays do it themselves
        pair = (other, self) if back else (self, other)
        self.recorder.taken_out(*pair)
        return record(ufunc, pair)

    return method


def whole(ufunc: np.ufunc, x: Any) -> Any:
    """An integer of Python, which exists for finite numbers only."""
    return record(ufunc, (record(check_finite, (x,)),))


def _whole(ufunc: np.ufunc) -> Callable[[Any], Any]:
    return lambda self: whole(ufunc, self)


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
}
WHOLE: dict[str, np.ufunc] = {"floor": np.floor, "ceil": np.ceil, "trunc": np.trunc}
for _name, _ufunc in (ARITHMETIC | COMPARISONS).items():
    setattr(Traced, f"__{_name}__", _binary(_ufunc, back=False))
for _name, _ufunc in ARITHMETIC.items():
    setattr(Traced, f"__r{_name}__", _binary(_ufunc, back=True))
for _name, _ufunc in ALONE.items():
    setattr(Traced, f"__{_name}__", _unary(_ufunc))
for _name, _ufunc in WHOLE.items():
    setattr(Traced, f"__{_name}__", _whole(_ufunc))
