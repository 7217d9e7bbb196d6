"""Making again what was made from calls that a model's function turned out not to take."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np

_P = ParamSpec("_P")
_R = TypeVar("_R")

_here = threading.local()


def repeated_if_refuted(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """A function that is run again where meanwhile a model's function turned out not to take rows.

    What it had been given before would be wrong. Generators among the arguments start again where
    they were.
    """

    @functools.wraps(function)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        generators = [x for x in (*args, *kwargs.values()) if isinstance(x, np.random.Generator)]
        states = [x.bit_generator.state for x in generators]
        while True:
            before = _refutations()
            try:
                out = function(*args, **kwargs)
            except Exception:
                if _refutations() == before:
                    raise
            else:
                if _refutations() == before:
                    return out
            for generator, state in zip(generators, states, strict=True):
                generator.bit_generator.state = state

    return run


def _refutations() -> int:
    """How often, in this thread, a function was found not to take rows that it had been given."""
    return int(getattr(_here, "count", 0))


def count_refutation() -> None:
    """A function was found not to take rows that it had been given before."""
    _here.count = _refutations() + 1


def calls_split() -> int:
    """How often, in this thread, rows were not evaluated in one call, by whatever model inside another."""
    return int(getattr(_here, "split", 0))


def count_split() -> None:
    """Rows were evaluated in several calls."""
    _here.split = calls_split() + 1
