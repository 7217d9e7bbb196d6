"""Processes of the service's own: forked from a server that has the engine loaded, and each ended in time."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import signal
import threading
import time
from collections.abc import Callable
from multiprocessing import resource_tracker
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from service.lasting import Lasting

START_TRIES = 3
GUARD = "create_app() and uvicorn.run() belong under `if __name__ == '__main__':`"
STORE_FAILED = 75  # exit code: the store could not be used; another attempt may be luckier
# The forkserver is killed when the thread that started it ends (``preload``): one that lasts.
_starter = Lasting("starter")
_starting = threading.Lock()  # multiprocessing polls all children when it starts one


def _context() -> ForkServerContext:
    """Processes forked from a server that has the engine loaded and only one thread."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # the forkserver inherits them
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["service.preload"])
    return context


def start(target: Callable[..., object], args: tuple[object, ...]) -> BaseProcess:
    """Start a process; a forkserver that was killed is replaced by the next try."""
    for tries_left in reversed(range(START_TRIES)):
        try:
            return _starter(_begin, target, args)
        except (OSError, EOFError):
            if not tries_left:
                raise
            threading.Event().wait(0.1)  # under a faked clock time.sleep may fail
    raise AssertionError("unreachable")


def _begin(target: Callable[..., object], args: tuple[object, ...]) -> BaseProcess:
    with _starting:
        process = _context().Process(target=target, args=args, daemon=True)
        # Ctrl-C reaches all processes of a terminal and is the service's to handle: the forkserver inherits
        # that this thread hears nothing of it. The tracker goes first, for its start lets the thread hear.
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        process.start()
    return process


def settle(memory: int) -> None:
    """What a process does first; it may use so many bytes of memory (0: any)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the service's to handle
    os.nice(5)  # requests are answered while all cores compute
    # short of memory, the system ends this process, not the service
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")
    if memory:
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def joined(process: BaseProcess) -> BaseProcess:
    """The process when it has ended."""
    with _starting:
        process.join()
    return process


def kill(process: BaseProcess) -> None:
    """End it, whatever it does."""
    process.kill()
    joined(process)


def cause_of_end(process: BaseProcess) -> str:
    """Why a process ended without a word."""
    code = process.exitcode
    if code is not None and code < 0:
        hint = " (the system may have run out of memory)" if code == -9 else ""
        return f"the worker process was killed by signal {-code}{hint}"
    if code == STORE_FAILED:
        return "the store could not be written (its disk may be full)"
    hint = f" (the log says why; in a script of your own, {GUARD})" if code == 1 else ""
    return f"the worker process ended with exit code {code}{hint}"


def heard(
    target: Callable[..., object], args: tuple[object, ...], seconds: float
) -> tuple[list[Any], str]:
    """What ``target(send, *args)`` sends from a process of its own until it sends None.

    Where that does not come within so many seconds, the process is killed; also why it did not come.
    """
    receiver, sender = multiprocessing.Pipe(duplex=False)
    with receiver:
        with sender:
            process = start(target, (sender, *args))
        said: list[Any] = []
        end = time.monotonic() + seconds
        try:
            while receiver.poll(max(end - time.monotonic(), 0.0)):
                if (one := receiver.recv()) is None:
                    return said, ""
                said.append(one)
            return said, f"what it calls did not return within {seconds:g} s"
        except EOFError:
            return said, cause_of_end(joined(process))
        finally:
            kill(process)
