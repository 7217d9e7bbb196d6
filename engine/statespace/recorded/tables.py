"""Tables looked into with a whole number that is traced: ``DAY[int(t) % 24]``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from engine.statespace.recorded.numbers import Traced, UntraceableError, record
from engine.statespace.rows import Array, is_rows

MOST = 100  # entries of a row of a table


class At:
    """The entry of ``table`` (n, ...) at whole numbers; where there is none the entries (n,) are operands."""

    def __init__(self, table: Array | None, keys: int) -> None:
        self.table, self.keys = table, keys

    def __call__(self, *operands: Any) -> Any:
        """The entries, for numbers or (M,)."""
        keys, entries = operands[: self.keys], operands[self.keys :]
        table = self.table
        if table is None:
            table = np.array(
                np.broadcast_arrays(*entries, *(k for k in keys if is_rows(k)))[: len(entries)]
            )
        at = tuple(np.asarray(key, dtype=float) for key in keys)
        ends = zip(at, table.shape, strict=False)
        if not all(((key >= -n) & (key < n) & (key == np.trunc(key))).all() for key, n in ends):
            raise ValueError("there is no such entry")
        whole = tuple(key.astype(np.intp) for key in at)
        if self.table is None and table.ndim > 1:
            return table[whole[0], np.arange(table.shape[1])]
        return table[whole]


def is_key(key: Any) -> bool:
    """Whether a traced number that counts is a key, or a part of it."""
    if isinstance(key, tuple):
        return any(map(is_key, key))
    if isinstance(key, np.ndarray) and key.dtype == object:
        return any(map(is_key, key.flat))
    return isinstance(key, Traced) and not isinstance(key.value, bool | np.bool_)


def looked_up(table: Array, key: Any) -> Any:
    """The entry, or the row of entries, of an array of numbers and traced ones at such a key."""
    if isinstance(key, np.ndarray):
        each = np.frompyfunc(lambda one: looked_up(table, one), 1, 1)(key.view(np.ndarray))
        return each
    keys = key if isinstance(key, tuple) else (key,)
    if (
        not all(isinstance(one, Traced | int | np.integer) for one in keys)
        or len(keys) > table.ndim
    ):
        raise UntraceableError
    rest = table.shape[len(keys) :]
    if np.prod(rest) > MOST:
        raise UntraceableError
    out = np.empty(rest, dtype=object)
    for at in np.ndindex(*rest):
        out[at] = _entry(table[(*(slice(None),) * len(keys), *at)], keys)
    return out if rest else out[()]


def _entry(table: Array, keys: tuple[Any, ...]) -> Any:
    if table.dtype != object:
        return record(At(table.astype(float), len(keys)), keys)
    entries = table.ravel().tolist()
    if not any(isinstance(one, Traced) for one in entries):
        return record(At(table.astype(float), len(keys)), keys)
    if table.ndim > 1 or table.size > MOST:
        raise UntraceableError
    return record(At(None, 1), (*keys, *entries))


def one_of(each: Sequence[Any], key: Any) -> Any:
    """The same in a list or tuple, of numbers or of anything else."""
    if all(type(one) in (int, float) for one in each):
        return looked_up(np.array(each, dtype=float), key)
    for i, one in enumerate(each):
        if key == i or key == i - len(each):
            return one
    raise IndexError("there is no such entry")


def under(known: Mapping[Any, Any], key: Any) -> Any:
    """What a dictionary has under such a key."""
    for own, one in known.items():
        if isinstance(own, int | float) and key == own:
            return one
    raise KeyError("there is no such entry")


class Table(np.ndarray[Any, Any]):
    """A long array of numbers that takes such keys."""

    def __getitem__(self, key: Any) -> Any:
        own = self.view(np.ndarray)
        return looked_up(own, key) if is_key(key) else own[key]
