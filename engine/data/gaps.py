"""Inputs over a gap of the times, in which nobody wrote down what they did.

A simulation goes through the gap with them as at its ends: of a logger that stood still for an hour a heater
was taken to be on all that time, and the parameters, or a force that never was, made up for it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from engine.arrays import Array
from engine.data.series import Series
from engine.words import enumerated, moment, number, with_unit

LONG = 4.0  # usual steps: what is longer is a gap
EVEN = 0.8  # share of the steps that are usual: else nothing says which of them is a gap
USUAL = 1.5  # times the usual step, at most, is one
MOVED = 0.5  # of how much an input varies, that it changes by in so long a time
FEWEST_ROWS = 10  # over which an input is seen to change


def inputs_over_gaps(inputs: Mapping[str, str], series: Series) -> list[str]:
    """A sentence where rows are missing for so long that inputs will have changed meanwhile.

    ``inputs`` are the units of the columns of u by name. None for those that rest as long elsewhere, and where
    steps are of all lengths, as where somebody came to read a gauge.
    """
    long = gaps(series)
    if not long or not inputs:
        return []
    first = max(long, key=lambda row: float(series.t[row + series.substeps] - series.t[row]))
    last, usual = first + series.substeps, series.usual_step * series.substeps
    length = float(series.t[last] - series.t[first])
    u = series.u[series.samples]
    moved = [k for k, one in enumerate(u.T) if _moves(one, max(1, round(length / usual)))]
    if not moved:
        return []
    names, units = list(inputs), list(inputs.values())
    begin = moment(float(series.t[first]), usual, series.time_unit)
    more = f" It is the longest of {len(long)} gaps." if len(long) > 1 else ""
    taken = enumerated(
        [f"{names[k]} {_taken(series.hold, series.u[[first, last], k], units[k])}" for k in moved]
    )
    move = "it moves" if len(moved) == 1 else "they move"
    return [
        f"No rows for {number(length)} {series.time_unit} after t = {begin}, where a step is "
        f"{number(usual)} {series.time_unit}.{more} All that time {taken} in every run and fit, though "
        f"elsewhere {move} in so long. Give rows with what it was there and readings left empty, or the parts "
        "before and after as records of their own."
    ]


def gaps(series: Series) -> list[int]:
    """Rows of samples after which the next one is far off, of a record whose steps are else alike."""
    rows = series.samples
    made = np.isin(rows[1:], series.begins)
    steps = np.diff(series.t[rows])
    usual = float(np.median(steps[~made]))
    even = (steps[~made] <= USUAL * usual).mean() >= EVEN
    return [int(row) for row in rows[:-1][(steps > LONG * usual) & ~made & even]]


def _moves(u: Array, rows: int) -> bool:
    """Whether an input (T,) is elsewhere by ``rows`` later, beside how much it varies."""
    apart = min(rows, len(u) // 2)
    if len(u) - apart < FEWEST_ROWS or np.ptp(u) == 0.0:
        return False
    change = (u[apart:] - u[:-apart]) / np.ptp(u)
    return bool(np.sqrt((change**2).mean()) > MOVED * (u / np.ptp(u)).std())


def _taken(hold: str, ends: Array, unit: str) -> str:
    """What an input is taken for between the values at both ``ends`` (2,)."""
    before, after = (with_unit(float(value), unit) for value in ends)
    if hold == "foh":
        return f"goes straight from {before} to {after}"
    return f"is taken for {after if hold == 'past' else before}"
