"""One thread of linear algebra while a model is used: its matrices are small.

Threads that wait for each other make ``scipy.linalg.expm`` of a 2 x 2 matrix, with which models are
discretised, three times slower, and tens of times where other work keeps the cores busy
(``tests/benchmarks/bench_busy_cores.py``).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import scipy.linalg  # noqa: F401 - its library must be loaded to be limited
from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
T = TypeVar("T")
_HERE = threading.local()


def single_threaded(function: Callable[P, T]) -> Callable[P, T]:
    """The function, with one thread for linear algebra while it runs."""

    @wraps(function)
    def run(*args: P.args, **options: P.kwargs) -> T:
        if getattr(_HERE, "limited", False):  # by a caller
            return function(*args, **options)
        with _libraries().limit(limits=1, user_api="blas"):
            _HERE.limited = True
            try:
                return function(*args, **options)
            finally:
                _HERE.limited = False

    return run


@cache
def _libraries() -> Any:
    return ThreadpoolController()
