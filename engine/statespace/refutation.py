"""Making again what was made from calls that a model's function turned out not to take."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
            before = refutations()
            try:
                out = function(*args, **kwargs)
            except Exception:
                if refutations() == before:
                    raise
            else:
                if refutations() == before:
                    return out
            for generator, state in zip(generators, states, strict=True):
                generator.bit_generator.state = state

    return run


def refutations() -> int:
    """How often, in this thread, a function was found not to take rows that it had been given."""
    return int(getattr(_here, "count", 0))


def count_refutation() -> None:
    """A function was found not to take rows that it had been given before."""
    _here.count = refutations() + 1


def calls_split() -> int:
    """How often, in this thread, rows were not evaluated in one call, by whatever model inside another."""
    return int(getattr(_here, "split", 0))


def count_split() -> None:
    """Rows were evaluated in several calls."""
    _here.split = calls_split() + 1


@contextmanager
def times_are_alike() -> Iterator[None]:
    """Calls of other times than the last are not looked at for that alone, in this thread.

    For a loop over time with many inputs side by side, whose first step was looked at and whose result is:
    what a function takes at one time it takes at the next, but for what ``Steps.as_alone`` finds.
    """
    before = looks_at_times()
    _here.looks = False
    try:
        yield
    finally:
        _here.looks = before


def looks_at_times() -> bool:
    """Whether a call of other times than the last is looked at."""
    return bool(getattr(_here, "looks", True))
