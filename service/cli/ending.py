"""How a command ends: exit codes, and messages instead of tracebacks."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import Any

import typer


class Code(IntEnum):
    """Exit codes; ``--help`` lists them."""

    DONE = 0
    FAILED = 1  # the estimation diverged or the computation is impossible
    WRONG = 2  # usage or data
    FOUND = 3  # diagnose --exit-code, and the model leaves something out
    INTERRUPTED = 130  # as a shell reports SIGINT


CODES = (
    "Exit codes: 0 done; 1 the estimation diverged, was lost, or cannot be computed; 2 wrong usage "
    "or data; 3 only with 'diagnose --exit-code': the model leaves something out; 130 interrupted."
)


class Interrupt:
    """Ctrl-C held back until :meth:`check`, as compiled code may swallow it.

    A second one is held only by one that is ``patient``.
    """

    def __init__(self, patient: bool = False) -> None:
        self.came = self.holding = False
        self.patient = patient

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold it back within; it is raised at the end at the latest.

        Compiled code that it reaches makes an error of its own of it, which is not what happened.
        """
        self.holding = True
        before = signal.signal(signal.SIGINT, self._take)
        try:
            yield
        except Exception:
            self.check()
            raise
        finally:
            signal.signal(signal.SIGINT, before)
        self.check()

    def let_go(self) -> None:
        """Hold it back no longer: what follows has no steps at which it could be checked."""
        self.check()
        self.holding = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if it came."""
        if self.came:
            raise KeyboardInterrupt

    def _take(self, *_: Any) -> None:
        again, self.came = self.came, True
        if not self.holding or (again and not self.patient):
            raise KeyboardInterrupt


class Ending(Exception):  # noqa: N818 - an end need not be an error
    """The end of a command with a message for people; ``more`` joins it in the JSON."""

    def __init__(self, code: Code, message: str, **more: Any) -> None:
        super().__init__(message)
        self.code, self.more = code, more


def wrong(message: str) -> Ending:
    """Usage or data that cannot be used; the message names the option or column and what to do."""
    return Ending(Code.WRONG, message)


def about_file(error: OSError) -> str:
    """Which file could not be used, and why."""
    return f"{error.filename}: {error.strerror}" if error.filename else str(error)


@contextmanager
def guarded(as_json: bool) -> Iterator[None]:
    """Turn every exception into a message on stderr (and JSON on stdout) and an exit code."""
    try:
        yield
    except BrokenPipeError:
        raise  # typer's to handle: whoever read our output has left
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - a model may raise anything
        end = _told(error)
        if as_json:
            print(json.dumps({"error": {"code": end.code, "message": str(end)} | end.more}))
        print(f"rbps: {end}", file=sys.stderr)
        raise typer.Exit(end.code) from None


def _told(error: BaseException) -> Ending:
    """What an exception means for the person at the terminal."""
    if isinstance(error, Ending):
        return error
    if isinstance(error, KeyboardInterrupt):
        return Ending(Code.INTERRUPTED, "interrupted")
    if isinstance(error, OSError):
        return wrong(about_file(error))
    if isinstance(error, MemoryError):
        return Ending(Code.FAILED, "the computation needs more memory than there is")
    from engine.errors import EngineError, ModelError
    from service.problems import Problem, unexpected

    if isinstance(error, Problem):
        return Ending(Code.FAILED, str(error), outcome=error.kind)
    if isinstance(error, EngineError):
        return Ending(Code.FAILED if isinstance(error, ModelError) else Code.WRONG, str(error))
    return Ending(Code.FAILED, unexpected(error))
