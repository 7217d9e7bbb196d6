"""Whether a function reads one of its arguments at all, which parameters, or has a loop; by its byte code.

What a function never loads it cannot depend on: this is a proof, where calls can only give examples. Where
the code does not tell, the argument counts as read. Functions of the engine's own are told which parameters
they ignore, and an object that is called may tell by ``reads_argument(position)`` and
``reads_fields(position)`` what it reads.
"""

from __future__ import annotations

import dis
from functools import lru_cache
from itertools import pairwise
from types import CodeType, FunctionType, MethodType
from typing import Any

# Names by which a function may see its own arguments without loading them
SEES_ALL = frozenset(
    {"locals", "vars", "eval", "exec", "dir", "_getframe", "currentframe", "stack"}
)
# attributes of a tuple that look at all of it, as _asdict does
OF_ALL = frozenset({"count", "index"})
CODES = 1000  # of functions, whose answers are kept: extensions of a model share most of theirs


def reads(function: Any, position: int) -> bool:
    """Whether ``function`` may depend on its positional argument number ``position``, from 0."""
    told = getattr(function, "reads_argument", None)
    if told is not None:
        return bool(told(position))
    if isinstance(function, MethodType):
        return reads(function.__func__, position + 1)
    code, name = _argument(function, position)
    return code is None or name in _named(code)


def fields_read(function: Any, position: int) -> frozenset[str] | None:
    """Names, as ``q`` in ``theta.q``, that ``function`` takes of its positional argument; None: maybe all.

    It may depend on nothing else of that argument, if it is a record.
    """
    told = getattr(function, "reads_fields", None)
    if told is not None:
        names: frozenset[str] | None = told(position)
        return names
    if isinstance(function, MethodType):
        return fields_read(function.__func__, position + 1)
    code, name = _argument(function, position)
    return None if code is None else _taken(code, name)


def _argument(function: Any, position: int) -> tuple[CodeType | None, str]:
    """The code and the argument's name in it; no code where it cannot tell."""
    if not isinstance(function, FunctionType) or hasattr(function, "__wrapped__"):
        return None, ""
    code = function.__code__
    if position >= code.co_argcount or SEES_ALL & {*code.co_names, *code.co_freevars}:
        return None, ""
    name = code.co_varnames[position]
    return (None, "") if name in code.co_cellvars else (code, name)  # an inner function has it


@lru_cache(CODES)
def _named(code: CodeType) -> frozenset[str]:
    """Local names that some instruction loads, stores or deletes; what only stores counts as reading."""
    return frozenset(name for step in dis.get_instructions(code) for name in _locals(step))


@lru_cache(CODES)
def _taken(code: CodeType, name: str) -> frozenset[str] | None:
    """Attributes taken of a local name; None where anything else is done with it."""
    steps = list(dis.get_instructions(code))
    found = set()
    for step, after in pairwise([*steps, steps[-1]]):
        names = _locals(step)
        if name in names:
            if not (step.opname.startswith("LOAD_FAST") and names.index(name) == len(names) - 1):
                return None
            field = str(after.argval)
            if after.opname != "LOAD_ATTR" or field in OF_ALL or field.startswith("_"):
                return None
            found.add(field)
    return frozenset(found)


def _locals(step: dis.Instruction) -> tuple[str, ...]:
    """The local names of an instruction; some load two."""
    if "FAST" not in step.opname:
        return ()
    return step.argval if isinstance(step.argval, tuple) else (step.argval,)


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
