"""What a function leaves for its next call, which no recording of one call tells."""

from __future__ import annotations

import dis
import sys
from collections import Counter
from types import CodeType, FunctionType
from typing import Any

from engine.statespace.recorded.numbers import Traced, UntraceableError
from engine.statespace.recorded.tables import one_of, under

# packages whose functions are not looked into
KNOWN = frozenset({*sys.stdlib_module_names, "numpy", "scipy", "numba", "engine"})


def _refuse(*_: Any, **__: Any) -> Any:
    raise UntraceableError


class KeptDict(dict[Any, Any]):
    """What is there for all calls, in which none may leave something for the next."""

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __getitem__(self, key: Any) -> Any:
        return under(self, key) if isinstance(key, Traced) else super().__getitem__(key)


class KeptTuple(tuple[Any, ...]):
    """The same of what never changes."""

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:
        return one_of(self, key) if isinstance(key, Traced) else super().__getitem__(key)


class KeptList(list[Any]):
    """The same in a row; what is only appended to is a protocol, which none reads."""

    __setitem__ = __delitem__ = __iadd__ = __imul__ = clear = insert = _refuse
    extend = pop = remove = reverse = sort = _refuse

    def __init__(self, each: Any, own: list[Any]) -> None:
        super().__init__(each)
        self._own, self._read, self._written = own, False, False

    def append(self, x: Any) -> None:
        """Keep it for whoever calls the function."""
        self._used(written=True)
        self._own.append(x.value if isinstance(x, Traced) else x)

    def __getitem__(self, key: Any) -> Any:
        self._used(read=True)
        return one_of(self, key) if isinstance(key, Traced) else super().__getitem__(key)

    def __iter__(self) -> Any:
        self._used(read=True)
        return super().__iter__()

    def __len__(self) -> int:
        self._used(read=True)
        return super().__len__()

    def _used(self, read: bool = False, written: bool = False) -> None:
        self._read, self._written = self._read or read, self._written or written
        if self._read and self._written:
            raise UntraceableError


def names_of(code: Any) -> set[str]:
    """Global names in a function and in those within it."""
    inner = (const for const in code.co_consts if hasattr(const, "co_names"))
    return {*code.co_names}.union(*map(names_of, inner))


def package_of(function: Any) -> str:
    """The package that a function, or a class, belongs to."""
    return str(function.__module__).partition(".")[0]


def remembers(function: FunctionType, owner: Any) -> bool:
    """Whether a function, or a method it calls, reads what it leaves for its next call.

    ``owner`` is the object or class that has it. Counting calls (``self.calls += 1``) is no reading.
    """
    kind = owner if isinstance(owner, type) else type(owner)
    loaded: Counter[Any] = Counter()
    stored: set[Any] = set()
    todo, met = [(function, kind)], set()
    while todo:
        one = todo.pop()
        if one in met:
            continue
        met.add(one)
        code, names = one[0].__code__, names_of(one[0].__code__)
        own = _uses_of(code, {*code.co_freevars})
        loaded.update(own[0])
        stored |= own[1]
        kept = [one[0].__globals__[name] for name in names & one[0].__globals__.keys()]
        kept += [cell.cell_contents for cell in one[0].__closure__ or ()]
        for each in {one[1], *map(type, _within([owner, *kept]))}:
            if package_of(each) not in KNOWN:
                found = [getattr(each, name, None) for name in names]
                methods = [getattr(x, "fget", x) for x in found]
                todo += [(x, each) for x in methods if isinstance(x, FunctionType)]
    return any(loaded[use] > 0 for use in stored)


def _within(values: list[Any]) -> list[Any]:
    """Objects, and those that a user's own have."""
    found: dict[int, Any] = {}
    todo = list(values)
    while todo:
        one = todo.pop()
        if id(one) not in found:
            found[id(one)] = one
            if package_of(type(one)) not in KNOWN:
                todo += getattr(one, "__dict__", {}).values()
    return list(found.values())


def _uses_of(code: Any, free: set[str]) -> tuple[Counter[Any], set[Any]]:
    """How often names that stay are loaded but for adding to them, and which are assigned to."""
    loaded: Counter[Any] = Counter()
    stored: set[Any] = set()
    added = False
    for step in dis.get_instructions(code):
        what, _, where = step.opname.partition("_")
        use = where.removesuffix("_OR_NULL"), step.argval
        if where == "METHOD":
            use = "ATTR", step.argval
        stays = use[0] in ("GLOBAL", "ATTR") or (use[0] == "DEREF" and use[1] in free)
        if stays and what == "LOAD":
            loaded[use] += 1
        elif stays and what in ("STORE", "DELETE"):
            stored.add(use)
            loaded[use] -= added
        if step.opname not in ("SWAP", "CACHE") and not step.opname.startswith("LOAD"):
            added = step.opname == "BINARY_OP" and step.argrepr.endswith("=")
    for const in code.co_consts:
        if isinstance(const, CodeType):
            inner = _uses_of(const, free)
            loaded.update(inner[0])
            stored |= inner[1]
    return loaded, stored
