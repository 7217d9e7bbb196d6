"""Whether maximum-likelihood estimates are those of long steps, see :mod:`engine.simulation.own_steps`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, derivatives, quasi_ml, with_scales
from engine.filters.sigma_point import moment_path
from engine.simulation.own_steps import may_be_too_long, moved_in_words
from engine.statespace.half_steps import in_half_steps
from engine.statespace.model import Array, MixedModel, Theta
from engine.ties import FLAT

LESS_LIKELY = (
    1.0  # nats: a record that is so much less likely by half-steps tells the model's own steps
)
HINT = 1.0  # standard errors that a first step has to move a parameter
BESIDE = 0.5  # of the longest move: how far from the moment filter's maximum an estimate may be


def about_own_steps(
    model: MixedModel, theta: Theta, free: Sequence[str], all_series: Sequence[Series]
) -> str:
    """A sentence where steps of half the length explain the series as well, with other parameters; else "".

    Of models whose dt is a real time step and that make no finer ones by themselves, as ``continuous`` ones do.
    Both are asked by the moment filter, and only where it has its maximum next to theta.
    """
    try:
        long = any(_long(model, theta, one) for one in all_series) if free else False
        if long and _hinted(model, theta, free, all_series):
            return of_fit(quasi_ml(model, all_series, theta, free), all_series, theta)
    except (EngineError, np.linalg.LinAlgError):
        pass
    return ""


def of_fit(base: QuasiFit, all_series: Sequence[Series], theta: Theta | None = None) -> str:
    """The same of a fit by the moment filter, to estimates ``theta`` by another where they are given."""
    try:
        halves = quasi_ml(in_half_steps(base.model), all_series, base.theta, base.free)
    except (EngineError, np.linalg.LinAlgError):
        return ""
    if halves.log_likelihood < base.log_likelihood - LESS_LIKELY:
        return ""  # the record tells the steps, and these are its own
    told = base.theta if theta is None else theta
    moves = {name: halves.theta[name] - base.theta[name] for name in base.free}
    errors = dict(zip(base.free, base.standard_errors.tolist(), strict=True))
    known = [name for name, error in errors.items() if 0.0 < error < np.inf]
    furthest = max((abs(moves[name]) / errors[name] for name in known), default=0.0)
    off = max((abs(told[name] - base.theta[name]) / errors[name] for name in known), default=0.0)
    return moved_in_words(base.model, told, moves, errors) if off <= BESIDE * furthest else ""


def _long(model: MixedModel, theta: Theta, series: Series) -> bool:
    """Whether the model makes its own steps, and shorter ones do something else along the series."""
    if model.continuous or model.steps_counted:
        return False
    path = moment_path(model, np.asarray(theta), series)
    return may_be_too_long(model, np.asarray(theta), path.filtered, series)


def _hinted(
    model: MixedModel, theta: Theta, free: Sequence[str], all_series: Sequence[Series]
) -> bool:
    """Whether a first step of scoring from theta goes elsewhere with half-steps."""
    indices = model.free_indices(free)
    known = with_scales(model, all_series, np.asarray(theta), indices)
    ways: list[Array] = []
    for one in (known, in_half_steps(known)):
        value, g, H = derivatives(one, all_series, np.asarray(theta), indices)
        if not np.isfinite(value):
            return bool(ways)
        d = np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
        inverse = np.linalg.pinv(H / d[:, None] / d, rcond=FLAT**2, hermitian=True)
        ways.append((inverse @ (g / d)) / np.sqrt(np.maximum(np.diag(inverse), FLAT**2)))
    return bool(np.abs(ways[1] - ways[0]).max(initial=0.0) > HINT)
