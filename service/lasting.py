"""One thread for what has to outlive the thread that asks for it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class Lasting:
    """Carries out calls in a thread that ends with the process, and that the process does not wait for.

    An executor's thread would be waited for, and refuses calls while the process ends.
    """

    def __init__(self, name: str) -> None:
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        self._name, self._lock, self._begun = name, threading.Lock(), False

    def __call__(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """What the call returns or raises."""
        with self._lock:
            if not self._begun:
                threading.Thread(target=self._run, name=self._name, daemon=True).start()
                self._begun = True
        answer: Future[T] = Future()
        self._calls.put((answer, lambda: call(*args, **kwargs)))
        return answer.result()

    def _run(self) -> None:
        while True:
            answer, call = self._calls.get()
            try:
                answer.set_result(call())
            except BaseException as error:  # noqa: BLE001 - it is the caller's
                answer.set_exception(error)
