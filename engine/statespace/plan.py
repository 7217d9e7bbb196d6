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
    """For M rows with the record ``theta``: the rows of each parameter vector, and it as plain numbers.

    ``counts`` are their numbers; ``back`` puts the rows of all parts, one part after the other, into
    their places, None where they are there already.
    """

    theta: Any = None
    M: int = 0
    parts: Sequence[tuple[slice | Indices, Any]] = ()
    counts: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    back: Indices | None = None

    def stacked(self, found: Sequence[Result | None]) -> Result:
        """The results of the parts, one of them at least, as one; NaN for a part that has none."""
        like = next(one for one in found if one is not None)
        parts = zip(found, self.counts, strict=True)
        each = [_nothing(like, int(n)) if one is None else one for one, n in parts]
        out: list[Array | None] = [self._placed(np.concatenate([values for values, *_ in each]))]
        for matrices in zip(*(result[1:] for result in each), strict=True):
            if matrices[0] is None:
                out.append(None)
            elif all(matrix.ndim == 2 for matrix in matrices):
                out.append(self._placed(np.repeat(np.stack(matrices), self.counts, axis=0)))
            else:
                shape = matrices[0].shape[-2:]
                pairs = zip(matrices, self.counts, strict=True)
                out.append(
                    self._placed(
                        np.concatenate([np.broadcast_to(m, (n, *shape)) for m, n in pairs])
                    )
                )
        return tuple(out)

    def _placed(self, values: Array) -> Array:
        return values if self.back is None else values[self.back]


def _nothing(like: Result, n: int) -> Result:
    """NaN in the shapes of another result, for n rows."""
    values, *matrices = like
    return (
        np.full((n, values.shape[1]), np.nan),
        *(None if x is None else np.full(x.shape[-2:], np.nan) for x in matrices),
    )


def plan_of(rows: Rows, kind: Kind, read: Kind) -> Plan:
    """The plan for rows that differ in parameters only; rows alike in what is ``read`` are one part."""
    parts: list[tuple[slice | Indices, Any]] = []
    groups = sorted(rows.groups(read), key=lambda at: at[0])
    for at in groups:
        plain = [
            value if i not in kind.fields else value[at[0]] for i, value in enumerate(rows.theta)
        ]
        own = type(rows.theta)(*(float(value) for value in plain))
        together = at[-1] - at[0] + 1 == len(at)
        parts.append((slice(int(at[0]), int(at[-1]) + 1) if together else at, own))
    counts = np.array([len(at) for at in groups], dtype=np.intp)
    order = np.concatenate(groups)
    sorted_already = bool((order[1:] > order[:-1]).all())
    back = None if sorted_already else np.argsort(order)
    return Plan(rows.theta, len(rows.a), parts, counts, back)
