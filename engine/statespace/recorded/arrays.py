"""Arrays of numbers that write down what is calculated with them, and NumPy's functions of these."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from engine.statespace.recorded.numbers import (
    Recorder,
    Traced,
    UntraceableError,
    quiet,
    record,
    whole,
)
from engine.statespace.recorded.tables import Table, is_key, looked_up

OPENED = 1_000  # entries of an array into which a traced number may be written


def applied(ufunc: Any, method: str, inputs: Sequence[Any], options: dict[str, Any]) -> Any:
    """A function of NumPy, entry by entry; sums and products of matrices by the operators of the entries."""
    out = options.pop("out", (None,))[0]
    if not Recorder.running():  # a function remembers an array of an earlier call
        result = getattr(ufunc, method)(*map(as_numbers, inputs), **options)
        if out is None:
            return result
        out[...] = result
        return out
    plain = [boxed(x) for x in inputs]
    if method == "__call__" and ufunc.signature is None and ufunc.nout == 1:
        if options:
            raise UntraceableError
        own = quiet(ufunc)
        each = np.frompyfunc(lambda *xs: record(own, xs), ufunc.nin, 1)
        result = each(*plain)
    elif method == "reduce" and ufunc in (np.maximum, np.minimum):
        each = np.frompyfunc(lambda *xs: record(ufunc, xs), 2, 1)
        if options.get("axis", 0) is None and not options.get(
            "keepdims"
        ):  # of all entries, in a row
            plain, options = [plain[0].ravel()], {**options, "axis": 0}
        result = each.reduce(*plain, **options)
    else:
        if ufunc is np.add:
            plain[0] = np.frompyfunc(counted, 1, 1)(plain[0])
        result = getattr(ufunc, method)(*plain, **options)
    if out is not None:
        out[...] = result
        return out
    return traced_array(result)


def counted(x: Any) -> Any:
    """What is true as one, in a sum."""
    boolean = isinstance(x, Traced) and isinstance(x.value, bool | np.bool_)
    return record(np.add, (x, 0)) if boolean else x


def as_float(x: Any) -> Any:
    """What is true as one, elsewhere."""
    boolean = isinstance(x, Traced) and isinstance(x.value, bool | np.bool_)
    return record(np.multiply, (x, 1.0)) if boolean else x


def as_whole(x: Any) -> Any:
    """The whole number that ``int`` makes of it."""
    return whole(np.trunc, as_float(x)) if isinstance(x, Traced) else int(x)


def boxed(x: Any) -> Any:
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


def _by_entries(self: Any, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
    return applied(ufunc, method, inputs, options)


def _moved(
    self: Any, function: Any, types: Any, args: Iterable[Any], options: Mapping[str, Any]
) -> Any:
    return of_arrays(function, args, options)


class TracedArray(np.ndarray[Any, Any]):
    """An array of objects, numbers and traced numbers, that does what arrays of numbers do."""

    __array_ufunc__ = _by_entries
    __array_function__ = _moved  # type: ignore[assignment]

    def astype(self, dtype: Any, *args: Any, **options: Any) -> Any:
        """A copy as numbers."""
        known = {"d": as_float, "l": as_whole}.get(np.dtype(dtype).char)
        if known is None:
            return np.ndarray.astype(self, dtype, *args, **options)
        each = np.frompyfunc(known, 1, 1)(self.view(np.ndarray))
        return np.asarray(each, dtype=object).reshape(self.shape).view(TracedArray)

    def mean(self, axis: Any = None, **options: Any) -> Any:  # type: ignore[override]
        """By :func:`numpy.mean`, which has a stand-in."""
        if Recorder.running():
            return np.mean(self, axis=axis, **options)
        return super().mean(axis, **options)

    def round(self, decimals: Any = 0, **options: Any) -> Any:  # type: ignore[override]
        """By :func:`numpy.round`."""
        if Recorder.running():
            return np.round(self, decimals)
        return super().round(decimals, **options)

    def __getitem__(self, key: Any) -> Any:
        if is_key(key) and Recorder.running():
            return traced_array(looked_up(self.view(np.ndarray), key))
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
    counts = bool(entries) and all(isinstance(entry, bool | int | np.integer) for entry in entries)
    return np.array(entries, dtype=None if counts else float).reshape(x.shape)


def opened(x: Any) -> Any:
    """Arrays of numbers as such that take traced ones; everything else as it is."""
    if isinstance(x, np.ndarray) and x.dtype.char == "d" and x.size <= OPENED:
        return x.astype(object).view(TracedArray)
    if isinstance(x, np.ndarray) and x.dtype.char == "d" and x.__class__ is np.ndarray:
        return x.view(Table)
    return traced_array(x)


def _stripped(x: Any) -> Any:
    if isinstance(x, list | tuple):
        return type(x)(map(_stripped, x)) if type(x) in (list, tuple) else x
    return boxed(x)


# functions of NumPy that are not told by the entries' own operators, filled by :mod:`.stand_ins`
by_entries: dict[Any, Callable[..., Any]] = {}


def record_arrays(function: Callable[..., Any], arrays: Sequence[Any]) -> tuple[TracedArray, ...]:
    """A function of whole arrays, which returns several and takes leading axes for the rows."""
    return entries_of(record(OfArrays(function, [np.shape(x) for x in arrays]), _entries(arrays)))


def entries_of(whole: Any) -> tuple[TracedArray, ...]:
    """The arrays of a traced tuple of them, entry by entry."""
    out, place = [], -1
    for k, result in enumerate(whole.value):
        each = np.empty(result.shape, dtype=object)
        for at in np.ndindex(*result.shape):
            place += 1
            each[at] = record(Entry(k, at, place), (whole,))
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


class Entry:
    """One entry of the k-th of several arrays (..., r, c), in its ``place`` among those of all."""

    def __init__(self, k: int, at: tuple[int, ...], place: int) -> None:
        self.k, self.at, self.place = k, at, place

    def __call__(self, arrays: Any) -> Any:
        """The entry."""
        return arrays[self.k][(..., *self.at)]


def _with_axes(self: Any, key: Any) -> Any:
    """``x[..., None]``, which numbers of NumPy have; all other keys are those of sequences."""
    if not all(
        one is None or one is Ellipsis for one in (key if isinstance(key, tuple) else (key,))
    ):
        raise TypeError("a number has no entries")
    return boxed(self).view(TracedArray)[key]


def _as_type(self: Any, dtype: Any) -> Any:
    """``x.astype(int)``, which numbers of NumPy have as well."""
    return boxed(self).view(TracedArray).astype(dtype).item()


# a number among arrays is one, too
OF_NUMBERS: dict[str, Any] = {
    "__array_ufunc__": _by_entries,
    "__array_function__": _moved,
    "__getitem__": _with_axes,
    "astype": _as_type,
}
for _name, _method in OF_NUMBERS.items():
    setattr(Traced, _name, _method)
