"""How rows of several parameter vectors are split into calls with one each, remembered from step to step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from engine.statespace.compare import Result
from engine.statespace.rows import Array, Indices, Kind, Rows


@dataclass(frozen=True)
class Plan:
    """For M rows with the record ``theta``: each slice of rows with its record of plain numbers.

    No ``parts`` where the rows of a theta do not follow each other.
    """

    theta: Any = None
    M: int = 0
    parts: Sequence[tuple[slice, Any]] = ()
    counts: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))


def plan_of(rows: Rows, kind: Kind) -> Plan:
    """The plan for rows that differ in parameters only."""
    M = len(rows.a)
    if kind.times:
        return Plan(rows.theta, M)
    parts = []
    for at in rows.groups(kind):
        if at[-1] - at[0] + 1 != len(at):
            return Plan(rows.theta, M)
        plain = [
            value if i not in kind.fields else value[at[0]] for i, value in enumerate(rows.theta)
        ]
        own = type(rows.theta)(*(float(value) for value in plain))
        parts.append((slice(int(at[0]), int(at[-1]) + 1), own))
    parts.sort(key=lambda part: part[0].start)
    counts = np.array([at.stop - at.start for at, _ in parts], dtype=np.intp)
    return Plan(rows.theta, M, parts, counts)


def stacked(each: Sequence[Result], counts: Indices) -> Result:
    """The results of groups of rows that follow each other, as one."""
    out: list[Array | None] = [np.concatenate([values for values, *_ in each])]
    for matrices in zip(*(result[1:] for result in each), strict=True):
        if matrices[0] is None:
            out.append(None)
        elif all(matrix.ndim == 2 for matrix in matrices):
            out.append(np.repeat(np.stack(matrices), counts, axis=0))
        else:
            shape = matrices[0].shape[-2:]
            whole = [np.broadcast_to(m, (n, *shape)) for m, n in zip(matrices, counts, strict=True)]
            out.append(np.concatenate(whole))
    return tuple(out)
