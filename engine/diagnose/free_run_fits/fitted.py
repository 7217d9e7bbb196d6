"""Models fitted to the free runs of records: Q = 0, least squares over parameters and first states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.simulation.free_run import first_state
from engine.simulation.problem import FreeRunProblem
from engine.statespace.model import Array, MixedModel, Theta

EVALUATIONS = 40  # of a refit at most
SHORT = 8  # evaluations after which one that is far from the best is left where it is
HOPELESS = 2.0  # of the best squared error there is
PRECISE = 1e-5  # relative change of the cost or of p at which a refit ends: refits are compared


@dataclass(frozen=True, eq=False)
class Pick:
    """An effect to add: its size to start from, and values of its parameters after the size."""

    effect: Effect
    size: float
    probe: tuple[float, ...] = ()

    def start(self) -> list[float]:
        """Values of all its parameters."""
        own = [p.default for p in self.effect.parameters]
        own[: 1 + len(self.probe)] = [self.size, *self.probe]
        return own


@dataclass(frozen=True, eq=False)
class Rival:
    """An answer of others, with the model's parameters ``beside`` it, by name."""

    picks: tuple[Pick, ...]
    beside: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Fitted:
    """The best free runs of a model.

    ``theta`` with ``x1`` (S, nx) first states of each record; ``e`` (n,) measured minus simulated at all
    measured values, outputs weighed as in :func:`engine.simulation.free_run.output_scale`, ``J`` its
    derivatives (n, n_p) by the ``problem``'s p; ``effects`` those added so far; ``ended`` whether the search
    came to its end, see :func:`finished`.
    """

    problem: FreeRunProblem
    theta: Theta
    x1: Array
    p: Array
    e: Array
    J: Array
    free: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    ended: bool = True

    @property
    def model(self) -> MixedModel:
        """The model, with its effects in it."""
        return self.problem.model

    @property
    def records(self) -> list[Series]:
        """The records that were fitted."""
        return self.problem.series

    @property
    def cost(self) -> float:
        """Sum of squares of ``e``."""
        return float(self.e @ self.e)

    @property
    def rms(self) -> float:
        """Root mean square of ``e``."""
        return float(np.sqrt(np.mean(self.e**2)))

    @property
    def covariance(self) -> Array:
        """Of p (n_p, n_p), from errors that may be correlated over time."""
        return self.problem.uncertainty(self.e, self.J).covariance

    @property
    def n_parameters(self) -> int:
        """Parameters that were estimated, first states not counted."""
        return int(self.problem.active.size)

    @property
    def noise(self) -> list[str]:
        """Free parameters that no free run shows: the noise's."""
        shown = {self.model.parameter_names[i] for i in self.problem.active}
        return [name for name in self.free if name not in shown]

    def begun_at(self, values: Mapping[str, float]) -> Fitted:
        """The same, from which an extension begins at other values of its free parameters."""
        own = {name: value for name, value in values.items() if name in self.free}
        return replace(self, theta=self.model.theta({**self.theta.asdict(), **own}))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(effect.name for effect in self.effects)


def fit_runs(
    model: MixedModel,
    records: Sequence[Series],
    theta: Theta,
    free: Sequence[str],
    x1: Array,
    effects: tuple[Effect, ...] = (),
    best: float = np.inf,
    runs: Sequence[Array | None] | None = None,
) -> Fitted:
    """Least squares from theta and first states x1 (S, nx). Raises what the model raises.

    Left early where it stays far from ``best``, a squared error that was reached. ``runs`` are guesses of the
    runs (T, nx) at the start.
    """
    problem = FreeRunProblem(model, list(records), theta, model.free_indices(free), x1, runs)
    problem.look_for_silent()
    end = problem.descend(problem.start(), SHORT, precise=PRECISE)
    if end.status == 0 and 2.0 * end.cost < HOPELESS * best:
        end = problem.descend(end.x, EVALUATIONS - SHORT, precise=PRECISE)
    return _fitted(problem, end, tuple(free), effects)


def finished(fit: Fitted) -> Fitted:
    """One that was left early, followed to its end: what is gone on with must be the best of its kind."""
    if fit.ended:
        return fit
    end = fit.problem.descend(fit.p, EVALUATIONS, precise=PRECISE)
    return _fitted(fit.problem, end, fit.free, fit.effects)


def _fitted(
    problem: FreeRunProblem, end: OptimizeResult, free: tuple[str, ...], effects: tuple[Effect, ...]
) -> Fitted:
    theta, x1 = problem.split(end.x)
    e, J = problem.evaluate(end.x)
    return Fitted(problem, theta, x1, end.x, e, J, free, effects, end.status > 0)


def with_effects(fit: Fitted, picks: Sequence[Pick], best: float = np.inf) -> Fitted:
    """Effects more, estimated together with all there is; ``best`` as in :func:`fit_runs`."""
    model, theta, free = fit.model, fit.theta.tolist(), list(fit.free)
    for pick in picks:
        model = pick.effect.apply(model)
        theta += pick.start()
        effect = pick.effect
        if effect.from_elsewhere(pick.probe):
            effect = effect.with_free_zero()
        free += [p.name for p in effect.parameters if p.name not in effect.held]
    start = model.theta(np.clip(theta, model.lower, model.upper))
    x1 = first_states(model, start, fit)
    effects = (*fit.effects, *(pick.effect for pick in picks))
    runs = [extended_run(model, fit.model, *one) for one in zip(fit.problem.runs, x1, strict=True)]
    return fit_runs(model, fit.records, start, free, x1, effects, best, runs)


def extended_run(model: MixedModel, base: MixedModel, run: Array | None, x1: Array) -> Array | None:
    """A guess of a run (T, nx) of an extended model: that of its base, its own states as at first, x1 (nx,)."""
    if run is None:
        return None
    return _by_name(model, base, run, np.tile(x1, (len(run), 1)))


def first_states(model: MixedModel, theta: Theta, fit: Fitted) -> Array:
    """First states (S, nx) of an extended model: those of the fit, by name, where it has them."""
    mean, _ = first_state(model, theta)
    return _by_name(model, fit.model, fit.x1, np.tile(mean, (len(fit.records), 1)))


def _by_name(model: MixedModel, base: MixedModel, values: Array, others: Array) -> Array:
    """States of an extended model: those of its base from ``values``, its own from ``others`` (n, nx)."""
    known = state_names(base)
    for i, name in enumerate(state_names(model)):
        if name in known:
            others[:, i] = values[:, known.index(name)]
    return others


def state_names(model: MixedModel) -> tuple[str, ...]:
    """Names of x = (a, z)."""
    return (*model.nonlinear, *model.linear)


def on_rows(fit: Fitted, rows: NDArray[np.bool_], evaluations: int = EVALUATIONS) -> Array:
    """All residuals (n,) of the model fitted to the marked ones only, from where it is."""
    fit.problem.begin_at(fit.p, fit.e, fit.J)
    best = fit.problem.descend(fit.p, evaluations, rows, PRECISE)
    return fit.problem.residuals(best.x)
