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
from engine.diagnose.effects.setting import Setting, setting_for
from engine.diagnose.search.substeps import is_consistent, sampled
from engine.diagnose.symptoms.runs import start_state
from engine.errors import EngineError
from engine.simulation.step_length import FREE_RUN, change_of_run, run_at_samples
from engine.statespace.model import Array, MixedModel, ThetaLike

FEWEST = 500  # samples that are kept of all records
ALIKE = (
    0.95  # correlation of errors from one sample to the next from which the next one says little
)
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


def of_any_step(kinds: Sequence[str] | None, setting: Setting) -> list[str]:
    """The effects that mean the same whatever the step: none that remembers a number of samples."""
    every = all_effects(setting, kinds)
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
    for i, own in enumerate(e.T):
        own = own - np.nanmean(own)
        before, after = own[:-1], own[1:]
        both = np.isfinite(before * after)
        power = float(np.mean(own[np.isfinite(own)] ** 2)) if both.any() else 0.0
        if power > 0.0:
            out[i] = float(np.mean(before[both] * after[both])) / power
    return out
