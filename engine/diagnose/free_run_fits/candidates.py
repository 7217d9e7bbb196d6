"""The effects that a free run can show, and those that would take most of what is wrong with it."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np

from engine.data.joined import apart
from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run_fits.columns import CANNOT, columns
from engine.diagnose.free_run_fits.fitted import Fitted, fit_runs, with_effects
from engine.diagnose.free_run_fits.linear import Linear
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.estimation.vanished import revived
from engine.simulation.free_run import first_state
from engine.statespace.model import Array

FAMILIES = ("state", "measurement", "input", "parameter")  # of effects that a free run shows
LEADING = 3  # effects that are asked for by the free run
PART = 0.2  # of its squared error: what such an effect takes of it
TOLERANCE = 0.1  # of a log-likelihood: noise to start from


def candidates(fit: Fitted, setting: Setting, kinds: Sequence[str] | None) -> list[Effect]:
    """Effects that a noise-free run can show; those on a state that only noise moves have no meaning here.

    Nor is one asked that is odd at its channel: a free run has no odds to weigh it by.
    """
    disturbances = set(setting.states) - set(setting.moved)
    known = set(fit.model.parameter_names)
    out = []
    for effect in all_effects(setting, kinds):
        source, _, target = effect.channel.partition("->")
        usual = not (effect.traits.unnamed or effect.traits.odd)
        shown = effect.family in FAMILIES and usual and effect.readings is None
        if shown and effect.size.name not in known and not {source, target} & disturbances:
            out.append(effect)
    return out


def fit_of(start: QuasiFit, records: Sequence[Series]) -> Fitted:
    """The free runs of ``records``, fitted from the parameters of another fit."""
    mean, _ = first_state(start.model, start.theta)
    first = np.tile(mean, (len(records), 1))
    return fit_runs(start.model, records, start.theta, start.free, first)


def leading(
    start: QuasiFit, series: Series, setting: Setting, kinds: Sequence[str] | None
) -> dict[str, Array]:
    """By name, the few effects that take most of what the free run gets wrong: theta with each of them.

    A clipped reading or an overflow is large and rare. The noise that was fitted without it hides it one step
    ahead, where its score is small and no small step leads to it; so theta (n,) is that of the free run
    with the effect, with the noise that is then left. Empty where no free run can be had.
    """
    try:
        fit = fit_of(start, apart(series))
        shares = Linear(fit, columns(fit, candidates(fit, setting, kinds))).singles()
    except CANNOT:
        return {}
    out = {}
    for share in shares[:LEADING]:
        if share.share >= PART:
            with contextlib.suppress(*CANNOT):
                out[share.names[0]] = _with_own_noise(with_effects(fit, share.picks))
    return out


def _with_own_noise(fit: Fitted) -> Array:
    if not fit.noise:
        return np.asarray(fit.theta)
    found = quasi_ml(fit.model, fit.records, fit.theta, fit.noise, tolerance=TOLERANCE)
    return np.asarray(revived(found, fit.records, TOLERANCE).theta)
