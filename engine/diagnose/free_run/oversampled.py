"""A long record that was sampled far more often than its plant moves: searched whole, of every k-th sample.

A window of so many rows is over before what is slow in it has happened. What of the readings is lost says
the same again: the errors of the free run are alike from one sample that is kept to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run_fits.fitted import Fitted
from engine.diagnose.steps.substeps import MUCH, is_consistent, sampled
from engine.diagnose.symptoms.runs import start_state
from engine.errors import EngineError
from engine.filters.sigma_point import moment_path
from engine.simulation.step_length import FREE_RUN, change_of_run, run_at_samples
from engine.statespace.half_steps import step
from engine.statespace.model import Array, MixedModel, ThetaLike

FEWEST = 500  # samples that are kept of all records
ALIKE = 0.95  # correlation of errors from sample to sample from which the next says little
STEPPED = 100  # samples from which a long step and many short ones are compared
DECIDES = 2.0  # of 2 x log-likelihood: so much more may decide between names
KEPT = 0.5  # of the share that is kept of the readings: with fewer the samples between them have what there is


def fewer_samples(
    model: MixedModel, theta: ThetaLike, records: Sequence[Series], most: int
) -> list[Series] | None:
    """Every k-th sample of the records, ``most`` in all, or fewer where these say the same again.

    None where the free run shows that so long steps are too long, or would say less; and where they mean
    nothing, as the model counts steps or their times differ.
    """
    at = np.asarray(model.theta(theta))
    if model.steps_counted or any(one.substeps > 1 or one.dt is None for one in records):
        return None
    rows = sum(map(len, records))
    k, best = -(-rows // most), None
    while k <= rows // FEWEST:
        fewer = _every(k, model, at, records)
        if fewer is None:
            break
        best, k = fewer, 2 * k
    return best


def thinned_by(few: Series, one: Series) -> int:
    """Of how many samples of a record ``few`` keeps one; 0 where it keeps them all, or a part of the record."""
    if few.dt is None or one.dt is None:
        return 0
    k = round(few.dt * few.substeps / (one.dt * one.substeps))
    return k if k > 1 else 0


def steps_are_too_long(fit: Fitted, whole: Series) -> bool:
    """Whether much of what the free run of a fit to a thinned ``whole`` gets wrong is its longer steps.

    As :func:`engine.diagnose.steps.substeps.are_too_long`.
    """
    few, x1 = fit.records[0], fit.x1[0]
    theta = np.asarray(fit.theta)
    run, long = (run_at_samples(fit.model, theta, series, x1) for series in (whole, few))
    return not change_of_run(few, run[:: thinned_by(few, whole)], long) <= MUCH


def error_of_steps(model: MixedModel, theta: Array, one: Series, few: Series) -> float:
    """How much likelihood the longer steps of ``few`` may cost or win: 2 x log-likelihood, to first order.

    From filtered states of some samples one long step, and as many short ones as there are in it, go on to
    predictions that differ by d; with S the covariance of the errors of predictions it is the sum of d' S^-1 d.
    """
    k = thinned_by(few, one)
    path = moment_path(model, theta, few)
    rows = np.unique(np.linspace(0, len(few) - 2, STEPPED).astype(int))
    total, record = 0.0, model.record(theta)

    def seen(x: Array, row: int) -> Array:
        h, C, _ = model.observation(x[:, : model.na], few.u[row], float(few.t[row]), record)
        y: Array = (h + np.einsum("...ij,...j->...i", C, x[:, model.na :]))[0]
        return y

    for row in rows:
        start = short = path.filtered[row][None]
        long = step(model, theta, start, few.u_step[row], float(few.t[row]), float(few.steps[row]))
        for i in range(k * row, k * row + k):
            t, dt = float(one.t[i]), float(one.steps[i])
            short = step(model, theta, short, one.u_step[i], t, dt)
        d = seen(long, row + 1) - seen(short, row + 1)
        there = few.observed[row + 1]
        S = path.S[row + 1][np.ix_(there, there)]
        scale = np.sqrt(np.diagonal(S))
        white = np.linalg.solve(S / np.outer(scale, scale), d[there] / scale)
        total += float(white @ (d[there] / scale))
    return total * len(few) / len(rows)


def of_any_step(
    kinds: Sequence[str] | None, setting: Setting, free: Sequence[str] | None
) -> list[str]:
    """The effects that mean the same whatever the step: none that remembers a number of samples.

    Parameters that are not ``free`` are among them, as held ones.
    """
    names = setting.model.parameter_names
    held = () if free is None else tuple(name for name in names if name not in free)
    every = all_effects(replace(setting, held=held), kinds)
    return [one.name for one in every if not one.apply(setting.model).steps_counted]


def _every(
    k: int, model: MixedModel, theta: Array, records: Sequence[Series]
) -> list[Series] | None:
    """Every k-th sample of the records; None where that is too few."""
    fewer = [one.thinned(k) for one in records]
    try:
        alike = all(
            _alike(model, theta, one, few, k) for one, few in zip(records, fewer, strict=True)
        )
    except (EngineError, np.linalg.LinAlgError):
        return None
    return fewer if alike else None


def _alike(model: MixedModel, theta: Array, one: Series, few: Series, k: int) -> bool:
    """Whether ``few`` of a record's samples say what all of them say."""
    if few.observed.sum() < KEPT * one.observed.sum() / k:
        return False
    points = sampled(setting_for(model, few, theta))
    if not is_consistent(model, theta, replace(points, dt=np.full(len(points.t), few.dt))):
        return False
    x1, _ = start_state(model, theta, one)
    run, long = (run_at_samples(model, theta, series, x1) for series in (one, few))
    if not change_of_run(few, run[::k], long) <= FREE_RUN:
        return False
    return bool((_correlations(few.y - long) >= ALIKE).all())


def _correlations(e: Array) -> Array:
    """Of errors (n, ny) with those of the sample before; 1 of an output with none in a row."""
    out = np.ones(e.shape[1])
    for i in np.flatnonzero(np.isfinite(e).any(axis=0)):
        own = e[:, i] - np.nanmean(e[:, i])
        before, after = own[:-1], own[1:]
        both = np.isfinite(before * after)
        power = float(np.mean(own[np.isfinite(own)] ** 2)) if both.any() else 0.0
        if power > 0.0:
            out[i] = float(np.mean(before[both] * after[both])) / power
    return out
