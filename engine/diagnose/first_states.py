"""Records that begin elsewhere than the model says: a test that is cut from the middle of a run, say.

A model that begins at rest takes such a record's first readings for impossible, and one that leaves little to
noise does so for long: what it loses there says nothing of a cause. So both models begin such a record anywhere
that the record searched has been. Not so where it begins as one of them says, which speaks for that one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError
from engine.estimation.beginnings import first_readings, first_rows, squared
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.sigma_point import moment_path
from engine.statespace.first_state import moments_of_first
from engine.statespace.model import Array, Gaussian, MixedModel, Theta

UNLIKELY = 1e-3  # p-value of a record's first readings, below which it begins where the model says it does not
MOST_NOISE = 100.0  # times its variance: what is further off all along is another record altogether


def begins_as_expected(model: MixedModel, theta: Array, one: Series) -> bool:
    """Whether the first readings of a record are what the model's first state lets expect."""
    return first_readings(model, theta, one) > UNLIKELY


def noise_it_needs(model: MixedModel, theta: Array, one: Series) -> float:
    """The factor of variances by which a record's later readings are further off than the noise says, or 1.

    The model that is asked begins anywhere.
    """
    later = np.flatnonzero(one.observed.any(axis=1))[first_rows(model, one).size :]
    if not later.size:
        return 1.0
    far = _farthest(model, theta, (*model.nonlinear, *model.linear), one)
    square, n = squared(moment_path(_widened(model, far), theta, one), one, later)
    return max(1.0, square / n)


def with_noise(model: MixedModel, factor: float) -> MixedModel:
    """The model with so many times the variances of its noise, its first state as it was."""

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> Any:
        f, A, Q = model.transition(a, u, t, dt, theta)
        return f, A, Q * factor

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> Any:
        h, C, R = model.observation(a, u, t, theta)
        return h, C, R * factor

    return replace(model, dynamics=dynamics, measurement=measurement)


def begins_as_said(model: MixedModel, start: Theta, fitted: Theta, one: Series) -> bool:
    """Whether a record begins where the ``fitted`` model says, or the model with its ``start`` values.

    Where parameters say how far apart records begin, one record tells nothing of that: fitted to it alone, they
    say that all begin where it does. Then what the model was given with speaks, with all else as fitted. It
    tells no more of what else differs between records, and little of the noise where it is short: what
    the record itself shows of these once it has begun is noise here.
    """
    begun, theta = model.record(start), np.asarray(fitted)

    def expected(of: MixedModel) -> bool:
        given = replace(of, initial=lambda _: model.initial(begun))
        return any(begins_as_expected(says, theta, one) for says in (of, given))

    if expected(model):
        return True
    try:
        factor = noise_it_needs(model, theta, one)
    except (EngineError, np.linalg.LinAlgError):
        return False
    return 1.0 < factor <= MOST_NOISE and expected(with_noise(model, factor))


def starts_there(fit: QuasiFit, one: Series) -> bool:
    """Whether a record begins as a fitted model lets expect."""
    return begins_as_expected(fit.model, np.asarray(fit.theta), one)


def anywhere(base: QuasiFit, extended: QuasiFit, searched: Series) -> tuple[QuasiFit, QuasiFit]:
    """Both fits with a first state of the model that may be anywhere that ``searched`` has been.

    So may linear states that an effect has added: what a sensor is behind, say. Where a filter is lost on
    ``searched`` the fits stay as they are.
    """
    own = (*base.model.nonlinear, *base.model.linear)
    try:
        one, other = (
            _farthest(fit.model, np.asarray(fit.theta), own, searched) for fit in (base, extended)
        )
    except (EngineError, np.linalg.LinAlgError):
        return base, extended
    wide = _widened(base.model, one), _widened(extended.model, other)
    return replace(base, model=wide[0]), replace(extended, model=wide[1])


def _farthest(
    model: MixedModel, theta: Array, own: Sequence[str], searched: Series
) -> dict[str, float]:
    """How far each state of its ``own`` comes from its first mean, and each further linear one goes.

    What is added may begin at 0 for want of what came before it, in whatever unit: its first row tells nothing.
    """
    means = moment_path(model, theta, searched).filtered
    middle, _ = moments_of_first(model, model.record(theta))
    away = np.abs(means - middle).max(axis=0)
    span = np.ptp(means[1:], axis=0)
    names = [*model.nonlinear, *model.linear]
    found = {n: float(away[i]) for i, n in enumerate(names) if n in own}
    return found | {n: float(span[names.index(n)]) for n in model.linear if n not in own}


def _widened(model: MixedModel, far: Mapping[str, float]) -> MixedModel:
    """The model with standard deviations of the first state that are wider by ``far``, by state.

    Nonlinear states that are not in it follow the others as they did: a memory of what was read, say.
    """
    na, names = model.na, [*model.nonlinear, *model.linear]
    more = np.diag([far.get(name, 0.0) ** 2 for name in names])
    own = np.array([name in far for name in model.nonlinear], dtype=bool)

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        start = model.start(theta)
        mean, cov = moments_of_first(model, theta)
        C = cov[:na, :na]
        follow = np.eye(na)[:, own]
        follow[~own] = C[np.ix_(~own, own)] @ np.linalg.pinv(C[np.ix_(own, own)], hermitian=True)
        wide = C + follow @ more[:na, :na][np.ix_(own, own)] @ follow.T
        density = Gaussian(mean[:na], wide) if na else start.density

        def z1(a: Array) -> Array:
            return start.linear(a)[0]

        def P1(a: Array) -> Array:
            return np.asarray(start.linear(a)[1] + more[na:, na:])

        none = np.zeros((1, na))
        return (
            density,
            z1 if callable(start.z1) else z1(none)[0],
            P1 if callable(start.P1) else P1(none),
        )

    return replace(model, initial=initial)
