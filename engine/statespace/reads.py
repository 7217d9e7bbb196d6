"""Whether a function reads one of its arguments at all, or has a loop, told from its byte code.

What a function never loads it cannot depend on: this is a proof, where calls can only give examples. Where
the code does not tell, the argument counts as read. Functions of the engine's own are told which parameters
they ignore, and an object that is called may tell by ``reads_argument(position)`` what it reads.
"""

from __future__ import annotations

import dis
from functools import lru_cache
from types import CodeType, FunctionType, MethodType
from typing import Any

# Names by which a function may see its own arguments without loading them
SEES_ALL = frozenset(
    {"locals", "vars", "eval", "exec", "dir", "_getframe", "currentframe", "stack"}
)
CODES = 1000  # of functions, whose answers are kept: extensions of a model share most of theirs


def reads(function: Any, position: int) -> bool:
    """Whether ``function`` may depend on its positional argument number ``position``, from 0."""
    told = getattr(function, "reads_argument", None)
    if told is not None:
        return bool(told(position))
    if isinstance(function, MethodType):
        return reads(function.__func__, position + 1)
    if not isinstance(function, FunctionType) or hasattr(function, "__wrapped__"):
        return True
    code = function.__code__
    if position >= code.co_argcount or SEES_ALL & {*code.co_names, *code.co_freevars}:
        return True
    name = code.co_varnames[position]
    if name in code.co_cellvars:  # an inner function has it
        return True
    return name in _named(code)


@lru_cache(CODES)
def _named(code: CodeType) -> frozenset[str]:
    """Local names that some instruction loads, stores or deletes; what only stores counts as reading."""
    steps = (step for step in dis.get_instructions(code) if "FAST" in step.opname)
    # some instructions load two names
    return frozenset(
        name
        for step in steps
        for name in (step.argval if isinstance(step.argval, tuple) else (step.argval,))
    )


def loops(function: Any) -> bool:
    """Whether there is a loop in a function's own code, as one over its rows would be."""
    told = getattr(function, "has_loops", None)
    if told is not None:
        return bool(told())
    code = getattr(getattr(function, "__func__", function), "__code__", None)
    return code is not None and _has_loop(code)


@lru_cache(CODES)
def _has_loop(code: CodeType) -> bool:
    inner = (const for const in code.co_consts if hasattr(const, "co_consts"))
    own = (step.opname for step in dis.get_instructions(code))
    return any(name == "FOR_ITER" for name in own) or any(map(_has_loop, inner))


def reading(n: int, function: Any) -> Any:
    """Mark a function of the engine's own that reads the first n parameters of theta only."""
    function.parameters_read = n
    return function


def ignores(function: Any, k: int) -> bool:
    """Whether a function was marked as ignoring parameter number k."""
    return k >= getattr(function, "parameters_read", k + 1)
