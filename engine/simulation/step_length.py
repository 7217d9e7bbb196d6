"""Whether the steps that a model makes are short enough: its free run beside one of steps half as long.

A model of differential equations makes one step a sample, or as many as its series was refined to. Where a step
is long beside how the equations bend within it, parameters take up what the steps get wrong. Halving the steps
shows three quarters of that, where it falls with the square of their length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError
from engine.simulation.simulate import propagate
from engine.statespace.model import Array, MixedModel
from engine.words import number, percent

MOST = 16  # steps a sample
FREE_RUN = 0.1  # of its residual: change of the free run that is small enough
UNSEEN = 0.1  # of how a run varies: its residual, where nothing was measured
SURELY = 0.3  # of a change that is small enough: advice is to hold after another estimation
ROUNDING = 1e-8  # of how a run varies: a change that is none ...
LAST_DIGITS = 1e-12  # ... and of how far it is from zero
NO_NOISE = 1e-4  # of how a run varies: a residual below that is taken for so much
AWAY = 2.0  # ranges of the readings: a run further off than that has run away


def run_at_samples(model: MixedModel, theta: Array, series: Series, x1: Array) -> Array:
    """The noise-free run at the samples (n, ny) from x1 (nx,), not finite where it is lost."""
    na = model.na
    with np.errstate(all="ignore"):
        y, _, _ = propagate(model, model.record(theta), series, x1[None, :na], x1[None, na:])
    return np.asarray(y[series.samples, 0])


def change_of_run(series: Series, one: Array, other: Array) -> float:
    """By which share of its residual a run ``one`` (n, ny) at the samples differs from an ``other``.

    Of the output where that is largest; NaN where a run is lost. Where both run away, as those of a plant that
    only its controller holds, the rows before are compared: what grows without end is different in any case.
    """
    rows = slice(_both_away(series, one, other))
    one, other, at = one[rows], other[rows], series.samples[rows]
    if not (np.isfinite(one).all() and np.isfinite(other).all()):
        return float("nan")
    seen, left = series.observed[at], np.nan_to_num(series.y[at] - one)
    n = seen.sum(axis=0)
    change, varies = np.sqrt(np.mean((other - one) ** 2, axis=0)), one.std(axis=0)
    residual = np.sqrt((left**2).sum(axis=0) / np.maximum(n, 1))
    residual = np.where(n > 0, np.maximum(residual, NO_NOISE * varies), UNSEEN * varies)
    none = np.maximum(ROUNDING * varies, LAST_DIGITS * np.abs(one).max(axis=0, initial=0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(change > none, change / residual, 0.0)
    return float(shares.max(initial=0.0))


def _both_away(series: Series, one: Array, other: Array) -> int | None:
    """The sample from which on both runs are away at every reading; None where one stays, or is so at once.

    Where they leave at about the same time it is that of the first: how far the other has got tells nothing.
    """
    y, told = series.y[series.samples], series.observed[series.samples]
    moved = np.array([np.ptp(y[seen, i]) if seen.any() else 0.0 for i, seen in enumerate(told.T)])
    told = told & (moved > 0.0)
    read, leave = np.flatnonzero(told.any(axis=1)), []
    for run in (one, other):
        with np.errstate(invalid="ignore", over="ignore"):
            away = (told & ~(np.abs(run - y) <= AWAY * moved)).any(axis=1)
        near = read[~away[read]]
        if not len(near) or near[-1] == read[-1]:
            return None
        leave.append(int(near[-1]) + 1)
    first, last = sorted(leave)
    return first if last - first <= FREE_RUN * last else last


def too_long(
    change: Callable[[int], float], substeps: int, limit: float
) -> tuple[float, int] | None:
    """What twice the steps a sample change, and how many are enough, 0 for none; None for these ``substeps``.

    ``change(k)`` says what 2 k steps a sample change beside k; up to ``limit`` is small enough, and a part of
    it where parameters are estimated anew, as they then fit better. The ``limit`` has to do where MOST steps do
    not reach that part.
    """
    first = change(substeps)
    if not first > limit:
        return None
    k, now = substeps, first
    while 2 * k <= MOST:
        k *= 2
        now = change(k)
        if now <= SURELY * limit:
            return first, k
    return first, k if now <= limit else 0


def said_of(substeps: int, what: str, change: float, enough: int) -> str:
    """The sentence for the user about steps that are too long: ``what`` changes, with a gap for how much."""
    much = f"{percent(change)} of" if change < 10.0 else f"{number(change, 2)} times"
    advice = (
        f"Use series.refined({enough}), in jobs and the shell the option substeps"
        if enough
        else f"Even series.refined({MOST}) does not do: sample faster, or make nonlinear states of "
        "linear ones that are multiplied by what depends on a"
    )
    return (
        f"The model's steps are too long for these data: with {2 * substeps} steps a sample "
        f"{what.format(much)}. {advice}."
    )


def about_free_runs(
    model: MixedModel, theta: Array, all_series: Sequence[Series], x1: Array
) -> str:
    """A sentence where steps are too long for free runs from x1 (S, nx); "" where they are not.

    Of models that are ``continuous``: others have no shorter steps. None is said of those that count them.
    """
    if not model.continuous or model.steps_counted:
        return ""
    runs: dict[tuple[int, int], Array] = {}

    def run(i: int, k: int) -> Array:
        one = all_series[i]
        if (i, k) not in runs:
            fine = one if k == one.substeps else one.held(one.hold).refined(k)
            runs[i, k] = run_at_samples(model, theta, fine, x1[i])
        return runs[i, k]

    def change(k: int) -> float:
        each = enumerate(all_series)
        return float(np.fmax.reduce([change_of_run(s, run(i, k), run(i, 2 * k)) for i, s in each]))

    substeps = max(one.substeps for one in all_series)
    try:
        found = too_long(change, substeps, FREE_RUN)
    except EngineError:
        return ""
    if found is None:
        return ""
    first, enough = found
    if any(one.observed.any() for one in all_series):
        return said_of(substeps, "the free run changes by {} its error", first, enough)
    return said_of(substeps, "the free run changes by {} its spread", UNSEEN * first, enough)
