"""Functions of SciPy and of NumPy's linear algebra that nothing stands in for: recorded as they are.

What such a function makes of numbers it makes of them again. So it is one operation on the list, called for
each distinct row of its numbers: for 400 rows of one parameter vector once, where all that it is given are
parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from engine.statespace.recorded.arrays import (
    as_numbers,
    boxed,
    entries_of,
    has_traced,
    opened,
    traced_array,
)
from engine.statespace.recorded.curves import pieces_of
from engine.statespace.recorded.numbers import Traced, UntraceableError, record
from engine.statespace.rows import Array, is_rows

MODULES = ("scipy.linalg", "scipy.signal", "scipy.special", "scipy.interpolate")
CURVES = "scipy.interpolate"  # its objects are called, with numbers or arrays of them
OF_LINALG = frozenset(
    getattr(np.linalg, name)
    for name in ("eig", "eigh", "eigvals", "eigvalsh", "lstsq", "qr", "slogdet", "svd")
)


def is_of_library(value: Any) -> bool:
    """Whether it is a function that is recorded as it is."""
    module = getattr(value, "__module__", None) or ""
    return (
        callable(value)
        and not isinstance(value, type)
        and (value in OF_LINALG or module.startswith(MODULES))
    )


def of_library(function: Any) -> Callable[..., Any]:
    """Such a function of traced numbers, or of arrays and lists of them."""

    def call(*args: Any, **options: Any) -> Any:
        if not has_traced([*args, *options.values()]):
            plain = {name: as_numbers(x) for name, x in options.items()}
            found = function(*map(as_numbers, args), **plain)
            return type(found)(map(opened, found)) if type(found) is tuple else opened(found)
        if any(map(callable, [*args, *options.values()])):
            raise UntraceableError  # it may have traced numbers of its own
        curve = type(function).__module__.startswith(CURVES) and len(args) == 1 and not options
        if curve and not isinstance(args[0], list | tuple):
            return _curve(function, args[0])
        return _whole(function, args, options)

    return call


def _curve(function: Any, x: Any) -> Any:
    """A curve, which takes the rows together."""
    pieces = pieces_of(function)

    def height(value: Any) -> Any:
        if pieces is not None and isinstance(value, Traced):
            return pieces(value)
        found = record(function, (value,))
        if isinstance(found, Traced) and np.ndim(found.value):
            raise UntraceableError  # of several at once
        return found

    return traced_array(np.frompyfunc(height, 1, 1)(np.asarray(boxed(x), dtype=object)))


def _whole(function: Any, args: Any, options: Any) -> Any:
    own = OfLibrary(function, args, options)
    several = own.several()
    found = entries_of(record(own, list(_traced(args)) + list(_traced(list(options.values())))))
    each = [x[()] for x in found]
    return tuple(each) if several else each[0]


class OfLibrary:
    """``function`` of ``args`` and ``options``, in which numbers are traced, by the values of these."""

    def __init__(self, function: Any, args: Any, options: Any) -> None:
        self._function, self._args, self._options = function, args, options

    def several(self) -> bool:
        """Whether it returns several arrays. Raises UntraceableError where something else."""
        given = [*_traced(self._args), *_traced(list(self._options.values()))]
        found = self._called([x.value for x in given])
        several = isinstance(found, tuple)
        for one in found if several else (found,):
            if np.asarray(one).dtype.kind not in "fi":
                raise UntraceableError
        return several

    def __call__(self, *values: Any) -> tuple[Array, ...]:
        """All that it returns, each (...) or (M, ...), for numbers or (M,)."""
        if not any(map(is_rows, values)):
            return self._arrays(values)
        table = np.stack(np.broadcast_arrays(*values), axis=1).astype(float)
        distinct, back = np.unique(table, axis=0, return_inverse=True)
        each = [self._arrays(row) for row in distinct.tolist()]
        return tuple(np.array(one)[back.ravel()] for one in zip(*each, strict=True))

    def _arrays(self, values: Any) -> tuple[Array, ...]:
        found = self._called(values)
        return tuple(
            np.asarray(x, float) for x in (found if isinstance(found, tuple) else (found,))
        )

    def _called(self, values: Any) -> Any:
        rest = iter(values)
        args, options = (
            _filled(self._args, rest),
            {k: _filled(x, rest) for k, x in self._options.items()},
        )
        with np.errstate(all="ignore"):
            return self._function(*args, **options)


def _traced(given: Any) -> Iterator[Traced]:
    """The traced numbers in it, in their order."""
    if isinstance(given, Traced):
        yield given
    elif isinstance(given, list | tuple):
        for one in given:
            yield from _traced(one)
    elif isinstance(given, np.ndarray) and given.dtype == object:
        yield from _traced(given.ravel().tolist())


def _filled(given: Any, values: Iterator[Any]) -> Any:
    """The same with their values."""
    if isinstance(given, Traced):
        return next(values)
    if type(given) in (list, tuple):
        return type(given)([_filled(one, values) for one in given])
    if isinstance(given, np.ndarray) and given.dtype == object:
        each = [_filled(one, values) for one in given.ravel().tolist()]
        return np.array(each, dtype=float).reshape(given.shape)
    return given
