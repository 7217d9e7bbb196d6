"""What stands in for a user's own classes and objects while a function is recorded: with methods looked into.

A plant with its constants and methods, a curve that is called, a record made in the function: their methods are
functions under other names.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cached_property
from types import FunctionType
from typing import Any

from engine.statespace.recorded.left_behind import KNOWN, package_of

HOOKS = (
    "__new__",
    "__init_subclass__",
    "__getattr__",
    "__getattribute__",
    "__slots__",
)
KINDS = (property, cached_property, staticmethod, classmethod, FunctionType)

# (value) -> what stands in for it; (function, its class) -> the function looked into
StandIn = Callable[[Any], Any]
Looked = Callable[[Any, type], Callable[..., Any]]


def is_users(kind: type) -> bool:
    """Whether a class is written in Python, in no installed package, and does nothing of its own when made."""
    own = kind.__mro__[:-1]
    return (
        type(kind) is type
        and bool(own)
        and all(
            package_of(one) not in KNOWN
            and "-packages" not in str(getattr(sys.modules.get(one.__module__), "__file__", ""))
            and not any(name in vars(one) for name in HOOKS)
            and ("__setattr__" not in vars(one) or hasattr(one, "__dataclass_params__"))  # frozen
            for one in own
        )
    )


def class_of(kind: type, stand_in: StandIn, looked_into: Looked) -> type:
    """The same class with its methods looked into, each when it is called."""

    def method(function: Any) -> Any:
        return lambda *args, **options: looked_into(function, kind)(*args, **options)

    def own(value: Any) -> Any:
        if hasattr(value, "cache_info"):
            value = value.__wrapped__
        if isinstance(value, staticmethod | classmethod):
            return type(value)(method(value.__func__))
        if isinstance(value, property | cached_property):
            found = value.fget if isinstance(value, property) else value.func
            return property(method(found))
        return method(value) if isinstance(value, FunctionType) else stand_in(value)

    names: dict[str, Any] = {}
    for one in kind.__mro__[-2::-1]:
        for name, value in vars(one).items():
            if (
                isinstance(value, KINDS)
                or hasattr(value, "cache_info")
                or not name.startswith("__")
            ):
                names[name] = own(value)
    return type(kind.__name__, (kind,), names)


def object_of(value: Any, kind: type, stand_in: StandIn, seen: dict[int, Any]) -> Any:
    """The same object of that class; what a method leaves there is left with the object itself, too."""

    def keep(self: Any, name: str, given: Any) -> None:
        object.__setattr__(self, name, given)
        setattr(value, name, given)

    own: Any = object.__new__(type(kind.__name__, (kind,), {"__setattr__": keep}))
    seen[id(value)] = own
    vars(own).update({name: stand_in(one) for name, one in vars(value).items()})
    return own
