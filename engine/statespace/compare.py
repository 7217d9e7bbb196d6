"""Results of a model's function: whether two differ by more than rounding, and several as one."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from engine.statespace.rows import Array, Indices

# values (M, n), then matrices: (r, c) common to all rows, (M, r, c), or None
Result: TypeAlias = tuple[Any, ...]

DOUBLE, SINGLE = 1e-11, 1e-5  # of an entry's largest size over the rows, in either precision
OTHERS = 1e-8  # of the same, from which on rows of one time and theta are said to differ
NOISE = 10.0  # times what a change in the twelfth digit does, where a function magnifies rounding


def copies(result: Result) -> Result:
    """The same in memory of its own."""
    return tuple(None if x is None else x.copy() for x in result)


def at_rows(result: Result, at: Indices) -> Result:
    """The values and matrices of some rows."""
    return tuple(x if x is None or (j and x.ndim == 2) else x[at] for j, x in enumerate(result))


def sizes_of(result: Result) -> Result:
    """The largest finite size of each entry over all rows."""
    return tuple(
        None
        if x is None
        else np.abs(np.where(np.isfinite(x), x, 0.0)).max(axis=0, initial=0.0)
        if j == 0 or x.ndim == 3
        else np.abs(np.where(np.isfinite(x), x, 0.0))
        for j, x in enumerate(result)
    )


def identical(xs: Result, ys: Result) -> bool:
    """Whether all entries are the same bits, or NaN in both."""
    return all(x is y or np.array_equal(x, y, equal_nan=True) for x, y in zip(xs, ys, strict=True))


def noise_of(now: Result, nudged: list[Result]) -> Result:
    """How far the entries move, at most over the rows, when arguments change in the twelfth digit."""
    moved = [
        sizes_of(
            tuple(
                None if x is None else np.nan_to_num(y - x) for x, y in zip(now, one, strict=True)
            )
        )
        for one in nudged
    ]
    return larger(*moved)


def larger(xs: Result, ys: Result) -> Result:
    """The larger one of two sizes of each entry; None where there is none to compare."""
    return tuple(
        None if x is None or y is None else np.maximum(x, y) for x, y in zip(xs, ys, strict=True)
    )


def differ(
    xs: Result, ys: Result, sizes: Result, particles: bool, noise: Result | None = None
) -> bool:
    """Whether results for the same rows differ by more than rounding; entries may be NaN in both.

    ``sizes`` are those of the entries, ``noise`` what a change in the twelfth digit does to them. Rows that
    are ``particles`` must differ clearly, as nothing can be done for them.
    """
    for j, (x, y) in enumerate(zip(xs, ys, strict=True)):
        if x is None or y is None:
            if x is not y:
                return True
            continue
        allowed = (OTHERS if particles else DOUBLE) * sizes[j] + np.finfo(float).tiny
        if noise is not None:
            if np.array_equal(y, y.astype(np.float32), equal_nan=True):
                allowed = SINGLE * sizes[j]  # the model calculates in single precision
            allowed = allowed + NOISE * noise[j]
        if not _close(x, y, allowed):
            return True
    return False


def _close(x: Array, y: Array, allowed: Array) -> bool:
    near = np.abs(x - y) <= allowed
    return bool(near.all() or np.all(near | (x == y) | (np.isnan(x) & np.isnan(y))))


def joined(parts: list[tuple[Indices, Result]], M: int) -> Result:
    """The results of groups of rows as one; NaN in rows of no group."""
    whole = sum(len(at) for at, _ in parts) == M
    out: list[Array | None] = []
    for j, model in enumerate(parts[0][1]):
        each = [result[j] for _, result in parts]
        if model is None or (
            whole and j and all(x.ndim == 2 and np.array_equal(x, model) for x in each)
        ):
            out.append(model)
            continue
        whole_array = np.full((M, *model.shape[-1 if j == 0 else -2 :]), np.nan)
        for (at, _), x in zip(parts, each, strict=True):
            whole_array[at] = x
        out.append(whole_array)
    return tuple(out)
