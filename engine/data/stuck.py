"""Readings that stay for some rows exactly as they were, where the signal moves else.

A transmitter that misses its turn leaves the logger with its last value. To a model they are readings, each
with noise of its own: pulses, episodes and outliers of the sensor were found in their place.
"""

from __future__ import annotations

import numpy as np

from engine.arrays import Array
from engine.data.lattice import lattice_step
from engine.data.repeats import MOVE

SHORTEST = 3  # rows on end with one value, that two readings next to each other may have by chance
LONGEST = 19  # rows: a longer rest may be that of the inputs, which is looked at elsewhere
FEWEST_REPEATS = 3  # in all such runs
LEAST_JUMP = 0.25  # of a usual move, next to such runs
CHANCE = 1e-3
MOST = 0.3  # share of the rows: what stays more often is how this signal is
FEWEST_MOVES = 20  # without which nobody knows how far a reading usually moves


def stuck_at_times(name: str, y: Array) -> list[str]:
    """A sentence where readings y (T,) keep one value for some rows, on the move before and after.

    Not at the least, the largest or zero, where a signal is cut or rests, nor where rounding makes it repeat
    itself. What comes to rest and sets off again, as with dry friction, hardly moves just before and after.
    """
    changes = np.diff(y)  # NaN beside a missing reading, which ends a run
    moves = np.abs(changes[np.isfinite(changes) & (changes != 0.0)])
    if len(moves) < FEWEST_MOVES:
        return []
    usual, step = float(np.median(moves)), lattice_step(y[~np.isnan(y)])
    if step is not None and usual < MOVE * step:
        return []
    edges = np.flatnonzero(changes != 0.0) + 1
    starts = np.concatenate([[0], edges])
    lengths = np.diff(np.concatenate([starts, [len(y)]]))
    resting = np.isin(y[starts], (np.nanmin(y), np.nanmax(y), 0.0))
    runs = np.flatnonzero((lengths >= SHORTEST) & (lengths <= LONGEST) & ~resting)
    rows = int(lengths[runs].sum())
    if rows - len(runs) < FEWEST_REPEATS or rows > MOST * len(y):
        return []
    # by chance of digits, as counts have it, of so many runs as long as these
    again = (1 + int((lengths == SHORTEST - 1).sum())) / len(y)
    if (np.log(len(y)) + np.log(again) * (lengths[runs] - 1)).sum() > np.log(CHANCE):
        return []
    around = np.concatenate([starts[runs] - 1, starts[runs] + lengths[runs] - 1])
    jumps = np.abs(changes[around[(around >= 0) & (around < len(changes))]])
    if not np.isfinite(jumps).any() or np.nanmedian(jumps) < LEAST_JUMP * usual:
        return []
    longest = int(lengths[runs].max())
    often = "once" if len(runs) == 1 else f"{len(runs)} times"
    upto = f"up to {longest}" if len(runs) > 1 else f"{longest}"
    return [
        f"Output {name} keeps exactly one value for {upto} rows on end, {often}, first from row "
        f"{int(starts[runs[0]])}: a stuck reading, or a last value that is repeated? Then "
        "leave out all but the first of each (NaN, or an empty cell): pulses, episodes and outliers may be "
        "found for them."
    ]
