"""The lattice that rounded readings lie on: its step, and the noise it is to be compared with."""

from __future__ import annotations

import numpy as np

from engine.arrays import Array

VISIBLE = 0.5  # steps below this many standard deviations of the noise add little to it
FEWEST_LEVELS = 3  # levels without which there is no lattice
REPEATED = 0.9  # largest share of distinct values: what is not rounded does not repeat itself
OFF = 0.02  # of a step: how far off the lattice a level may lie


def lattice_step(values: Array) -> float | None:
    """The step of the lattice that all values (n,) lie on; None where they lie on none."""
    levels = np.unique(values)
    if not FEWEST_LEVELS <= len(levels) <= REPEATED * len(values):
        return None
    span = float(levels[-1] - levels[0])
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * span]  # the same level, written in two ways
    step = float(gaps.min())
    # the smallest gap holds rounding errors of the numbers themselves; all gaps together fewer
    for _ in range(3):
        counts = np.round(gaps / step)
        step = float((counts @ gaps) / (counts @ counts))
    if np.abs(gaps / step - np.round(gaps / step)).max() > OFF:
        return None
    return step


def sample_noise(values: Array) -> float:
    """What varies from sample to sample, as a standard deviation: of second differences over sqrt(6)."""
    return float(np.std(np.diff(values, 2)) / np.sqrt(6.0)) if len(values) > 2 else 0.0
