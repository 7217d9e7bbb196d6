"""What a function is worth at parameters where the model cannot be had.

A user's function may take the root of a negative number, or a logarithm of zero. A trial of the parameters that
ends there says nothing of the model, which is right elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from engine.errors import ModelError

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")


def where_it_fails(
    value: Value,
) -> Callable[[Callable[Arguments, Value]], Callable[Arguments, Value]]:
    """A function that is to return ``value`` where a calculation of the model fails at the theta it is given.

    A function of the model that is wrong fails everywhere, and is told.
    """

    def guarded(function: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
        @wraps(function)
        def tried(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Value:
            try:
                return function(*args, **kwargs)
            except ModelError as error:
                if not error.numeric:
                    raise
                return value

        return tried

    return guarded
