"""Whole numbers that count rows: where they leave some out, these are missing from a record.

A step that is given makes neighbours of the rows on either side: what happened in between was put down to
noise, and nothing said so. So it was with rows in another order, as a sample of a table's rows has them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array

MOSTLY = 0.9  # of the rows a counter goes up by one and the same step; noise beside a trend falls more often
FEWEST = 10  # rows, without which numbers may rise so by chance


def uneven(numbers: NDArray[Any]) -> int | None:
    """The first row that does not go on as most do, of the whole numbers of an index; None where all do."""
    steps = np.diff(numbers)
    if not steps.any():  # a name of all rows
        return None
    values, often = np.unique(steps, return_counts=True)
    usual = values[np.argmax(often)]
    return None if len(values) == 1 and usual > 0 else 1 + int(np.argmax(steps != max(usual, 1)))


def uneven_counter(values: Array) -> int | None:
    """The first row before which rows are missing by a column that counts them; None where none does.

    It rises throughout, nearly always by one step, else by whole numbers of it.
    """
    if len(values) < FEWEST or not (values == np.round(values)).all():  # NaN is not
        return None
    steps = np.diff(values)
    least = steps.min()
    same = steps == least
    if least <= 0.0 or same.all() or same.mean() < MOSTLY or np.mod(steps, least).any():
        return None
    return 1 + int(np.argmin(same))
