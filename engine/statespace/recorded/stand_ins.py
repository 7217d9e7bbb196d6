"""What a function finds under its global names while it is recorded, so that traced numbers get through."""

from __future__ import annotations

import builtins
from collections.abc import Callable
from functools import partial
from types import BuiltinFunctionType, CellType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from engine.statespace.recorded.arrays import OPENED, opened
from engine.statespace.recorded.left_behind import (
    KNOWN,
    KeptDict,
    KeptList,
    KeptTuple,
    names_of,
    package_of,
    remembers,
)
from engine.statespace.recorded.numbers import UntraceableError
from engine.statespace.recorded.of_libraries import is_of_library, of_library
from engine.statespace.recorded.of_numpy import OF_NUMPY, RowsOfNumPy, vectorized
from engine.statespace.recorded.of_objects import class_of, is_users, object_of
from engine.statespace.recorded.of_python import NAMES, OF_PYTHON

STAND_INS = OF_PYTHON | OF_NUMPY
OWN = "engine"
FUNCTIONS = (FunctionType, BuiltinFunctionType, type(np.diag))  # as NumPy has them


def _kept(value: Any, seen: dict[int, Any]) -> Any:
    """A dictionary, list or tuple with stand-ins for what is in it, unless that is much."""

    def own(one: Any) -> Any:
        return stand_in(one, seen) if len(value) <= OPENED else one

    if isinstance(value, dict):
        return KeptDict({key: own(one) for key, one in value.items()})
    each = [own(one) for one in value]
    return KeptTuple(each) if isinstance(value, tuple) else KeptList(each, value)


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


def _importing(seen: dict[int, Any]) -> Callable[..., Any]:
    """``import`` within a function."""
    return lambda *given, **options: stand_in(builtins.__import__(*given, **options), seen)


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
        return RowsOfNumPy(value)
    if is_of_library(value):
        return of_library(value)
    if isinstance(value, ModuleType):
        return _Module(value, seen)
    if isinstance(value, FUNCTIONS) and package_of(value) == "numpy":
        return _of_numpy(value)
    if hasattr(value, "cache_info"):  # of functools.cache: traced numbers are no keys
        value = value.__wrapped__
    if package_of(type(value)) == "numba" and hasattr(value, "py_func"):
        value = value.py_func
    if isinstance(value, FunctionType):  # looked into when it is called
        return lambda *args, **options: traceable(value, seen)(*args, **options)
    if isinstance(value, MethodType) and isinstance(value.__func__, FunctionType):
        own = traceable(value.__func__, seen, value.__self__)
        return MethodType(own, stand_in(value.__self__, seen))
    if isinstance(value, partial):
        given = {name: stand_in(one, seen) for name, one in value.keywords.items()}
        return partial(
            stand_in(value.func, seen), *(stand_in(one, seen) for one in value.args), **given
        )
    if isinstance(value, np.vectorize):
        return vectorized(value, stand_in(value.pyfunc, seen))
    return _users(value, seen)


def _users(value: Any, seen: dict[int, Any]) -> Any:
    """A class or an object of the user's own with stand-ins in its methods; itself if it is none."""
    kind = value if isinstance(value, type) else type(value)
    if id(value) in seen:
        return seen[id(value)]
    if not is_users(kind) or not (kind is value or hasattr(value, "__dict__")):
        return value
    own = partial(stand_in, seen=seen)
    if id(kind) not in seen:
        seen[id(kind)] = class_of(kind, own, lambda function, of: traceable(function, seen, of))
    return seen[id(kind)] if kind is value else object_of(value, seen[id(kind)], own, seen)


def _of_numpy(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *args, **options: opened(function(*args, **options))


class Within(dict[int, Any]):
    """Functions met, of the engine's own too, by their ids: an effect's that call a user's are looked into."""


def _is_left(function: Any, seen: dict[int, Any]) -> bool:
    """Whether it is not looked into."""
    package = package_of(function)
    return package in KNOWN and not (package == OWN and isinstance(seen, Within))


def traceable(function: Any, seen: dict[int, Any] | None = None, owner: Any = object) -> Any:
    """The same function with stand-ins under its global and enclosing names; a method of ``owner``."""
    seen = {} if seen is None else seen
    called = type(function).__call__
    if not isinstance(function, FunctionType):
        if isinstance(called, FunctionType) and not _is_left(called, seen):
            return MethodType(traceable(called, seen, function), _users(function, seen))
        return stand_in(function, seen)
    if _is_left(function, seen):
        return function
    if id(function) not in seen:
        if package_of(function) != OWN and remembers(function, owner):
            raise UntraceableError
        names = dict(function.__globals__)
        names["__builtins__"] = vars(builtins) | {"__import__": _importing(seen)}
        closure = tuple(CellType() for _ in function.__closure__ or ())
        own = FunctionType(
            function.__code__, names, function.__name__, function.__defaults__, closure or None
        )
        seen[id(function)] = own
        if function.__defaults__:
            own.__defaults__ = tuple(stand_in(value, seen) for value in function.__defaults__)
        given = function.__kwdefaults__ or {}
        own.__kwdefaults__ = {name: stand_in(value, seen) for name, value in given.items()}
        for name in names_of(function.__code__) & names.keys():
            names[name] = stand_in(names[name], seen)
        names.update({name: value for name, value in NAMES.items() if name not in names})
        free = function.__code__.co_freevars
        for name, cell, original in zip(free, closure, function.__closure__ or (), strict=True):
            given = original.cell_contents
            # super() goes on from the class itself, of which the one that stands in is a kind
            cell.cell_contents = given if name == "__class__" else stand_in(given, seen)
    return seen[id(function)]
