"""What the free run lacks where no name settles it: a force that is some function of a signal, and its curve.

For an equation i and a signal c let x_i' += B(c)' w with hats B; every (i, c) is screened to first order
beside the last fit, the best are fitted and judged on rows left out like any candidate. What the best one
reaches there is the ceiling of all names for a force on i that depends on c alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.free_function import free_function, hats, knots_of
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.search import GAINED, WORTH
from engine.diagnose.free_run_fits.columns import CANNOT, run_of, slope
from engine.diagnose.free_run_fits.fitted import Fitted, Pick, state_names, with_effects
from engine.diagnose.free_run_fits.folds import folds_of, losses, p_better, times
from engine.diagnose.free_run_fits.linear import orthonormal
from engine.errors import ModelError
from engine.simulation.sensitivities import Along
from engine.statespace.model import Array
from engine.words import percent

FEWEST = 3  # knots of a curve
FITTED = 3  # pairs of equation and signal, the best to first order
NEAR_BEST = 0.25  # of the largest share: what takes less to first order is not fitted
BENT = 12.0
TOLD = 0.03  # of the direction of a curve that data tell best: the rest is left to the model's own parameters


@dataclass(frozen=True, eq=False)
class MissingFunction:
    """A force on ``target``, in ``unit``, over ``source``, in ``source_unit``.

    ``mean`` and standard deviation ``sd`` (K,) at the values ``x`` (K,), straight between them, as far as the
    model's own parameters do not do the same. ``left`` is the share of the error on rows left out that it does
    not take, ``p_value`` of no gain there.
    """

    source: str
    target: str
    source_unit: str
    unit: str
    x: Array
    mean: Array
    sd: Array
    left: float
    p_value: float

    @property
    def sentence(self) -> str:
        """What acts where, and what it is worth."""
        return (
            f"Some function of {self.source}, whatever its name, acts on {self.target}: it takes "
            f"{percent(1.0 - self.left)} of what is left of the free run's error on rows left out."
        )


def missing_function(fit: Fitted, own: Array, setting: Setting) -> MissingFunction | None:
    """The best function beside a fit with losses ``own`` (blocks,) on rows left out; None if none gains."""
    folds = folds_of(fit.records)
    courses = _Courses(fit, setting)
    ranked = sorted(courses.screened(), key=lambda one: -one.share)
    best: tuple[Fitted, Array, Screened, Effect] | None = None
    for one in [one for one in ranked[:FITTED] if one.share > NEAR_BEST * ranked[0].share]:
        effect = free_function(setting, one.source, one.target, one.knots, one.directions)
        first, *others = one.sizes.tolist()
        try:
            found = with_effects(fit, [Pick(effect, first, tuple(others))])
            out = losses(found, folds)
        except CANNOT:
            continue
        if best is None or times(out, best[1]) < 1.0:
            best = found, out, one, effect
    if best is None:
        return None
    found, out, one, effect = best
    p_value = min(FITTED * p_better(out, own), 1.0)
    left = times(out, own)
    if p_value > GAINED or left > 1.0 - WORTH:
        return None
    mean, sd = _curve(found, effect, one.directions)
    units = setting.unit(one.source), setting.rate(one.target)
    return MissingFunction(one.source, one.target, *units, one.knots, mean, sd, left, p_value)


def _curve(found: Fitted, effect: Effect, directions: Array) -> tuple[Array, Array]:
    """Values at the knots (K,) and their standard deviations; parameters without any trace have stayed 0.

    The best straight pieces miss a parabola by a twelfth of its second differences at the knots.
    """
    at = np.array([found.model.index(p.name) for p in effect.parameters])
    mean = directions @ np.asarray(found.theta)[at]
    place = {int(i): k for k, i in enumerate(found.problem.active)}
    seen = np.array([i in place for i in at.tolist()])
    own = [place[i] for i in at[seen].tolist()]
    covariance = found.covariance[np.ix_(own, own)]
    shown = directions[:, seen]
    bend = np.diff(mean, 2, prepend=mean[0], append=mean[-1]) / BENT
    return mean, np.sqrt(np.maximum(np.diag(shown @ covariance @ shown.T), 0.0) + bend**2)


@dataclass(frozen=True, eq=False)
class Screened:
    """A function to first order: what it takes of the squared error, and its values at ``knots`` (K,).

    These are ``directions`` (K, r) @ ``sizes`` (r,), the directions that the model's own parameters do not
    imitate.
    """

    share: float
    source: str
    target: str
    knots: Array
    directions: Array
    sizes: Array


class _Courses:
    """What every signal does over the free run of a fit, and what a force along it would do there."""

    def __init__(self, fit: Fitted, setting: Setting) -> None:
        self.fit, self.setting = fit, setting
        self.names = [*state_names(fit.model), *fit.model.inputs]
        theta = np.asarray(fit.theta)
        self.runs = [
            run_of(fit.model, theta, one, x1) for one, x1 in zip(fit.records, fit.x1, strict=True)
        ]
        self.basis = orthonormal(fit.J)

    def of(self, source: str) -> list[Array]:
        """A signal's values (T,) in each record."""
        i, nx = self.names.index(source), self.fit.model.nx
        if i < nx:
            return [run[:, i] for run in self.runs]
        return [np.asarray(one.u[:, i - nx]) for one in self.fit.records]

    def knots(self, source: str) -> Array:
        """Knots over the values of a signal."""
        return knots_of(np.concatenate(self.of(source)))

    def screened(self) -> Iterator[Screened]:
        """Every equation with every signal."""
        sources = [*self.setting.moved, *self.fit.model.inputs]
        for target in (name for name in self.setting.moved if name in self.setting.targets):
            try:
                push = self.push(target)
            except CANNOT:
                continue
            for source in sources:
                one = self._screen(push, source, target)
                if one is not None:
                    yield one

    def _screen(self, push: _Push, source: str, target: str) -> Screened | None:
        knots, e = self.knots(source), self.fit.e
        if len(knots) < FEWEST:
            return None
        G = push.columns([np.ascontiguousarray(hats(c, knots).T) for c in self.of(source)])
        if not np.isfinite(G).all():
            return None
        U, strengths, Vt = np.linalg.svd(G - self.basis @ (self.basis.T @ G), full_matrices=False)
        told = strengths > TOLD * strengths.max(initial=0.0)
        if not told.any():
            return None
        along = U[:, told].T @ e
        power = float(e @ e) or 1.0
        share = float(along @ along) / power
        return Screened(share, source, target, knots, Vt[told].T, along / strengths[told])

    def push(self, target: str) -> _Push:
        """A force on an equation along this fit's runs."""
        return _Push(self.fit, self.setting, target, self.runs)


class _Push:
    """A force on ``target`` that runs over time in any way, to first order."""

    def __init__(self, fit: Fitted, setting: Setting, target: str, runs: list[Array]) -> None:
        force, model = make_effect(f"force:{target}", setting), fit.model
        if force.size.name not in model.parameter_names:
            model = force.apply(model)
        self.fit = fit
        index = model.index(force.size.name)
        values = np.array([*fit.theta, *[0.0] * (len(model.parameters) - len(fit.theta))])
        self.along = [
            Along(model, values, one, run) for one, run in zip(fit.records, runs, strict=True)
        ]
        found = slope(fit, model, self.along, index)
        if found is None:
            raise ModelError(f"a force on {target} moves nothing")
        self.index, self.step = index, found[1]

    def columns(self, courses: list[Array]) -> Array:
        """d(simulated) / d(size) (n, K), weighed as the residuals, of forces (T, K) in each record."""
        parts = []
        for one, along, course in zip(self.fit.records, self.along, courses, strict=True):
            dy = along.over_time(self.index, self.step, course)
            parts.append((dy / self.fit.problem.scale[:, None])[one.observed])
        return np.concatenate(parts)
